"""`accuracy` and `budget`: what is promised is kept, checked on the run, or said to be too much.

The truth is a closed form wherever an error is judged.
"""

from dataclasses import replace

import numpy as np
import pytest
from helpers.oscillators import oscillator
from helpers.promises import OTHER, error
from helpers.small_models import table

import cosim
from casadi_models.dae import Model
from cosim.api import simulate
from cosim.cli.main import main
from cosim.errors import ParameterError, SolverError, UsageError
from cosim.scene.scene import Settings
from cosim.study.accuracy.front import measured_front
from cosim.study.accuracy.solver_selection import promise_kept, promised_run

ACCURACIES = (1e-3, 1e-6, 1e-9)


def lorenz():
    """Declare Lorenz's equations: two runs part however close they begin."""
    model = Model("lorenz", stop_time=1.0)
    x, y, z = (model.state(name, "1", 1.0, name, nominal=10.0) for name in "xyz")
    for state, rate in ((x, 10 * (y - x)), (y, x * (28 - z) - y), (z, x * y - 8 / 3 * z)):
        model.derivative(state, rate)
    return model.freeze()


def chosen(run):
    """Return solver and tolerance of what was chosen."""
    solver, _, tolerance = run.stats["configuration"].partition(" at ")
    return {"solver": solver, "relative_tolerance": float(tolerance)}


def front_errors():
    """Return the measured error of x by solver and tolerance."""
    front = measured_front(oscillator().dae, compiled=True)
    return {
        (e.configuration.solver, e.configuration.tolerance): e.errors["x"] for e in front.events
    }


class Runs:
    """A stand-in for a model's runs: known errors, and a list of what was asked for."""

    def __init__(self, offset, *, failing=(), seconds=0.0):
        self.offset, self.failing, self.seconds = offset, failing, seconds
        self.asked = []
        self.one = simulate(oscillator().dae, outputs=["x"])

    def __call__(self, *, solver, relative_tolerance):
        self.asked.append((solver, relative_tolerance))
        if solver in self.failing:
            raise SolverError(f"{solver} failed", self.one)
        shift = self.offset(solver, relative_tolerance)
        stats = {"solver": solver, "relative_tolerance": relative_tolerance}
        stats["solve_time"] = self.seconds
        return replace(self.one, values=self.one.values + shift, stats=stats)

    def promised(self, accuracy=None, budget=None):
        return promised_run(oscillator().dae, self, ["x"], 5.0, True, accuracy, budget)


@pytest.mark.parametrize("accuracy", ACCURACIES)
def test_promise_is_kept_far_from_the_values_of_the_front(dae, accuracy):
    run = simulate(dae, start=OTHER, accuracy=accuracy, outputs=["x"])
    assert error(run) <= accuracy  # measured 4e-5 to 0.02 of it
    assert run.stats["error_estimate"] <= accuracy


@pytest.mark.parametrize("accuracy", ACCURACIES)
def test_estimate_is_the_error_of_the_configuration_that_was_chosen(dae, accuracy):
    run = simulate(dae, start=OTHER, accuracy=accuracy, outputs=["x"])
    again = simulate(dae, start=OTHER, outputs=["x"], **chosen(run))
    assert error(again) <= accuracy
    # as far as the run that checks it is right: measured 0.003
    assert run.stats["error_estimate"] == pytest.approx(error(again), abs=0.03 * accuracy)
    assert run.stats["error_estimate_of"] == "x"


@pytest.mark.parametrize("accuracy", ACCURACIES)
def test_returned_run_is_the_more_accurate_of_the_two(accuracy):
    known = front_errors()
    runs = Runs(lambda *configuration: known[configuration])
    run = runs.promised(accuracy=accuracy)
    assert np.ptp(run.values - runs.one.values) == pytest.approx(0, abs=1e-15)
    shift = float((run.values - runs.one.values)[0, 0])
    assert shift == pytest.approx(min(known[asked] for asked in runs.asked[-2:]), abs=1e-15)


def test_chaotic_motion_is_not_taken_for_a_result():
    with pytest.raises(SolverError, match=r"1e-06 is not reached: .* and .* are .* apart") as told:
        simulate(lorenz(), stop_time=60.0, output_interval=0.6, accuracy=1e-6)
    partial = told.value.partial
    assert len(partial) == 101
    assert partial.status.startswith("accuracy 1e-06 is not reached")
    assert partial.stats["error_estimate"] > 1e-6


