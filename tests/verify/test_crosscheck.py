"""The crosscheck: every backend of every formulation, a verdict for each, whatever fails."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import cosim
from casadi_models.dae import Model
from cosim.cli.arguments import named_scene
from cosim.cli.main import main
from cosim.errors import FmuError, ParameterError, SolverError, UnknownName, UsageError
from cosim.trajectory import Column, Trajectory
from cosim.verify import crosscheck as crosschecks
from cosim.verify.comparison import Check, compare
from cosim.verify.crosscheck import crosscheck
from cosim.verify.reference import Reference
from cosim.verify.reference_result import check_file, export_with_reference

SHORT = {"stop_time": 0.1, "output_interval": 0.05}


def verdicts(checks: list[Check]) -> list[tuple[str, str, str, str]]:
    return [(c.model.partition("/")[2], c.backend, c.against, c.verdict) for c in checks]


@pytest.mark.slow
def test_every_formulation_takes_every_backend():
    assert verdicts(list(crosscheck(["crank_shaft"], **SHORT))) == [
        ("driven", "fmu-me", "cvodes", "ok"),
        ("driven", "fmu-cs", "cvodes", "ok"),
        ("multipliers", "fmu-me", "idas", "ok"),
        ("multipliers", "fmu-cs", "idas", "ok"),
        ("multipliers", "native", "crank_shaft/driven", "ok"),
    ]


def test_check_shows_the_largest_difference_and_the_cost_of_the_run():
    row = next(crosscheck("crank_shaft/driven", **SHORT)).row()
    assert row["model"] == "crank_shaft/driven"
    assert row["worst"] in cosim.load("crank_shaft/driven").observed
    assert 0 <= row["difference"] < row["bound"] == 1e-6
    assert 0 <= row["at"] <= 0.1
    assert row["rhs_calls"] > 10
    assert row["wall_time"] > 0


def test_checks_are_stored_and_shown_as_a_table():
    checks = crosscheck("crank_shaft/driven", **SHORT)
    first = next(checks)
    assert [check.backend for check in checks] == ["fmu-me", "fmu-cs"]
    assert next(iter(checks)) is first  # computed once
    assert next(checks).backend == "fmu-cs"
    shown = repr(checks).splitlines()
    assert shown[0].split()[:3] == ["model", "backend", "against"]
    assert len(shown) == 3
    assert "<td>fmu-cs</td>" in checks._repr_html_()
    assert checks.agree


def shifted(monkeypatch, shift):
    """Let every FMU's run be wrong by a constant."""
    original = crosschecks.run_file

    def run_file(request, path: Path, interface):
        run = original(request, path, interface)
        return replace(run, values=run.values + shift)

    monkeypatch.setattr(crosschecks, "run_file", run_file)


def test_difference_beyond_the_bound_is_a_verdict_of_its_own(monkeypatch):
    shifted(monkeypatch, 1e-3)
    checks = list(crosscheck(["crank_shaft/driven"], **SHORT))
    assert {check.verdict for check in checks} == {"DIFFERS"}
    assert all("try --relative-tolerance 1e-11" in check.note for check in checks)
    assert all(check.against == "dop853 at 3e-14" for check in checks)


@pytest.mark.parametrize(
    ("own", "remedy"), [(1e-12, "--relative-tolerance 1e-13 or "), (1e-13, "")]
)
def test_no_tolerance_below_rounding_is_tried_or_advised(own, remedy, monkeypatch, tmp_path):
    shifted(monkeypatch, 1e-3)
    words = f'model = cosim.Model("tight", stop_time=0.5, reference_tolerance={own})\n'
    file = tmp_path / "tight.py"
    file.write_text(
        f"import cosim\ndef build():\n    {words}    x = model.state('x', '1', 1.0, 'x')\n"
        "    model.derivative(x, -x)\n    return model.freeze()\n"
    )
    for check in crosscheck(f"{file}:build"):
        assert check.note.startswith(f"try {remedy}a shorter run")


