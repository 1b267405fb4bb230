"""`tradeoff`: reproducible counts, correct errors, and a reason for every missing result."""

import base64
import io
import json
import re
import sys
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from helpers.oscillators import oscillator
from PIL import Image

import cosim
from cosim.backend import Backend
from cosim.cli.main import main
from cosim.errors import MissingTool, ParameterError, SolverError, UnknownName, UsageError
from cosim.present.study_figures import draw_tradeoff
from cosim.study.pareto import pareto_front
from cosim.study.tradeoff.configuration import Configuration, Selection
from cosim.study.tradeoff.measurement import (
    COSTS,
    Measurement,
    Outcome,
    Timing,
    at_common_times,
    combined,
    invariants,
    measurement_of,
)
from cosim.study.tradeoff.study import run_configuration, tradeoff
from cosim.verify.reference import reference

sys.path.insert(0, str(Path(__file__).parents[3] / "benchmarks"))
from proportionality import proportionality

TOLERANCES = (1e-4, 1e-5, 1e-7, 1e-9)  # at 1e-3 a handful of steps are no asymptote
SPRING = oscillator().dae
SMALL = Selection(("erk", "rk4"), TOLERANCES, (0.02, 0.01, 0.005), ("native",))


def bar(**changes):
    return cosim.requested("bar_on_frame/reduced", stop_time=1.0, **changes)


def erk(tolerance=1e-3):
    request = cosim.requested(SPRING, solver="erk", relative_tolerance=tolerance)
    return Configuration(request, Backend.NATIVE)


@pytest.fixture(scope="module")
def study():
    return tradeoff(bar(), selection=SMALL, every_formulation=False, repeats=2)


def measured(cost, error):
    return Measurement(
        erk(), Outcome(), {"x": error}, rhs_calls=cost,
        solver_time=Timing(cost, cost, cost, 1),
    )  # fmt: skip


@pytest.mark.slow
def test_notebook_shows_the_picture_and_the_pareto_front(study):
    shown = study._repr_html_()
    content = base64.b64decode(re.search(r'src="data:image/png;base64,([^"]+)"', shown)[1])
    picture = np.asarray(Image.open(io.BytesIO(content)).convert("L"))
    assert picture.shape[1] > 300
    assert (picture < 128).mean() > 0.005  # axes, words and lines
    assert shown.count("<tr>") > 1


def test_counts_and_errors_repeat_exactly(study):
    again = tradeoff(bar(), selection=SMALL, every_formulation=False, repeats=1)
    assert [m.rhs_calls for m in again.measurements] == [m.rhs_calls for m in study.measurements]
    assert [m.errors for m in again.measurements] == [m.errors for m in study.measurements]


def test_cost_of_a_fixed_step_method_is_its_stages_times_its_steps(study):
    calls = {m.configuration.step: m.rhs_calls for m in study.measurements}
    assert {h: calls[h] for h in (0.02, 0.01, 0.005)} == {0.02: 200, 0.01: 400, 0.005: 800}


def test_error_is_the_largest_difference_in_nominal_values():
    """A run that is off by known amounts, at known times."""
    truth = reference(bar())
    values = truth.run.values.copy()
    outputs = ("theta", "tk_G_F")
    shift = {"theta": 3e-4, "tk_G_F": -2e-2}
    for name, amount in shift.items():
        values[40, truth.run.names.index(name)] += amount
    run = type(truth.run)("bar", truth.run.time, truth.run.columns, values, {"wall_time": 1.0})
    measurement = measurement_of(erk(), run, truth, outputs, ())
    expected = {n: abs(a) / truth.run.column(n).nominal for n, a in shift.items()}
    assert measurement.errors == pytest.approx(expected, rel=1e-9)


def test_longer_steps_are_compared_where_they_have_output_and_do_not_compete(study):
    (coarse,) = (m for m in study.measurements if m.configuration.step == 0.02)
    assert coarse.points == 51
    assert len(study.reference.run) == 101
    assert coarse not in study.competing
    finer = [m.error for m in study.measurements if m.configuration.solver == "rk4"]
    assert finer == sorted(finer, reverse=True)


def test_error_falls_in_proportion_to_the_tolerance(study):
    (fit,) = proportionality(study.measurements, study.reference_error)
    assert fit.solver == "erk"
    assert fit.slope == pytest.approx(1.0, abs=0.15)  # measured 1.04


