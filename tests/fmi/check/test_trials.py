"""Trials of FMUs that run: all pass on sound files; each is seen to fail on one with its fault."""

import json

import pytest
from helpers.fmu_files import rewritten, set_attributes, with_description
from helpers.hostile import hostile, hostile_binary
from helpers.samples import sampled
from helpers.wrapped import wrapped

import casadi_models
import cosim
from cosim.cli.main import main
from cosim.fmi.check.check import examine
from cosim.fmi.check.finding import ADVICE, WRONG
from cosim.fmi.check.isolated import TRIALS, try_apart
from cosim.fmi.check.libraries import sources
from cosim.fmi.check.trials.bench import Bench

NAME = "bar_on_frame/reduced"
SHORT = 24.0  # s for all trials, a twelfth of it for the steps
# Terms cancel there for all values, which the structure of the equations does not tell
CANCELLING = ("bicycle/book", "bar_on_frame/two_body")
QUICK = tuple(trial for trial in TRIALS if trial is not sources)  # a compiler takes 2 s
FAULTY = {  # the function that is wrapped, its body, what is found
    "memory outside the instance": (
        "fmi2GetReal",
        "static double drift; fmi2Status s = CALL; if (n) value[0] += drift += 1e-9; return s;",
        {
            (WRONG, r)
            for r in (
                "reset",
                "instances",
                "rollback",
                "settings",
                "exchange",
                "calls",
                "switching",
            )
        },
    ),
    "a state that is not restored": (
        "fmi2SetFMUstate",
        "(void)c; (void)state; (void)&inner_fmi2SetFMUstate; return fmi2OK;",
        {(WRONG, "rollback")},
    ),
    "a logger that is taken for granted": (
        "fmi2Instantiate",
        'functions->logger(0, name, fmi2OK, "x", "hello"); return CALL;',
        {(ADVICE, "crash")},
    ),
    "a missing logger that is refused": (
        "fmi2Instantiate",
        "if (!functions->logger) return 0; return CALL;",
        {(ADVICE, "logger")},
    ),
    "sums of steps that are refused": (
        "fmi2DoStep",
        "if (point > 0.12 && fabs(100 * (point + size) - round(100 * (point + size))) > 1e-6)"
        " return fmi2Error; return CALL;",
        {(WRONG, "steps")},
    ),
    "a stop time that is forgotten": (
        "fmi2SetupExperiment",
        "(void)hasStop; (void)end; "
        "return inner_fmi2SetupExperiment(c, hasTol, tolerance, start, 0, 0);",
        {(ADVICE, "stop")},
    ),
}


def found(path, **options) -> set[tuple[str, str]]:
    options = {"timeout": SHORT, "trials": QUICK} | options
    return {(one.level, one.rule) for one in try_apart(path, **options).findings}


def unneeded(fmi, dae) -> set[str]:
    """Return the trials that skip a model without bounds and events; limits may be indicators."""
    skipped = {"motion"} if dae.limits else set()
    if fmi == 3 or not dae.inputs:
        skipped.add("ramps")
    return skipped | ({"bounds", "logger"} if fmi == 3 else {"bounds"})


@pytest.mark.slow
@pytest.mark.parametrize(("name", "fmi"), [(NAME, 2), ("crank_shaft/multipliers", 3)])
def test_a_file_of_ours_passes_every_trial(name, fmi, exported, capsys):
    options = ["--run", "--json", "--timeout", str(SHORT)]
    assert main(["check", str(exported(name, fmi)), *options]) == 0
    told = capsys.readouterr()
    assert json.loads(told.out) == []
    (line,) = [line for line in told.err.splitlines() if line.startswith("passed: ")]
    passed = {one.split()[0] for one in line.removeprefix("passed: ").split("; ")}
    assert passed == {trial.__name__ for trial in TRIALS} - unneeded(fmi, cosim.load(name))


@pytest.mark.slow
@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("name", sampled(casadi_models.CATALOG))
def test_all_files_of_ours_have_nothing_wrong_and_pass_all_trials_but_the_compiler(
    name, fmi, exported
):
    # glibc is as new as the compiler here has it, where its functions have newer versions
    assert {(one.level, one.rule) for one in examine(exported(name, fmi))} <= {(ADVICE, "glibc")}
    results = try_apart(exported(name, fmi), timeout=SHORT / 2, trials=QUICK)
    found = {(one.level, one.rule) for one in results.findings}
    assert found == ({(ADVICE, "dependencies")} if name in CANCELLING else set())
    passed = {one.split()[0] for one in results.passed} | {rule for _, rule in found}
    assert passed == {trial.__name__ for trial in QUICK} - unneeded(fmi, cosim.load(name))


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTY)
def test_fault_in_a_run_is_found_by_its_rule_alone(fault, tmp_path):
    function, body, rules = FAULTY[fault]
    assert found(wrapped(tmp_path, **{function: body})) == rules