def test_smallest_difference_that_the_reference_resolves_is_reported():
    checks = list(crosscheck(["crank_shaft/driven"], bound=1e-16, **SHORT))
    assert "DIFFERS" in {check.verdict for check in checks}


def test_difference_that_no_reference_resolves_is_not_held_against_the_fmu(monkeypatch):
    original = crosschecks.reference

    def coarse(scene):
        best = original(scene)
        return replace(best, errors=dict.fromkeys(best.errors, 1e-2))

    shifted(monkeypatch, 1e-3)
    monkeypatch.setattr(crosschecks, "reference", coarse)
    checks = list(crosscheck(["crank_shaft/driven"], **SHORT))
    assert {check.verdict for check in checks} == {"reference too coarse"}
    assert all("the reference may be wrong by" in check.note for check in checks)


def test_fmu_nearer_to_the_truth_than_the_plain_run_is_right(monkeypatch):
    original = crosschecks.execute

    def execute(request):
        run = original(request)
        return replace(run, values=run.values + 1e-3)

    monkeypatch.setattr(crosschecks, "execute", execute)
    checks = list(crosscheck(["crank_shaft/driven"], **SHORT))
    assert [(c.verdict, c.against) for c in checks] == 2 * [("ok", "dop853 at 3e-14")]


@pytest.mark.slow
def test_tolerance_of_a_sensitive_motion_is_found(monkeypatch):
    original = crosschecks.run_file

    def run_file(request, path: Path, interface):
        run = original(request, path, interface)
        return replace(run, values=run.values + 3e4 * request.tolerance.relative)

    monkeypatch.setattr(crosschecks, "run_file", run_file)
    checks = list(crosscheck(["crank_shaft/driven"], **SHORT))
    assert {(c.verdict, c.note) for c in checks} == {("ok", "at relative tolerance 1e-11")}
    checks = list(crosscheck(["crank_shaft/driven"], relative_tolerance=1e-10, **SHORT))
    assert {c.verdict for c in checks} == {"DIFFERS"}  # at the requested tolerance


@pytest.mark.slow
def test_forms_of_one_file_are_compared(tmp_path):
    (tmp_path / "twin.py").write_text(TWIN)
    names = [f"{tmp_path / 'twin.py'}:{form}" for form in ("slow", "shifted", "other")]
    checks = [c for c in crosscheck(names, **SHORT) if c.backend.native]
    assert [(c.model, c.against, c.verdict) for c in checks] == [
        ("twin/shifted", "twin/slow", "ok")
    ]


TWIN = """
from casadi_models.dae import Model

def build(form, rate, name="twin"):
    model = Model(name, form, stop_time=1.0)
    x = model.state("x", "m", 1.0, "place")
    model.derivative(x, -rate * x)
    return model.freeze()

def slow():
    return build("slow", 1.0)

def shifted():
    return build("shifted", 1.0 + 1e-12)

def other():
    return build("slow", 2.0, "another")
"""


@pytest.fixture
def failing_fmus(monkeypatch):
    """Let every FMU fail in co-simulation."""
    original = crosschecks.run_file

    def run_file(request, path: Path, interface):
        if interface == "CoSimulation":
            raise FmuError("the step came no further")
        return original(request, path, interface)

    monkeypatch.setattr(crosschecks, "run_file", run_file)


@pytest.mark.slow
@pytest.mark.usefixtures("failing_fmus")
def test_run_that_fails_does_not_end_the_others():
    checks = list(crosscheck(["crank_shaft"], **SHORT))
    assert [check.verdict for check in checks] == ["ok", "FAILED", "ok", "FAILED", "ok"]
    assert checks[1].failure == "the step came no further"
    assert checks[1].row()["worst"] is None


