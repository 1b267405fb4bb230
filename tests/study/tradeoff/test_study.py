"""`tradeoff`: counts repeat, errors are what they are said to be, nothing is lost on the way."""

import base64
import io
import json
import re
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from PIL import Image

from cosim.cli.main import main
from cosim.errors import MissingTool, ParameterError, SolverError, UnknownName, UsageError
from cosim.model.catalogue import load
from cosim.present.work_precision import draw_tradeoff
from cosim.present.work_precision_front import draw_front
from cosim.scene.scene import Scene, Settings
from cosim.study.tradeoff.configuration import Configuration, Selection
from cosim.study.tradeoff.measurement import (
    COSTS,
    Measurement,
    Timing,
    gather,
    invariants,
    observed_event,
)
from cosim.study.tradeoff.record import Event, Outcome, Record
from cosim.study.tradeoff.result import pareto_front, proportionality
from cosim.study.tradeoff.study import study_record, tradeoff
from cosim.study.tradeoff.variants import Workshop
from cosim.verify.reference import reference

TOLERANCES = (1e-4, 1e-5, 1e-7, 1e-9)  # at 1e-3 a handful of steps are no asymptote
SMALL = Selection(("erk", "rk4"), TOLERANCES, (0.02, 0.01, 0.005), ("native",))


def bar(**changes) -> Scene:
    settings = Settings(stop_time=1.0)
    return Scene("bar", load("bar_on_frame/reduced"), settings=settings, **changes)


@pytest.fixture(scope="module")
def study():
    return tradeoff(bar(), selection=SMALL, every_formulation=False, repeats=2)


def measured(cost, error, name="m"):
    configuration = Configuration(name, False, "native", "erk", 1e-3)
    return Measurement(
        configuration, Outcome(), error, "x", {"x": error}, rhs_calls=cost,
        solver_time=Timing(cost, cost, cost, 1),
    )  # fmt: skip


def test_notebook_shows_the_picture_and_the_front(study):
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
    kept = ("theta", "tk_G_F")
    shift = {"theta": 3e-4, "tk_G_F": -2e-2}
    for name, amount in shift.items():
        values[40, truth.run.names.index(name)] += amount
    run = type(truth.run)("bar", truth.run.time, truth.run.columns, values, {"wall_time": 1.0})
    event = observed_event(Configuration("bar", False, "native", "erk"), run, truth, kept, ())
    expected = {n: abs(a) / truth.run.column(n).nominal for n, a in shift.items()}
    assert event.errors == pytest.approx(expected, rel=1e-9)


def test_longer_steps_are_compared_where_they_have_output_and_do_not_compete(study):
    (coarse,) = (m for m in study.measurements if m.configuration.step == 0.02)
    assert coarse.points == 51
    assert len(study.reference.run) == 101
    assert coarse not in study.competing
    finer = [m.error for m in study.measurements if m.configuration.solver == "rk4"]
    assert finer == sorted(finer, reverse=True)


def test_error_falls_in_proportion_to_the_tolerance(study):
    (fit,) = study.proportionality()
    assert fit.solver == "erk"
    assert fit.slope == pytest.approx(1.0, abs=0.15)  # measured 1.04


@pytest.mark.parametrize("seed", range(20))
def test_nothing_beats_a_point_of_the_front(seed):
    random = np.random.default_rng(seed)
    points = [measured(c, e) for c, e in random.integers(1, 15, (30, 2)).astype(float)]
    front = pareto_front(points, "rhs_calls", 0.0)
    for on, other in product(front, points):
        assert not (other.rhs_calls <= on.rhs_calls and other.error < on.error)
        assert not (other.rhs_calls < on.rhs_calls and other.error <= on.error)
    for point in points:
        assert any(f.rhs_calls <= point.rhs_calls and f.error <= point.error for f in front)


def test_errors_below_the_floor_win_nothing():
    points = [measured(1.0, 1e-12), measured(2.0, 1e-13), measured(3.0, 1e-16)]
    assert pareto_front(points, "rhs_calls", 1e-12) == (points[0],)


