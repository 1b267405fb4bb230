"""FMUs with events: sound ones have no findings; a fault at an event is found."""

import zipfile
from contextlib import nullcontext
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from helpers.fmu_files import rewritten, set_attributes, with_description
from helpers.small_models import ball
from helpers.wrapped import wrapped

import cosim
from cosim.errors import FmuError
from cosim.fmi.check.check import examine
from cosim.fmi.check.finding import WRONG
from cosim.fmi.check.isolated import TRIALS, try_apart
from cosim.fmi.check.libraries import sources
from cosim.fmi.check.trials.derivatives import dependencies, derivatives
from cosim.fmi.check.trials.start import initialization, start, time
from cosim.fmi.check.trials.steps import _answers_of_a_step as answers_of_a_step
from cosim.fmi.check.trials.steps import calls, steps
from cosim.fmi.check.trials.switching import _compared as compared
from cosim.fmi.check.trials.switching import _Switching as Switching
from cosim.fmi.check.trials.switching import switching
from cosim.fmi.check.trials.values import defaults


def sampled():
    """A plant whose force is sampled; the first sample is at the start."""
    model = cosim.Model("sampled", stop_time=2.0)
    x, u = model.state("x", "1", 1.0, "x"), model.discrete("u", "1", 0.0, "force")
    model.derivative(x, -x + u)
    model.every(0.05, {u: -2 * x})
    model.output("y", "1", x**2, "square")
    return model.freeze()


def relay():
    model = cosim.Model("relay", stop_time=2.0)
    x, on = model.state("x", "1", 0.5, "x"), model.discrete("on", "1", 1.0, "on")
    model.derivative(x, on - x)
    model.when(x > 0.8, {on: 0})
    model.when(x < 0.3, {on: 1})
    return model.freeze()


@pytest.mark.quick_rows("ball-3")
@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("build", [ball, sampled, relay])
def test_own_files_with_events_have_no_finding(build, fmi, tmp_path):
    path = cosim.export_fmu(build(), tmp_path / "own.fmu", fmi=fmi)
    trials = (start, defaults, initialization, switching, calls)
    answer = try_apart(path, timeout=24, trials=trials)
    assert [*examine(path), *answer.findings] == []
    assert any(text.startswith("switching (CoSimulation)") for text in answer.passed)


@pytest.mark.slow
def test_an_own_file_that_ends_its_run_within_the_first_steps_has_no_finding(tmp_path):
    model = cosim.Model("brief", stop_time=2.0)
    x = model.state("x", "1", 0.0, "x")
    model.derivative(x, 1.0)
    model.stop(x > 0.5, "it is over")
    path = cosim.export_fmu(model.freeze(), tmp_path / "brief.fmu")
    assert try_apart(path, timeout=24, trials=(start, time, switching)).findings == []


@pytest.mark.slow
def test_messages_of_an_own_file_about_its_events_are_no_memory_that_it_loses(tmp_path):
    path = cosim.export_fmu(sampled(), tmp_path / "own.fmu", fmi=3)
    assert try_apart(path, timeout=48, trials=(start, steps)).findings == []


FAULTS = {
    "constant indicators": (
        ball,
        {"fmi2GetEventIndicators": "fmi2Status s = CALL; for (size_t i = 0; i < n; ++i) z[i] = 1; "
         "return s;"},
    ),
    "a sample that is 1 ms late": (
        sampled,
        {"fmi2NewDiscreteStates": "fmi2Status s = CALL; info->nextEventTime += 1e-3; return s;"},
    ),
    "a jump that is not reported": (
        ball,
        {"fmi2NewDiscreteStates": "fmi2Status s = CALL; "
         "info->valuesOfContinuousStatesChanged = fmi2False; return s;"},
    ),
    "a rebound that is 10 % too slow": (
        ball,
        {"fmi2NewDiscreteStates": "double x[2]; fmi2Status s = CALL; "
         "if (info->valuesOfContinuousStatesChanged) { fmi2GetContinuousStates(c, x, 2); "
         "x[1] *= 0.9; fmi2SetContinuousStates(c, x, 2); } return s;"},
    ),
}  # fmt: skip


@pytest.mark.quick_rows("a jump that is not reported")
@pytest.mark.parametrize("fault", FAULTS)
def test_fault_at_an_event_is_found(fault, tmp_path):
    build, bodies = FAULTS[fault]
    path = wrapped(tmp_path, {}, build(), **bodies)
    answer = try_apart(path, timeout=60, trials=(start, switching))
    assert [(f.level, f.rule) for f in answer.findings] == [(WRONG, "switching")]
    assert switching in TRIALS


def test_a_derivative_that_is_right_at_the_start_only_is_found(tmp_path):
    body = (
        "fmi2Status s = CALL; fmi2ValueReference r = REF(x); double x; fmi2GetReal(c, &r, 1, &x); "
        "for (size_t i = 0; i < m; ++i) value[i] *= x; return s;"  # x is 1 at the start
    )
    path = wrapped(tmp_path, fmi2GetDirectionalDerivative=body)
    answer = try_apart(path, timeout=24, trials=(start, derivatives))
    assert {(f.level, f.rule) for f in answer.findings} == {(WRONG, "derivatives")}


def swing():
    model = cosim.Model("swing", stop_time=1.0)
    x, k = model.state("x", "rad", 1.0, "x"), model.parameter("k", "1/s", 2.0, "rate")
    v = model.state("v", "rad/s", 0.0, "v")
    model.derivative(x, v)
    model.derivative(v, -k * ca.sin(x) - k * v)
    return model.freeze()