def front_of(points, floor):
    return pareto_front(points, lambda m: m.rhs_calls, lambda m: m.error, floor)


@pytest.mark.parametrize("seed", range(20))
def test_nothing_beats_a_point_of_the_pareto_front(seed):
    random = np.random.default_rng(seed)
    points = [measured(c, e) for c, e in random.integers(1, 15, (30, 2)).astype(float)]
    front = front_of(points, 0.0)
    for on, other in product(front, points):
        assert not (other.rhs_calls <= on.rhs_calls and other.error < on.error)
        assert not (other.rhs_calls < on.rhs_calls and other.error <= on.error)
    for point in points:
        assert any(f.rhs_calls <= point.rhs_calls and f.error <= point.error for f in front)


def test_errors_below_the_floor_win_nothing():
    points = [measured(1.0, 1e-12), measured(2.0, 1e-13), measured(3.0, 1e-16)]
    assert front_of(points, 1e-12) == (points[0],)


def test_fit_leaves_out_errors_near_that_of_the_reference():
    def at(tolerance, error):
        configuration = erk(tolerance)
        return Measurement(configuration, Outcome(), {"x": error})

    points = [at(10.0**-k, max(3 * 10.0**-k, 1e-9)) for k in range(2, 12)]
    (fit,) = proportionality(points, 1e-9)
    assert (fit.slope, fit.constant) == pytest.approx((1.0, 3.0))
    assert fit.points == 7  # 3e-2 to 3e-8, above ten times the floor and below 0.1


@pytest.mark.slow
def test_what_the_equations_conserve_is_found():
    request = cosim.requested("double_pendulum/quaternion", stop_time=1.0)
    found = set(invariants(reference(request)))
    conserved = {"energy", "angular_momentum_z", "w1_z", "w2_z"}
    assert conserved - found <= {"w1_z", "w2_z"}  # without any rounding they are no residuals
    assert not found & {"w1_x", "x_tip", "kinetic_energy", "q1_w", "fz_O"}


def test_failed_configuration_says_why_and_stops_nothing(monkeypatch):
    def failing(configuration, folder):
        if configuration.tolerance == 1e-5:
            raise SolverError("it gave up")
        return run_configuration(configuration, folder)

    monkeypatch.setattr("cosim.study.tradeoff.study.run_configuration", failing)
    study = tradeoff(bar(), selection=SMALL, every_formulation=False, repeats=1)
    failed = [m for m in study.measurements if m.outcome.reason]
    assert [(m.configuration.tolerance, str(m.outcome)) for m in failed] == [
        (1e-5, "SolverError: it gave up")
    ]
    assert failed[0].error is None
    assert len(study.measurements) == 7


def test_tighter_tolerances_are_left_out_if_a_looser_one_was_slow(monkeypatch):
    monkeypatch.setattr("cosim.study.tradeoff.study.SLOW", 0.0)
    study = tradeoff(bar(), selection=SMALL, every_formulation=False, repeats=0)
    ran = {m.configuration for m in study.measurements if m.outcome == Outcome()}
    assert {(c.tolerance, c.step) for c in ran} == {(TOLERANCES[0], None), (None, 0.02)}
    assert "more than 0 s" in study.measurements[1].outcome.reason
    reasons = {row["configuration"] for row in study.missing()}
    assert reasons == {
        "bar_on_frame/reduced native erk 1e-05 ... 1e-09",
        "bar_on_frame/reduced native rk4 0.01 s ... 0.005 s",
    }


def test_time_to_compile_does_not_make_a_run_slow(monkeypatch):
    def compiling(configuration, folder):
        run = run_configuration(configuration, folder)
        return replace(run, stats=replace(run.stats, wall_time=1000.0))

    monkeypatch.setattr("cosim.study.tradeoff.study.run_configuration", compiling)
    study = tradeoff(bar(), selection=SMALL, every_formulation=False, repeats=1)
    assert {m.outcome for m in study.measurements} == {Outcome()}
    assert {m.total_time.repeats for m in study.measurements} == {1}


def test_interpreted_runs_are_left_out_if_the_compiled_run_was_slow(monkeypatch):
    monkeypatch.setattr("cosim.study.tradeoff.study.SLOW", 0.0)
    selection = Selection(("erk",), (1e-3,), backends=("native", "native-interpreted"))
    study = tradeoff(bar(), selection=selection, every_formulation=False, repeats=0)
    assert [m.error is None for m in study.measurements] == [False, True]
    assert "reduced native erk 1e-03 took" in study.measurements[1].outcome.reason