@pytest.mark.slow
def test_model_that_fails_on_our_backend_is_a_failed_check(monkeypatch):
    original = crosschecks.execute

    def execute(request):
        if request.dae.formulation == "driven":
            raise SolverError("CV_TOO_MUCH_WORK")
        return original(request)

    monkeypatch.setattr(crosschecks, "execute", execute)
    checks = list(crosscheck(["crank_shaft"], **SHORT))
    assert [(c.backend, c.verdict) for c in checks] == [
        ("native", "FAILED"),
        ("fmu-me", "ok"),
        ("fmu-cs", "ok"),
    ]


@pytest.mark.slow
def test_name_with_a_meaning_of_its_own_is_not_compared_between_formulations():
    scene = named_scene("double_pendulum_7_2.toml")
    checks = list(crosscheck([scene], **SHORT))
    assert {check.verdict for check in checks} == {"ok"}
    axial = next(c for c in checks if c.model.endswith("_axial") and c.backend.native)
    angles = [f"{name}{link}" for name in ("psi", "theta", "phi") for link in (1, 2)]
    assert {*axial.left_out} == {*angles, "singularity_1", "singularity_2"}
    assert "points along -" in axial.left_out["psi1"]
    assert axial.row()["left_out"].split() == [*axial.left_out]
    assert not {d.name for d in axial.comparison.differences} & {*axial.left_out}
    assert "x_tip" in {d.name for d in axial.comparison.differences}


@pytest.mark.parametrize("bound", [0.0, -1.0, float("nan"), float("inf"), True])
def test_bound_must_be_a_positive_number(bound):
    with pytest.raises(ParameterError, match="bound"):
        next(crosscheck(["crank_shaft"], bound=bound))


def test_unknown_model_is_rejected():
    with pytest.raises(UnknownName, match="did you mean crank_shaft"):
        next(crosscheck(["crank_shift"]))


def test_unknown_model_is_rejected_before_the_first_one_runs(monkeypatch):
    monkeypatch.setattr("cosim.verify.crosscheck.execute", lambda *_: pytest.fail("it ran"))
    with pytest.raises(UnknownName, match="did you mean bicycle"):
        next(crosscheck(["crank_shaft", "bicycle/multipliers", "bicylce"]))


def command(*options: str) -> int:
    return main(["crosscheck", "crank_shaft/driven", "--stop-time", "0.1", *options])


def test_command_prints_a_table_and_returns_0(capsys):
    assert command() == 0
    printed = capsys.readouterr()
    assert "verdict" in printed.out.splitlines()[0]
    assert printed.out.count(" ok ") == 2
    assert "crank_shaft/driven: fmu-me against cvodes: " in printed.err


def test_command_returns_4_beyond_the_bound(capsys):
    assert command("--bound", "1e-16", "--json", "-q") == 4
    printed = capsys.readouterr()
    assert "DIFFERS" in {row["verdict"] for row in json.loads(printed.out)}
    assert printed.err == ""


def test_command_returns_4_for_an_fmu_that_differs_and_says_what_to_try(capsys, monkeypatch):
    shifted(monkeypatch, 1e-3)
    assert command() == 4
    printed = capsys.readouterr()
    assert "DIFFERS" in printed.out
    assert "try --relative-tolerance" in printed.out.splitlines()[1]


@pytest.mark.usefixtures("failing_fmus")
def test_command_returns_1_if_a_run_failed(capsys):
    assert command() == 1
    printed = capsys.readouterr()
    assert "FAILED" in printed.out
    assert "the step came no further FAILED" in printed.err


@pytest.mark.slow
def test_runs_that_a_condition_stops_next_to_an_output_time_are_compared(tmp_path):
    """Rounding decides whether the stop is a row of its own."""
    file = tmp_path / "stop.py"
    file.write_text(
        "import cosim\n\n\ndef build():\n"
        "    model = cosim.Model('st', stop_time=2.0)\n"
        "    x = model.state('x', '1', 0.0, 'x')\n"
        "    model.derivative(x, 1.0)\n"
        "    model.stop(x > 1.0, 'done')\n"
        "    return model.freeze()\n"
    )
    checks = list(cosim.crosscheck(f"{file}:build"))
    assert [str(check.verdict) for check in checks] == ["ok", "ok"]