def test_fit_leaves_out_what_the_reference_cannot_tell():
    def at(tolerance, error):
        configuration = Configuration("m", False, "native", "erk", tolerance)
        return Measurement(configuration, Outcome(), error, "x", {"x": error})

    points = [at(10.0**-k, max(3 * 10.0**-k, 1e-9)) for k in range(2, 12)]
    (fit,) = proportionality(points, 1e-9)
    assert (fit.slope, fit.constant) == pytest.approx((1.0, 3.0))
    assert fit.points == 7  # 3e-2 to 3e-8, above ten times the floor and below 0.1


def test_what_the_equations_conserve_is_found():
    scene = Scene("p", load("double_pendulum/quaternion"), settings=Settings(stop_time=1.0))
    found = set(invariants(reference(scene)))
    conserved = {"energy", "angular_momentum_z", "w1_z", "w2_z"}
    assert conserved - found <= {"w1_z", "w2_z"}  # without any rounding they are no residuals
    assert not found & {"w1_x", "x_tip", "kinetic_energy", "q1_w", "fz_O"}


def test_interrupted_study_goes_on_where_it_stopped(tmp_path, monkeypatch):
    monkeypatch.setenv("COSIM_CACHE", str(tmp_path))
    lines = []

    def interrupt(line):
        lines.append(line)
        if sum("error" in text and "/" in text for text in lines) == 3:
            raise KeyboardInterrupt

    arguments = {"selection": SMALL, "every_formulation": False, "repeats": 1}
    with pytest.raises(KeyboardInterrupt):
        tradeoff(bar(), tell=interrupt, **arguments)
    record = study_record(reference(bar()))
    kept = record.path.read_text()
    with record.path.open("a") as stream:
        stream.write('{"key": "cut off by the interru')
    said = []
    study = tradeoff(bar(), tell=said.append, resume=True, **arguments)
    assert record.path.read_text().startswith(kept)
    assert sum(": error" in line for line in said) == 7 - kept.count("\n")
    assert len(study.measurements) == 7
    assert all(m.total_time.repeats == 1 for m in study.measurements)


def test_study_that_is_not_resumed_begins_anew(tmp_path):
    record = Record(tmp_path / "runs.jsonl", "key")
    record.begin(resume=False)
    event = Event(Configuration("m", False, "native", "erk", 1e-3), errors={"x": 0.1})
    record.append(event)
    assert record.begin(resume=True) == [event]
    assert Record(record.path, "another model").begin(resume=True) == []
    record.append(event)
    assert record.begin(resume=False) == []


def test_failed_configuration_says_why_and_stops_nothing(monkeypatch):
    original = Workshop.run

    def failing(self, configuration):
        if configuration.tolerance == 1e-5:
            raise SolverError("it gave up")
        return original(self, configuration)

    monkeypatch.setattr(Workshop, "run", failing)
    study = tradeoff(bar(), selection=SMALL, every_formulation=False, repeats=1)
    failed = [m for m in study.measurements if m.outcome.reason]
    assert [(m.configuration.tolerance, str(m.outcome)) for m in failed] == [
        (1e-5, "SolverError: it gave up")
    ]
    assert failed[0].error is None
    assert len(study.measurements) == 7


def test_tighter_tolerances_are_left_out_where_a_looser_one_was_slow(monkeypatch):
    monkeypatch.setattr("cosim.study.tradeoff.rounds.SLOW", 0.0)
    study = tradeoff(bar(), selection=SMALL, every_formulation=False, repeats=0)
    ran = {m.configuration for m in study.measurements if m.outcome == Outcome()}
    assert {(c.tolerance, c.step) for c in ran} == {(TOLERANCES[0], None), (None, 0.02)}
    assert "more than 0 s" in study.measurements[1].outcome.reason
    told = {row["configuration"] for row in study.missing()}
    assert told == {
        "bar_on_frame/reduced native erk 1e-05 ... 1e-09",
        "bar_on_frame/reduced native rk4 0.01 s ... 0.005 s",
    }