def test_study_without_time_lists_what_it_left_out():
    study = tradeoff(bar(), selection=SMALL, every_formulation=False, repeats=1, seconds=0.0)
    assert {str(m.outcome) for m in study.measurements} == {
        "left out: the time limit was reached; increase seconds"
    }


def test_slow_failure_prevents_runs_at_tighter_tolerances(monkeypatch):
    def failing(configuration, folder):
        run = reference(bar()).run
        raise SolverError("it gave up", replace(run, stats={"solve_time": 6.0}))

    monkeypatch.setattr("cosim.study.tradeoff.study.run_configuration", failing)
    study = tradeoff(bar(), selection=SMALL, every_formulation=False, repeats=0)
    reasons = [m.outcome.kind for m in study.measurements]
    assert reasons == ["SolverError", *3 * ["left out"], "SolverError", *2 * ["left out"]]


@pytest.mark.slow
def test_what_cannot_be_measured_is_listed_with_its_reason():
    selection = Selection(("erk", "dop853"), (1e-4,), backends=("native", "native-interpreted"))
    study = tradeoff("crank_shaft", selection=selection, repeats=0)
    reasons = {row["configuration"]: row["reason"] for row in study.missing()}
    assert reasons == {
        "crank_shaft/driven native-interpreted dop853": "exists as compiled code only",
        "crank_shaft/multipliers erk": "cannot integrate algebraic unknowns",
        "crank_shaft/multipliers native-interpreted dop853": "exists as compiled code only",
    }


def test_median_and_spread_leave_the_first_run_out():
    configuration = erk()
    times = (9.0, 1.0, 3.0, 2.0)  # the first run may have compiled
    plain = Measurement(configuration, errors={"x": 0.1})
    timings = [Timing(t, t, t, 1) for t in times]
    runs = [replace(plain, solver_time=t, total_time=t, first_time=t.median) for t in timings]
    measurement = combined(runs)
    assert measurement.solver_time == Timing(2.0, 1.0, 3.0, 3)
    assert measurement.first_time == 9.0


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        ({"solvers": ("erkk",)}, UnknownName),
        ({"backends": ("fmi",)}, UnknownName),
        ({"tolerances": (0.5,)}, ParameterError),
        ({"tolerances": (0.0,)}, ParameterError),
        ({"steps": (0.0,)}, ParameterError),
        ({"steps": (float("nan"),)}, ParameterError),
    ],
)
def test_selection_rejects_unknown_names(arguments, error):
    with pytest.raises(error):
        Selection(**arguments)


@pytest.mark.slow
def test_selection_that_fits_no_formulation_is_rejected():
    with pytest.raises(UsageError, match="nothing to measure with solvers erk"):
        tradeoff("crank_shaft/multipliers", selection=Selection(("erk",)))


@pytest.mark.slow
def test_without_a_compiler_only_interpreted_equations_are_measured(monkeypatch):
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr("cosim.codegen.compiler.find_spec", lambda _: None)
    lines = []
    selection = Selection(("rk4",), steps=(0.01,))
    study = tradeoff(
        bar(), selection=selection, every_formulation=False, repeats=0, progress=lines.append
    )
    assert "no C compiler: interpreted equations only" in lines
    assert {m.configuration.backend for m in study.measurements} == {"native-interpreted"}
    assert ("native, fmu-me, fmu-cs", "no C compiler") in study.impossible
    with pytest.raises(MissingTool, match="no C compiler found"):
        tradeoff(bar(), selection=Selection(backends=("native",)))


@pytest.mark.slow
def test_requested_outputs_are_measured_on_the_full_and_on_the_reduced_model():
    selection = Selection((), (1e-6,), (0.01,), ("native", "fmu-me"))
    study = tradeoff(
        bar(outputs=["theta"]), selection=selection, every_formulation=False, repeats=0
    )
    found = {(m.configuration.backend, m.configuration.reduced) for m in study.measurements}
    assert found == set(product(("native", "fmu-me"), (False, True)))
    assert {tuple(m.errors) for m in study.measurements} == {("theta",)}