@pytest.mark.slow
@pytest.mark.parametrize(
    ("early", "level"),
    [("return fmi2Error", WRONG), ("return CALL, value[0] += 1, fmi2OK", ADVICE)],
)
def test_outputs_in_initialization_mode_are_those_after_it(early, level, tmp_path):
    enter, leave = "limit = 1; return CALL;", "limit = 0; return CALL;"
    get = f"if (n && limit > 0) {early}; return CALL;"
    path = wrapped(
        tmp_path,
        fmi2EnterInitializationMode=enter,
        fmi2ExitInitializationMode=leave,
        fmi2GetReal=get,
    )
    assert found(path) == {(level, "initialization")}


@pytest.mark.slow
def test_last_step_that_must_end_at_the_stop_time_exactly_is_advice(tmp_path):
    setup = "(void)hasStop; limit = end; return CALL;"
    step = "if (limit > 0 && point + size > limit) return fmi2Error; return CALL;"
    path = wrapped(tmp_path, fmi2SetupExperiment=setup, fmi2DoStep=step)
    assert found(path) == {(ADVICE, "stop")}


@pytest.mark.slow
def test_callbacks_that_need_not_be_passed_are_not_needed(tmp_path):
    body = "if (!functions->allocateMemory) return 0; return CALL;"
    path = wrapped(tmp_path, fmi2Instantiate=body)
    for value, rules in (("false", set()), ("true", {(WRONG, "callbacks"), (ADVICE, "logger")})):

        def mark(root, value=value):
            for kind in ("ModelExchange", "CoSimulation"):
                root.find(kind).set("canNotUseMemoryManagementFunctions", value)

        # where the file does not rule the functions out, they are passed
        assert found(with_description(path, tmp_path / f"{value}.fmu", mark)) == rules


@pytest.mark.slow
def test_one_crash_does_not_end_the_other_trials(tmp_path):
    body = "if (!functions->logger) *(volatile int *)0 = 1; return CALL;"
    verdict = try_apart(wrapped(tmp_path, fmi2Instantiate=body), timeout=SHORT)
    assert {(f.level, f.rule, f.place) for f in verdict.findings} == {
        (ADVICE, "crash", f"logger ({kind})") for kind in ("ModelExchange", "CoSimulation")
    }
    passed = {name.partition(":")[0] for name in verdict.passed}
    assert {"sources (ModelExchange)", "steps (CoSimulation)"} <= passed


@pytest.mark.slow
def test_sources_that_do_not_compile_or_lack_a_file_are_found(exported, tmp_path):
    broken = {"sources/equations.c": b"int f(void) { return missing; }"}
    path = rewritten(exported(NAME), tmp_path / "broken.fmu", broken)
    (finding,) = try_apart(path, timeout=SHORT).findings
    assert (finding.rule, finding.place) == ("sources", "sources/fmu.c")
    assert "missing" in finding.found
    empty = {"sources/equations.c": b""}
    path = rewritten(exported(NAME, 3), tmp_path / "empty.fmu", empty)
    (finding,) = try_apart(path, timeout=SHORT).findings
    assert (finding.rule, finding.place) == ("sources", "sources")
    assert "undefined reference" in finding.found


@pytest.mark.slow
def test_what_is_listed_without_influence_is_advice(exported, tmp_path):
    edit = set_attributes("ModelStructure/Derivatives/Unknown", dependencies="2 3 4 5")
    path = with_description(exported(NAME), tmp_path / "full.fmu", edit)
    (finding,) = try_apart(path, timeout=SHORT).findings
    assert (finding.level, finding.rule) == (ADVICE, "dependencies")
    assert "'der(theta)' of 'theta'" in finding.found


@pytest.mark.slow
def test_undeclared_dependency_is_found(exported, tmp_path):
    edit = set_attributes("ModelStructure/Derivatives/Unknown[2]", dependencies="")
    path = with_description(exported(NAME), tmp_path / "faulty.fmu", edit)
    assert found(path) == {(WRONG, "dependencies")}
    silent = set_attributes("ModelExchange", providesDirectionalDerivative="false")
    path = with_description(path, tmp_path / "silent.fmu", silent)
    assert found(path) == {(WRONG, "dependencies")}  # by differences