def test_run_that_is_more_sensitive_than_the_models_own_gets_a_tighter_tolerance():
    """Lorenz's equations multiply an error at 1 s, the front's span, by about 1e5 until 15 s."""
    span = {"stop_time": 15.0, "output_interval": 0.15}
    run = simulate(lorenz(), accuracy=1e-5, **span)
    assert run.stats["promised_error"] < 1e-5 / 100  # at 1 s; a third would do there
    best = simulate(lorenz(), solver="dop853", relative_tolerance=3e-14, **span)
    assert cosim.compare(best, run).worst.scaled <= 1e-5


def test_tolerance_without_effect_is_not_taken_for_convergence():
    """Each method agrees with itself however tight it is, and is wrong by another amount."""
    wrong = {"cvodes": 1e-3, "erk": 0.0, "dop853": -1e-3}
    runs = Runs(lambda solver, tolerance: wrong[solver])
    with pytest.raises(SolverError, match="is not reached"):
        runs.promised(accuracy=1e-5)
    assert all(a[0] != b[0] for a, b in zip(runs.asked, runs.asked[1:], strict=False))


def test_goal_is_reached_by_going_on_whatever_seems_cheapest(monkeypatch):
    """Errors a thousand times those of the front, whose times are drawn at random."""
    known = {configuration: 1e3 * error for configuration, error in front_errors().items()}
    front = measured_front(oscillator().dae, compiled=True)
    rng = np.random.default_rng(5)
    for _ in range(50):
        events = tuple(replace(e, solver_time=rng.uniform(1, 100)) for e in front.events)
        drawn = replace(front, events=events)
        monkeypatch.setattr(
            "cosim.study.accuracy.solver_selection.measured_front",
            lambda *_, front=drawn, **__: front,
        )
        runs = Runs(lambda *configuration: known[configuration])
        run = runs.promised(accuracy=1e-6)
        assert len(runs.asked) == len(set(runs.asked))
        assert known[tuple(chosen(run).values())] <= 1e-6
        assert known[run.stats["solver"], run.stats["relative_tolerance"]] <= 1e-6


@pytest.mark.parametrize("failing", ["cvodes", "erk", "dop853"])
def test_solver_that_fails_gives_way_to_another(failing):
    runs = Runs(lambda *_: 0.0, failing=(failing,))
    assert failing not in promise_kept(runs.promised(accuracy=1e-6))
    assert failing not in promise_kept(runs.promised(budget=1.0))


def test_run_on_which_two_solvers_fail_is_a_failed_run():
    runs = Runs(lambda *_: 0.0, failing=("cvodes", "erk", "dop853"))
    with pytest.raises(SolverError, match="failed") as told:
        runs.promised(accuracy=1e-6)
    assert len(runs.asked) == 2
    assert told.value.partial is runs.one


def test_more_time_gives_no_less_accuracy():
    dae = oscillator().dae
    front = measured_front(dae, compiled=True).cheapest_first(["x"])
    slowest = front[-1].cost("solver_time")
    errors = [
        simulate(dae, budget=factor * slowest, outputs=["x"]).stats["promised_error"]
        for factor in (30, 300)
    ]
    assert errors == [front[-1].error] * 2


def test_budget_that_a_run_overdraws_leads_to_a_cheaper_configuration():
    front = measured_front(oscillator().dae, compiled=True).cheapest_first(["x"])
    runs = Runs(lambda *_: 0.0, seconds=1e3)
    with pytest.raises(SolverError, match="the cheapest configuration, took 1e\\+06 ms") as told:
        runs.promised(budget=10.0)
    asked = list(dict.fromkeys(runs.asked))
    assert asked == [(m.configuration.solver, m.configuration.tolerance) for m in front[::-1]]
    assert told.value.partial.status == "took 1e+06 ms, more than its budget"


def test_budget_below_the_cheapest_configuration_is_refused_with_its_time():
    with pytest.raises(ParameterError, match=r"budget = 1e-06 ms; the cheapest .* takes .* ms"):
        simulate(oscillator().dae, budget=1e-9)


def test_longer_run_has_less_time_for_each_second():
    """Ten times the span: a tenth of the budget is what its second has."""
    dae = oscillator().dae
    front = measured_front(dae, compiled=True).cheapest_first(["x"])
    budget = 5 * front[0].cost("solver_time")
    with pytest.raises(ParameterError, match="more time or a shorter run"):
        simulate(dae, stop_time=50.0, budget=budget, outputs=["x"])