def test_command_writes_table_file_and_figure(tmp_path, capsys):
    table, data, figure = (str(tmp_path / name) for name in ("t.csv", "t.json", "t.png"))
    words = "tradeoff bar_on_frame/reduced --stop-time 1 --solvers erk --backends native"
    common = [*words.split(), "--tolerances", "1e-3,1e-6", "--repeats", "1"]
    assert main([*common, "-v", "--output-file", table, "--figure", figure]) == 0
    captured = capsys.readouterr()
    assert "Pareto front, error against rhs_calls" in captured.out
    assert "2/2 bar_on_frame/reduced native erk 1e-06: error" in captured.err
    lines = (tmp_path / "t.csv").read_text().splitlines()
    assert any(line.startswith("# model hash: ") for line in lines)
    assert sum(not line.startswith("#") for line in lines) == 3
    assert (tmp_path / "t.png").read_bytes().startswith(b"\x89PNG")
    assert main([*common, "-q", "--json", "--output-file", data]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts == json.loads((tmp_path / "t.json").read_text()) | {
        "measurements": facts["measurements"]
    }
    assert {"casadi", "fmpy", "cosim-rigid", "platform", "compiler"} <= set(facts["provenance"])
    assert set(facts["pareto_fronts"]) == set(COSTS)


def test_figure_shows_one_line_for_each_solver_and_says_what_is_cheapest(study):
    figure = draw_tradeoff(study)
    axis = figure.axes[0]
    labels = [line.get_label() for line in axis.lines]
    solvers = {m.configuration.solver for m in study.competing}
    assert sorted(label.partition(",")[0] for label in labels[:-2]) == sorted(solvers)
    assert labels[-2:] == ["Pareto front", "other configurations"]
    looks = {(line.get_color(), line.get_marker()) for line in axis.lines}
    assert len(looks) == len(axis.lines)  # every entry of the legend is different
    for line in axis.lines[:-1]:
        assert (np.diff(line.get_xdata()) > 0).all()
        assert (np.diff(line.get_ydata()) < 0).all()
    front = study.pareto_front("solver_time")
    for answer in (text.get_text() for text in figure.legends[1].get_texts()):
        wanted, _, rest = answer.partition(": ")
        good = [m for m in front if study.shown_error(m) <= float(wanted)]
        cheapest = min(good, key=lambda m: m.solver_time.median)
        assert rest.startswith(
            f"{cheapest.configuration.solver} at {cheapest.configuration.setting}, "
        )
    tops = [patch.get_y() + patch.get_height() for patch in axis.patches]
    assert study.reference_error in tops


@pytest.mark.parametrize(
    ("words", "code"),
    [
        ("--figure t.bmp", 3),
        ("--solvers erkk", 3),
        ("--tolerances 1e-3,x", 2),
        ("--tolerances 1e-3 --relative-tolerance 1e-4", 2),
        ("--outputs thetta", 3),
    ],
)
def test_wrong_options_are_rejected_before_any_run(words, code, capsys):
    assert main(["tradeoff", "bar_on_frame/reduced", *words.split()]) == code
    assert "reference" not in capsys.readouterr().err


def test_one_relative_tolerance_is_the_only_one_that_is_measured(tmp_path):
    path = tmp_path / "t.json"
    words = (
        "--relative-tolerance 1e-5 --solvers erk --backends native --repeats 1 --stop-time 0.5 -q"
    )
    call = ["tradeoff", "bar_on_frame/reduced", *words.split(), "--output-file", str(path)]
    assert main(call) == 0
    assert {row["tolerance"] for row in json.loads(path.read_text())["measurements"]} == {1e-5}


def test_fmu_for_co_simulation_is_listed_under_the_solver_inside_it():
    fmu = Configuration(erk().request, Backend.CO_SIMULATION)
    assert fmu.solver == "dop853"


@pytest.mark.parametrize("span", [1e-10, 1.0, 1e6])
def test_reference_is_compared_at_the_times_of_the_run(span):
    columns = (cosim.Column("t", "s"),)
    time = np.linspace(0, span, 11)
    reference = cosim.Trajectory("clock", time, columns, time[:, None])
    run = cosim.Trajectory("clock", time[::2], columns, time[::2, None])
    np.testing.assert_array_equal(at_common_times(reference, run)[0].values, run.values)
    others = np.append(np.arange(0, 10, 2.5), 10) / 10 * span
    run = cosim.Trajectory("clock", others, columns, others[:, None])
    truth, own = at_common_times(reference, run)
    assert own.time / span == pytest.approx([0, 0.5, 1])
    np.testing.assert_allclose(truth["t"], own["t"])