@pytest.mark.slow
def test_derivatives_to_another_state_are_found(exported, tmp_path):
    def swap(root):
        rates = [r for r in root.iterfind("ModelVariables/*/Real") if r.get("derivative")]
        one, two = rates[0].get("derivative"), rates[1].get("derivative")
        rates[0].set("derivative", two)
        rates[1].set("derivative", one)

    path = with_description(exported(NAME), tmp_path / "faulty.fmu", swap)
    assert (WRONG, "derivatives") in found(path)


@pytest.mark.slow
def test_fixed_parameter_that_can_be_set_is_advice(exported, tmp_path):
    def fix(root):
        for variable in root.iterfind("ModelVariables/ScalarVariable[@causality='parameter']"):
            was = variable.get("variability")
            variable.set("variability", "fixed" if was == "tunable" else "tunable")

    path = with_description(exported(NAME), tmp_path / "faulty.fmu", fix)
    assert (ADVICE, "fixed") in found(path)


def test_file_for_another_token_does_not_start(exported, tmp_path):
    path = with_description(exported(NAME), tmp_path / "a.fmu", set_attributes(".", guid="{b}"))
    assert found(path) == {(WRONG, "start")}


@pytest.mark.quick_rows("fmi2ExitInitializationMode status 3-start")
@pytest.mark.parametrize(
    ("fault", "rule"),
    [
        ("fmi2DoStep segv", "crash"),
        ("fmi2Instantiate abort", "crash"),
        ("fmi2Reset exit 0", "crash"),
        ("fmi2DoStep hang", "crash"),
        ("fmi2Reset status 3", "reset"),
        ("fmi2ExitInitializationMode status 3", "start"),
    ],
)
def test_broken_run_is_a_finding(fault, rule, tmp_path_factory):
    folder = tmp_path_factory.getbasetemp() / "hostile"
    folder.mkdir(exist_ok=True)
    binary = folder / "hostile.fmu"
    write = hostile(binary if binary.exists() else hostile_binary(folder))
    assert (WRONG, rule) in found(write(fault), timeout=6.0)


def test_no_code_runs_without_being_asked(tmp_path, capsys):
    write = hostile(hostile_binary(tmp_path))
    path = str(write("fmi2Instantiate abort"))
    main(["check", path, "--json"])
    assert not any(row["rule"] == "crash" for row in json.loads(capsys.readouterr().out))
    assert main(["check", path, "--json", "--run", "--trust", "-q"]) == 4
    assert "crash" in {row["rule"] for row in json.loads(capsys.readouterr().out)}


def test_file_that_cannot_run_keeps_its_other_findings(exported, tmp_path, capsys):
    edit = set_attributes(".", fmiVersion="1.0")
    path = str(with_description(exported(NAME), tmp_path / "old.fmu", edit))
    assert main(["check", path, "--run", "--trust", "--json", "-q"]) == 4
    assert [row["rule"] for row in json.loads(capsys.readouterr().out)] == ["version", "run"]


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # while it opens
def test_time_limit_holds_for_reading_the_file(exported, capsys):
    path = exported("crank_shaft", 2)
    assert main(["check", str(path), "--timeout", "0.001"]) == 1
    expected = f"FmuError: {path}: its description was not read within 0.001 s; use --timeout\n"
    assert capsys.readouterr().err == expected


@pytest.fixture
def bench(tmp_path):
    """Return a function: the bench of a file by the attributes of its interface and experiment."""

    def made(abilities="", experiment=""):
        (tmp_path / "modelDescription.xml").write_text(
            f'<fmiModelDescription fmiVersion="2.0"><CoSimulation {abilities}/>'
            f"<DefaultExperiment {experiment}/></fmiModelDescription>"
        )
        return Bench(tmp_path, "file", 1.0)

    return made


@pytest.mark.parametrize(("text", "offered"), [("true", True), ("1", True), ("0", False)])
def test_an_ability_is_offered_by_either_word_of_xml(bench, text, offered):
    name = "canBeInstantiatedOnlyOncePerProcess"
    assert bench(f'{name}="{text}"').offers("CoSimulation", name) is offered


@pytest.mark.parametrize(
    ("experiment", "span"), [('startTime="-5" stopTime="0"', 5.0), ('startTime="-5"', 1.0)]
)
def test_a_run_that_stops_at_0_has_its_whole_span(bench, experiment, span):
    assert bench(experiment=experiment).span == span