@pytest.mark.quick_share(0.3)
@pytest.mark.slow_rows(
    "true-constant dependent-places0",
    "true-fixed dependent-places1",
    "true-dependent tunable-places4",
    "true-dependent dependent-places5",
)
@pytest.mark.parametrize(
    ("kinds", "places"),
    [
        ("constant dependent", {"der(v)"}),
        ("fixed dependent", {"der(v)"}),
        ("dependent constant", {"der(v)"}),  # the factor is a parameter
        ("dependent fixed", set()),
        ("dependent tunable", set()),
        ("dependent dependent", set()),
    ],
)
@pytest.mark.parametrize("directional", ["true", "false"])
def test_dependency_that_is_not_as_linear_as_declared_is_found(
    kinds, places, directional, tmp_path
):
    def edit(root):
        root.find("ModelExchange").set("providesDirectionalDerivative", directional)
        root.findall("ModelStructure/Derivatives/Unknown")[1].set("dependenciesKind", kinds)

    own = cosim.export_fmu(swing(), tmp_path / "own.fmu")
    path = with_description(own, tmp_path / "edited.fmu", edit)
    answer = try_apart(path, timeout=24, trials=(start, dependencies))
    assert {(f.level, f.rule) for f in answer.findings} <= {(WRONG, "dependencies")}
    assert {f.place for f in answer.findings} == places


def test_a_slow_compiler_is_no_fault_of_the_file(tmp_path, monkeypatch):
    compiler = tmp_path / "slow"
    compiler.write_text("#!/bin/sh\nsleep 60\n")
    compiler.chmod(0o755)
    path = cosim.export_fmu(swing(), tmp_path / "own.fmu")
    monkeypatch.setenv("CC", str(compiler))
    answer = try_apart(path, timeout=5, trials=(start, sources))
    assert answer.findings == []
    assert any("the time is up; --timeout gives more" in text for text in answer.skipped)


def test_a_file_for_another_platform_gets_a_remedy_that_its_user_has(tmp_path):
    own = cosim.export_fmu(swing(), tmp_path / "own.fmu")
    with zipfile.ZipFile(own) as archive:
        libraries = [n for n in archive.namelist() if n.startswith("binaries/")]
    elsewhere = dict.fromkeys(libraries) | {"binaries/beos/swing.so": b"x"}
    path = rewritten(own, tmp_path / "beos.fmu", elsewhere)
    with pytest.raises(FmuError, match=r"only for beos, none for .*; export it with --platform"):
        try_apart(path, timeout=24.0)
    other = set_attributes(".", generationTool="another")
    path = with_description(path, tmp_path / "other.fmu", other)
    with pytest.raises(FmuError, match=r"; run it there, or ask its author for one for this"):
        try_apart(path, timeout=24.0)
    bare = with_description(rewritten(own, tmp_path / "b.fmu", dict.fromkeys(libraries)),
                            tmp_path / "bare.fmu", other)  # fmt: skip
    with pytest.raises(FmuError, match=r"for no platform, none .*; compile its sources"):
        try_apart(bare, timeout=24.0)


def test_numbers_that_only_one_interface_has_differ():
    runs = SimpleNamespace(bench=None, outputs=[SimpleNamespace(name="y")])
    exact, allowed = np.ones((50, 1)), np.ones((50, 1))
    found = np.where(np.arange(50)[:, None] < 25, 1.0, np.nan)
    [finding] = compared(runs, np.arange(50.0), exact, found, allowed, "here, ")
    assert (finding.rule, finding.place) == ("switching", "y")
    assert finding.found.startswith("here, from 25 s on, it differs")
    [same] = compared(runs, np.arange(50.0), found, found, allowed, "here, ")
    assert same == "here, 50 points, 0.0% of them differ"


def test_a_step_may_end_where_it_is_to_end_before_time_0():
    session = SimpleNamespace(time=-5.0, kind="CoSimulation")
    session.bench = SimpleNamespace(step_size=lambda kind: 0.1)
    session.instance = SimpleNamespace(doStep=lambda t, size: (False, False, False, t + size))
    assert list(answers_of_a_step(session)) == []


@pytest.mark.parametrize("start", [-1.0, 0.0, 2.0**20])
def test_an_event_at_the_end_of_a_step_happens_there(start):
    """Steps of 0.5 s of x' = 0, whose time event at the first end makes 1 of it."""
    state = {"x": 0.0}

    def update():
        state["x"] = 1.0
        return False, False, False, False, False, 0.0

    instance = SimpleNamespace(
        setTime=lambda _: None,
        enterEventMode=lambda: None,
        updateDiscreteStates=update,
        enterContinuousTimeMode=lambda: None,
    )
    session = SimpleNamespace(
        instance=instance,
        next_event=start + 0.5,
        values=lambda variables: np.array([state["x"] if v == "x" else 0.0 for v in variables]),
        put_states=lambda x: state.update(x=float(x[0])),
        all_of=lambda *_: np.empty(0),
    )
    bench = SimpleNamespace(
        states=lambda: [("x", "der(x)")],
        fmpy=SimpleNamespace(numberOfEventIndicators=0),
        started=lambda _: nullcontext(session),
        step_count=lambda _: 2,
        start=start,
    )
    runs = Switching(bench, [], np.inf)
    runs.access = lambda _: SimpleNamespace(get=lambda: [state["x"]])
    assert runs.stepped(0.5, euler=True).ravel().tolist() == [1.0, 1.0]