@pytest.mark.parametrize("goal", [{"accuracy": 1e-9}, {"budget": 1e-3}])
def test_model_without_states_is_exact(goal):
    run = simulate(table(), **goal)
    np.testing.assert_array_equal(run["y"], 1.5 + run.time)
    assert run.stats["error_estimate"] < 1e-15  # rounding of 2.5
    assert "no integration" in promise_kept(run)


@pytest.mark.parametrize("goal", ["accuracy", "budget"])
@pytest.mark.parametrize("value", [0, -1e-6, np.nan, np.inf, "small", True])
def test_goal_that_is_no_positive_number_is_refused(goal, value):
    with pytest.raises(ParameterError, match=goal):
        simulate(oscillator().dae, **{goal: value})
    with pytest.raises(ParameterError, match=goal):
        Settings(**{goal: value})


@pytest.mark.parametrize(
    "other",
    [
        {"solver": "erk"},
        {"relative_tolerance": 1e-6},
        {"absolute_tolerance": 1e-6},
        {"step_size": 0.1},
        {"budget": 1.0},
    ],
)
def test_goal_beside_what_it_decides_is_refused(other):
    with pytest.raises(UsageError, match=f"accuracy.*{next(iter(other))}.*"):
        simulate(oscillator().dae, accuracy=1e-6, **other)
    with pytest.raises(UsageError, match=f"accuracy.*{next(iter(other))}.*"):
        Settings(accuracy=1e-6, **other)


def test_accuracy_beyond_double_precision_is_refused_with_the_smallest_possible(dae):
    with pytest.raises(ParameterError, match="smallest possible") as told:
        simulate(dae, accuracy=1e-18, outputs=["x"])
    smallest = float(str(told.value).partition(" is below ")[2].partition(",")[0])
    assert 1e-16 < smallest < 1e-15
    with pytest.raises(SolverError, match="is not reached"):  # no two methods agree so well
        simulate(dae, accuracy=smallest, outputs=["x"])


def test_scene_has_an_accuracy_and_the_command_line_overrides_it(tmp_path, capsys):
    scene = tmp_path / "bar.toml"
    text = 'model = "bar_on_frame"\noutputs = ["theta"]\n[run]\nstop_time = 0.1\n'
    scene.write_text(text + "accuracy = 1e-6\n")
    target = ["--output-file", str(tmp_path / "out.csv")]
    assert main(["simulate", str(scene), *target]) == 0
    assert "accuracy 1e-06: " in capsys.readouterr().err
    assert main(["simulate", str(scene), *target, "--accuracy", "1e-4", "-q"]) == 0
    assert capsys.readouterr().err == ""
    assert main(["simulate", str(scene), *target, "--budget", "50"]) == 0
    told = capsys.readouterr().err
    assert told.startswith("budget 50 ms: ")
    assert "(theta)" in told
    assert main(["simulate", str(scene), *target, "--solver", "erk"]) == 0
    assert capsys.readouterr().err == ""
    assert main(["simulate", str(scene), *target, "--solver", "erk", "--accuracy", "1"]) == 2
    assert "UsageError: accuracy chooses solver" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ("accuracy = 0", "line 4: run: accuracy = 0 is not positive"),
        ('accuracy = "fine"', "line 4: run: accuracy = 'fine' is not a real number"),
        ('accuracy = 1e-6\nsolver = "erk"', "line 4: accuracy chooses solver and tolerance"),
        ("budget = 1.0\naccuracy = 1e-6", "accuracy and budget are both given"),
    ],
)
def test_goal_of_a_scene_that_makes_no_sense_is_refused_with_its_line(tmp_path, lines, message):
    scene = tmp_path / "bar.toml"
    scene.write_text(f'model = "bar_on_frame"\n\n[run]\n{lines}\n')
    with pytest.raises(UsageError, match=message):
        cosim.read_scene(scene)


def test_failed_promise_ends_with_exit_code_1_and_the_labelled_run(tmp_path, capsys):
    target = tmp_path / "out.csv"
    run = ["simulate", "bar_on_frame", "--stop-time", "0.1", "--outputs", "theta"]
    assert main([*run, "--accuracy", "3e-16", "--output-file", str(target)]) == 1
    assert "accuracy 3e-16 is not reached" in capsys.readouterr().err
    assert len(target.read_text().splitlines()) == 12