def test_time_to_compile_does_not_make_a_run_slow(monkeypatch):
    original = Workshop.run

    def compiling(self, configuration):
        run = original(self, configuration)
        return replace(run, stats={**run.stats, "wall_time": 1000.0})

    monkeypatch.setattr(Workshop, "run", compiling)
    study = tradeoff(bar(), selection=SMALL, every_formulation=False, repeats=1)
    assert {m.outcome for m in study.measurements} == {Outcome()}
    assert {m.total_time.repeats for m in study.measurements} == {1}


def test_interpreted_runs_are_left_out_where_their_compiled_twin_was_slow(monkeypatch):
    monkeypatch.setattr("cosim.study.tradeoff.rounds.SLOW", 0.0)
    selection = Selection(("erk",), (1e-3,), roads=("native", "native-interpreted"))
    study = tradeoff(bar(), selection=selection, every_formulation=False, repeats=0)
    assert [m.error is None for m in study.measurements] == [False, True]
    assert "reduced native erk 1e-03 took" in study.measurements[1].outcome.reason


def test_study_without_time_lists_what_it_left_out_and_runs_it_when_resumed():
    arguments = {"selection": SMALL, "every_formulation": False, "repeats": 1}
    study = tradeoff(bar(), seconds=0.0, **arguments)
    assert {str(m.outcome) for m in study.measurements} == {
        "left out: no time was left; resume the study"
    }
    again = tradeoff(bar(), resume=True, **arguments)
    assert {m.outcome for m in again.measurements} == {Outcome()}


def test_failure_that_took_long_keeps_tighter_tolerances_from_running(monkeypatch):
    def failing(self, configuration):
        run = reference(bar()).run
        raise SolverError("it gave up", replace(run, stats={"solve_time": 6.0}))

    monkeypatch.setattr(Workshop, "run", failing)
    study = tradeoff(bar(), selection=SMALL, every_formulation=False, repeats=0)
    reasons = [m.outcome.kind for m in study.measurements]
    assert reasons == ["SolverError", *3 * ["left out"], "SolverError", *2 * ["left out"]]


def test_what_cannot_be_measured_is_listed_with_its_reason():
    selection = Selection(("erk", "dop853"), (1e-4,), roads=("native", "native-interpreted"))
    study = tradeoff("crank_shaft", selection=selection, repeats=0)
    told = {row["configuration"]: row["reason"] for row in study.missing()}
    assert told == {
        "crank_shaft/driven native-interpreted dop853": "exists as compiled code only",
        "crank_shaft/multipliers erk": "cannot integrate algebraic unknowns",
        "crank_shaft/multipliers native-interpreted dop853": "exists as compiled code only",
    }


def test_median_and_spread_leave_the_first_run_out():
    configuration = Configuration("m", False, "native", "erk", 1e-3)
    times = (9.0, 1.0, 3.0, 2.0)  # the first run may have compiled
    events = [Event(configuration, errors={"x": 0.1}, solver_time=t, total_time=t) for t in times]
    (measurement,) = gather(events)
    assert measurement.solver_time == Timing(2.0, 1.0, 3.0, 3)
    assert measurement.first_time == 9.0


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        ({"solvers": ("erkk",)}, UnknownName),
        ({"roads": ("fmi",)}, UnknownName),
        ({"tolerances": (0.5,)}, ParameterError),
        ({"tolerances": (0.0,)}, ParameterError),
        ({"steps": (0.0,)}, ParameterError),
        ({"steps": (float("nan"),)}, ParameterError),
    ],
)
def test_selection_refuses_what_does_not_exist(arguments, error):
    with pytest.raises(error):
        Selection(**arguments)


def test_selection_that_fits_nothing_is_refused():
    with pytest.raises(UsageError, match="nothing to measure with solvers erk"):
        tradeoff("crank_shaft/multipliers", selection=Selection(("erk",)))