@pytest.mark.parametrize("later", [1.005, 1.3])  # within an output interval, and beyond
def test_a_run_that_stops_at_another_time_is_a_failed_check(later, tmp_path, monkeypatch):
    file = tmp_path / "stop.py"
    file.write_text(
        "import cosim\n\n\ndef build():\n"
        "    model = cosim.Model('st', stop_time=2.0)\n"
        "    x, k = model.state('x', '1', 0.0, 'x'), model.parameter('k', '1', 1.0, 'end')\n"
        "    model.derivative(x, 1.0)\n"
        "    model.stop(x > k, 'done')\n"
        "    return model.freeze()\n"
    )
    export = crosschecks.export_fmu

    def export_another(dae, path):
        return export(cosim.requested(dae, start_values={"k": later}).configured(), path)

    monkeypatch.setattr(crosschecks, "export_fmu", export_another)
    for check in crosscheck(f"{file}:build"):
        assert check.verdict == "FAILED"
        assert "different output times" in check.reason


def test_runs_that_stop_at_different_times_do_not_agree():
    runs = []
    for end in (0.52, 0.77):
        runs.append(cosim.simulate("crank_shaft", stop_time=1, stop_when=f"phi > 50 * {end}"))
    with pytest.raises(UsageError, match="different output times"):
        cosim.compare(*runs, resample=False)


@pytest.mark.slow
def test_a_row_at_an_event_may_have_either_side_of_it(tmp_path):
    model = Model("swing", stop_time=1.5, output_interval=0.1)
    x, v = model.state("x", "m", 0.0, "place"), model.state("v", "m/s", 1.0, "speed")
    n = model.discrete("n", "1", 0.0, "number")
    model.derivative(x, v)
    model.derivative(v, -x)
    for time in (0.5, 1.3):
        model.when(x > math.sin(time), {n: n + 1}, name="there")
    dae = model.freeze()
    runs = [cosim.simulate(dae, solver=solver) for solver in ("dop853", "cvodes")]
    assert (runs[0]["n"] != runs[1]["n"]).any()  # by their errors
    assert cosim.compare(*runs).agrees
    assert cosim.compare(*reversed(runs)).agrees
    shifted = replace(runs[1], values=runs[1].values + np.array([0.0, 0.0, 2.0]))
    assert not cosim.compare(runs[0], shifted).agrees
    path = export_with_reference(dae, tmp_path / "swing.fmu")
    assert [check.verdict for check in check_file(path)] == ["ok", "ok"]
    assert [len(check.comparison.event_times[0]) for check in check_file(path)] == [2, 2]


def test_no_model_makes_no_check():
    assert crosscheck([]).rows() == []


def test_a_tolerance_of_0_is_rejected():
    with pytest.raises(ParameterError, match="both tolerances are 0"):
        next(crosscheck("crank_shaft/driven", relative_tolerance=0.0, **SHORT))


def test_the_error_of_a_reference_counts_relative_to_the_size_of_a_small_state(monkeypatch):
    columns = [Column("phi", "rad", is_state=True)]
    truth, other = (
        Trajectory("m", [0, 1], columns, [[1e-3], [1e-3 + gap]], {"relative_tolerance": 1e-12})
        for gap in (0, 1.5e-9)
    )
    best = Reference(truth, "a", "b", {"phi": 1e-9}, "")  # in nominal values, 1 rad
    monkeypatch.setattr(crosschecks, "reference", lambda _: best)
    check = Check("m", "native", "b", compare(truth, other))
    request = cosim.requested("crank_shaft")
    found = crosschecks._against_reference(request, ["phi"], check, other, None)
    assert found.comparison.worst.scaled == pytest.approx(1.5e-6, rel=1e-5)
    assert found.doubt == pytest.approx(1e-6, rel=1e-5)
    assert found.verdict == "reference too coarse"