def test_without_a_compiler_only_interpreted_equations_are_measured(monkeypatch):
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr("cosim.codegen.compiler.find_spec", lambda _: None)
    said = []
    selection = Selection(("rk4",), steps=(0.01,))
    study = tradeoff(
        bar(), selection=selection, every_formulation=False, repeats=0, tell=said.append
    )
    assert "no C compiler: interpreted equations only" in said
    assert {m.configuration.road for m in study.measurements} == {"native-interpreted"}
    assert ("native, fmu-me, fmu-cs", "no C compiler") in study.impossible
    with pytest.raises(MissingTool, match="no C compiler found"):
        tradeoff(bar(), selection=Selection(roads=("native",)))


def test_wanted_outputs_are_measured_on_the_full_and_on_the_reduced_model():
    selection = Selection((), (1e-6,), (0.01,), ("native", "fmu-me"))
    study = tradeoff(
        bar(outputs=("theta",)), selection=selection, every_formulation=False, repeats=0
    )
    found = {(m.configuration.road, m.configuration.reduced) for m in study.measurements}
    assert found == set(product(("native", "fmu-me"), (False, True)))
    assert {tuple(m.errors) for m in study.measurements} == {("theta",)}


def test_command_writes_table_file_and_figure(tmp_path, capsys):
    table, data, figure = (str(tmp_path / name) for name in ("t.csv", "t.json", "t.png"))
    words = "tradeoff bar_on_frame/reduced --stop-time 1 --solvers erk --roads compiled"
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
    assert set(facts["fronts"]) == set(COSTS)


def test_plain_figure_shows_the_front_and_one_line_for_each_solver(study):
    figure = draw_front(study)
    axis = figure.axes[0]
    labels = [line.get_label() for line in axis.lines]
    solvers = {m.configuration.solver for m in study.competing}
    assert sorted(label.partition(",")[0] for label in labels[:-1]) == sorted(solvers)
    assert labels[-1] == "Pareto front"
    looks = {(line.get_color(), line.get_marker()) for line in axis.lines}
    assert len(looks) == len(axis.lines)  # no two alike in the legend
    notes = [text.get_text() for text in figure.legends[1].get_texts()]
    assert 1 <= len(notes) <= 10
    assert [note.partition(" ")[0] for note in notes] == [t.get_text() for t in axis.texts]
    front = {m.configuration.solver for m in study.front("solver_time")}
    assert {note.split()[1].rstrip(",") for note in notes} <= front
    assert any(patch.get_y() + patch.get_height() == study.floor for patch in axis.patches)


def test_figure_names_the_front_and_shows_the_floor(study):
    figure = draw_tradeoff(study)
    for axis, cost in zip(figure.axes, COSTS, strict=False):
        front = [m.configuration for m in study.front(cost)]
        named = [text.get_text() for text in axis.texts]
        assert named[0].startswith(front[0].short)
        assert named[-1].endswith(front[-1].setting)
        for configuration in front:
            assert any(configuration.solver in name for name in named)
        assert any(patch.get_y() + patch.get_height() == study.floor for patch in axis.patches)
        assert f"{study.floor:.0e}" in axis.get_title()


@pytest.mark.parametrize(
    ("words", "code"),
    [
        ("--output-file t.txt", 3),
        ("--figure t.bmp", 3),
        ("--solvers erkk", 3),
        ("--tolerances 1e-3,x", 2),
        ("--tolerances 1e-3 --relative-tolerance 1e-4", 2),
        ("--outputs thetta", 3),
    ],
)
def test_wrong_options_are_refused_before_anything_runs(words, code, capsys):
    assert main(["tradeoff", "bar_on_frame/reduced", *words.split()]) == code
    assert "reference" not in capsys.readouterr().err


def test_one_relative_tolerance_is_the_only_one_that_is_measured(tmp_path):
    path = tmp_path / "t.json"
    words = "--relative-tolerance 1e-5 --solvers erk --roads native --repeats 1 --stop-time 0.5 -q"
    call = ["tradeoff", "bar_on_frame/reduced", *words.split(), "--output-file", str(path)]
    assert main(call) == 0
    assert {row["tolerance"] for row in json.loads(path.read_text())["measurements"]} == {1e-5}
