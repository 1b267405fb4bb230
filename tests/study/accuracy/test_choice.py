"""`accuracy` and `budget`: errors are predicted, checked on the run, or an error is raised.

The truth is a closed form wherever an error is measured.
"""

from contextlib import suppress
from dataclasses import replace
from functools import partial

import casadi as ca
import numpy as np
import pytest
from helpers.known_errors import OTHER, error
from helpers.oscillators import oscillator, resting_spring
from helpers.small_models import table

import cosim
from casadi_models.dae import Model
from cosim.api import simulate
from cosim.cli.main import main
from cosim.errors import ParameterError, SolverError, UsageError
from cosim.integrate import events
from cosim.integrate.call import RunStats
from cosim.solvers import Goal
from cosim.study.accuracy import choice
from cosim.study.accuracy.candidates import Candidate, Candidates, measured_candidates
from cosim.study.accuracy.choice import report
from cosim.text import EndKind

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


def known_errors():
    """Return the measured error of x by solver and tolerance."""
    every = measured_candidates(oscillator().dae, compiled=True).every
    return {(c.solver, c.tolerance): c.errors["x"] for c in every}


class Runs:
    """A stand-in for a model's runs: known errors, and a list of what was requested."""

    def __init__(self, offset, *, failing=(), seconds=0.0):
        self.offset, self.failing, self.seconds = offset, failing, seconds
        self.requested = []
        self.one = simulate(oscillator().dae, outputs=["x"])

    def __call__(self, request):
        solver, tolerance = request.solver.name, request.solver.relative_tolerance
        self.requested.append((solver, tolerance))
        if solver in self.failing:
            raise SolverError(f"{solver} failed", self.one)
        shift = self.offset(solver, tolerance)
        stats = {"solver": solver, "relative_tolerance": tolerance, "solve_time": self.seconds}
        stats = replace(self.one.stats, **stats)
        return replace(self.one, values=self.one.values + shift, stats=stats)

    def for_goal(self, **goal):
        """Return the run for a goal, chosen among these."""
        request = cosim.requested(oscillator().dae, outputs=["x"], compiled=True, **goal)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(choice, "run", self)
            return choice.accurate_run(request)


@pytest.mark.slow
@pytest.mark.parametrize("accuracy", ACCURACIES)
def test_accuracy_is_reached_far_from_the_measured_values(dae, accuracy):
    run = simulate(dae, start_values=OTHER, accuracy=accuracy, outputs=["x"])
    assert error(run) <= accuracy  # measured 4e-5 to 0.02 of it
    assert run.stats["error_estimate"] <= accuracy


@pytest.mark.slow_rows("dae-1e-06")
@pytest.mark.quick_rows("dae-1e-06", "dae-1e-09")
@pytest.mark.parametrize("accuracy", ACCURACIES)
def test_estimate_bounds_the_error_of_the_configuration_that_was_chosen(dae, accuracy):
    run = simulate(dae, start_values=OTHER, accuracy=accuracy, outputs=["x"])
    again = simulate(dae, start_values=OTHER, outputs=["x"], **chosen(run))
    assert error(again) <= run.stats["error_estimate"] <= accuracy
    # what the run that checks it is wrong by is in the estimate: measured 1.003 to 1.83
    assert run.stats["error_estimate"] < 2 * error(again)
    assert run.stats["error_estimate_of"] == "x"


@pytest.mark.slow_rows("0.001", "1e-06")
@pytest.mark.parametrize("accuracy", ACCURACIES)
def test_returned_run_is_the_more_accurate_of_the_two(accuracy):
    known = known_errors()
    runs = Runs(lambda *configuration: known[configuration])
    run = runs.for_goal(accuracy=accuracy)
    assert np.ptp(run.values - runs.one.values) == pytest.approx(0, abs=1e-15)
    shift = float((run.values - runs.one.values)[0, 0])
    assert shift == pytest.approx(min(known[asked] for asked in runs.requested[-2:]), abs=1e-15)


@pytest.mark.slow
def test_chaotic_motion_is_not_accepted_as_a_result():
    with pytest.raises(
        SolverError, match=r"1e-06 is not reached: .* and .* are .* apart"
    ) as caught:
        simulate(lorenz(), stop_time=60.0, output_interval=0.6, accuracy=1e-6)
    partial = caught.value.partial
    assert len(partial) == 101
    assert partial.status.startswith("accuracy 1e-06 is not reached")
    assert partial.stats["error_estimate"] > 1e-6


@pytest.mark.slow
def test_run_that_is_more_sensitive_than_the_models_own_gets_a_tighter_tolerance():
    """Lorenz's equations multiply an error at 1 s, the front's span, by about 1e5 until 15 s."""
    span = {"stop_time": 15.0, "output_interval": 0.15}
    run = simulate(lorenz(), accuracy=1e-5, **span)
    assert run.stats["predicted_error"] < 1e-5 / 100  # at 1 s; a third would do there
    best = simulate(lorenz(), solver="dop853", relative_tolerance=3e-14, **span)
    assert cosim.compare(best, run).worst.scaled <= 1e-5


def test_tolerance_without_effect_is_not_accepted_as_convergence():
    """Each method agrees with itself however tight it is, and is wrong by another amount."""
    wrong = {"cvodes": 1e-3, "erk": 0.0, "dop853": -1e-3}
    runs = Runs(lambda solver, tolerance: wrong[solver])
    with pytest.raises(SolverError, match="is not reached"):
        runs.for_goal(accuracy=1e-5)
    assert all(a[0] != b[0] for a, b in zip(runs.requested, runs.requested[1:], strict=False))


@pytest.mark.slow
def test_goal_is_reached_although_another_candidate_seems_cheapest(monkeypatch):
    """Errors a thousand times those of the front, whose times are drawn at random."""
    known = {configuration: 1e3 * error for configuration, error in known_errors().items()}
    found = measured_candidates(oscillator().dae, compiled=True)
    rng = np.random.default_rng(5)
    for _ in range(50):
        every = tuple(replace(c, solve_time=rng.uniform(1, 100)) for c in found.every)
        drawn = replace(found, every=every)
        monkeypatch.setattr(
            "cosim.study.accuracy.choice.candidates_of",
            lambda *_, found=drawn, **__: found,
        )
        runs = Runs(lambda *configuration: known[configuration])
        run = runs.for_goal(accuracy=1e-6)
        assert len(runs.requested) == len(set(runs.requested))
        assert known[tuple(chosen(run).values())] <= 1e-6
        assert known[run.stats["solver"], run.stats["relative_tolerance"]] <= 1e-6


@pytest.mark.parametrize("failing", ["cvodes", "erk", "dop853"])
def test_failing_solver_is_replaced_by_another(failing):
    runs = Runs(lambda *_: 0.0, failing=(failing,))
    assert failing not in report(runs.for_goal(accuracy=1e-6))
    assert failing not in report(runs.for_goal(budget=1.0))


def test_run_on_which_two_solvers_fail_is_a_failed_run():
    runs = Runs(lambda *_: 0.0, failing=("cvodes", "erk", "dop853"))
    with pytest.raises(SolverError, match="failed") as caught:
        runs.for_goal(accuracy=1e-6)
    assert len(runs.requested) == 2
    assert caught.value.partial is runs.one


def test_more_time_gives_no_less_accuracy():
    dae = oscillator().dae
    front = measured_candidates(dae, compiled=True).cheapest_first(["x"])
    slowest = front[-1].solve_time
    errors = [
        simulate(dae, budget=factor * slowest, outputs=["x"]).stats["predicted_error"]
        for factor in (30, 300)
    ]
    assert errors == [front[-1].error] * 2


def test_run_above_the_budget_leads_to_a_cheaper_configuration():
    front = measured_candidates(oscillator().dae, compiled=True).cheapest_first(["x"])
    runs = Runs(lambda *_: 0.0, seconds=1e3)
    with pytest.raises(SolverError, match="the cheapest configuration, took 1e\\+06 ms") as caught:
        runs.for_goal(budget=10.0)
    asked = list(dict.fromkeys(runs.requested))
    assert asked == [(c.solver, c.tolerance) for c in front[::-1]]
    assert caught.value.partial.status == "took 1e+06 ms, more than its budget"


def test_budget_below_the_cheapest_configuration_is_rejected_with_its_time():
    with pytest.raises(ParameterError, match=r"budget = 1e-06 ms; the cheapest .* takes .* ms"):
        simulate(oscillator().dae, budget=1e-9)


def test_longer_run_has_less_time_for_each_second():
    """Ten times the span: a tenth of the budget is what its second has."""
    dae = oscillator().dae
    front = measured_candidates(dae, compiled=True).cheapest_first(["x"])
    budget = 5 * min(candidate.solve_time for candidate in front)
    with pytest.raises(ParameterError, match="increase the budget or shorten the run"):
        simulate(dae, stop_time=50.0, budget=budget, outputs=["x"])


@pytest.mark.parametrize("goal", [{"accuracy": 1e-9}, {"budget": 1e-3}])
def test_model_without_states_is_exact(goal):
    run = simulate(table(), **goal)
    np.testing.assert_array_equal(run["y"], 1.5 + run.time)
    assert run.stats["error_estimate"] < 1e-15  # rounding of 2.5
    assert "no integration" in report(run)


@pytest.mark.parametrize("goal", ["accuracy", "budget"])
@pytest.mark.parametrize("value", [0, -1e-6, np.nan, np.inf, "small", True])
def test_goal_that_is_no_positive_number_is_rejected(goal, value):
    with pytest.raises(ParameterError, match=goal):
        simulate(oscillator().dae, **{goal: value})
    with pytest.raises(ParameterError, match=goal):
        Goal(**{goal: value})


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
def test_goal_with_a_setting_that_it_replaces_is_rejected(other):
    with pytest.raises(UsageError, match=f"accuracy.*{next(iter(other))}.*"):
        simulate(oscillator().dae, accuracy=1e-6, **other)


def test_accuracy_beyond_double_precision_is_rejected_with_the_smallest_possible(dae):
    with pytest.raises(ParameterError, match="smallest possible") as caught:
        simulate(dae, accuracy=1e-18, outputs=["x"])
    smallest = float(str(caught.value).partition(" is below ")[2].partition(",")[0])
    assert 1e-16 < smallest < 1e-15
    with pytest.raises(SolverError, match="is not reached"):  # no two methods agree so well
        simulate(dae, accuracy=smallest, outputs=["x"])


@pytest.mark.slow
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
    printed = capsys.readouterr().err
    assert printed.startswith("budget 50 ms: ")
    assert "(theta, compared with" in printed
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
def test_invalid_goal_of_a_scene_is_rejected_with_its_line(tmp_path, lines, message):
    scene = tmp_path / "bar.toml"
    scene.write_text(f'model = "bar_on_frame"\n\n[run]\n{lines}\n')
    with pytest.raises(UsageError, match=message):
        cosim.read_scene(scene)


@pytest.mark.slow
def test_missed_accuracy_exits_with_1_and_the_labeled_run(tmp_path, capsys):
    target = tmp_path / "out.csv"
    run = ["simulate", "bar_on_frame", "--stop-time", "0.1", "--outputs", "theta"]
    assert main([*run, "--accuracy", "3e-16", "--output-file", str(target)]) == 1
    assert "accuracy 3e-16 is not reached" in capsys.readouterr().err
    assert len(target.read_text().splitlines()) == 12


def pushed(t, length):
    """Return a push of a length from 50.0003 s on: smooth, flat, and 0 before and after it."""
    return np.exp(-(((t - 50.0003 - length / 2) / (length / 3)) ** 16))


@pytest.fixture
def no_pulse_is_looked_for(monkeypatch):
    """Let solvers step over thin pulses of time: the check must notice by itself."""
    monkeypatch.setattr(events, "pulse_times", lambda *_: np.empty(0))
    monkeypatch.setattr(events, "attentive", lambda attempt, grid, *_: attempt(grid, np.empty(0)))


@pytest.mark.slow
@pytest.mark.parametrize("length", [0.004, 0.0005])
def test_push_is_found_and_the_estimate_holds(length):
    run = simulate(resting_spring(), inputs={"force": lambda t: pushed(t, length)}, accuracy=1e-6)
    assert_swings(run, length)
    assert 0 < run.stats["error_estimate"] < 1e-6


def assert_swings(run, length):
    """Assert that a push has made the lightly damped mass swing as its impulse says."""
    t = np.linspace(50, 50.01, 1_000_001)
    impulse = np.trapezoid(pushed(t, length), t)
    rate, frequency = 0.25, np.sqrt(1 - 0.25**2)
    since = run.time - 50.0003 - length / 2
    exact = impulse * np.exp(-rate * since) * np.sin(frequency * since) / frequency
    late = since > length
    np.testing.assert_allclose(run["x"][late], exact[late], rtol=0, atol=1e-6)


@pytest.mark.slow
@pytest.mark.usefixtures("no_pulse_is_looked_for")
@pytest.mark.parametrize("goal", [{"accuracy": 1e-4}, {"budget": 1.0}])
def test_exact_agreement_of_runs_that_missed_a_push_is_rejected(goal):
    inputs = {"force": lambda t: pushed(t, 0.001)}
    with pytest.raises(
        SolverError, match=r"agree exactly, but may have missed .* from 50.000\d+ s on"
    ):
        simulate(resting_spring(), inputs=inputs, **goal)


@pytest.mark.slow
@pytest.mark.usefixtures("no_pulse_is_looked_for")
def test_check_sees_a_push_that_the_checked_run_missed():
    """The checking run evaluates the equations inside every output interval.

    Which run is checked depends on the times that were measured; none may be wrong.
    """
    with suppress(SolverError):  # which says how far apart the two runs are
        run = simulate(
            resting_spring(), inputs={"force": lambda t: pushed(t, 0.004)}, accuracy=1e-4
        )
        assert_swings(run, 0.004)


@pytest.mark.slow
@pytest.mark.usefixtures("no_pulse_is_looked_for")
def test_exact_agreement_is_rejected_where_equations_contain_time():
    """The pulse is shorter than the places at which the equations are looked at are apart."""
    model = Model("tap", stop_time=100.0)
    x = model.state("x", "m", 0.0, "place")
    model.derivative(x, ca.exp(-(((model.t - 50.00031) / 1e-9) ** 2)))
    with pytest.raises(SolverError, match=r"agree exactly, but may have missed what changes"):
        simulate(model.freeze(), accuracy=1e-4)


@pytest.mark.slow
def test_exact_agreement_is_confirmed_where_nothing_changes():
    still = cosim.InputSeries(("force",), [0.0, 100.0], [[0.0], [0.0]])
    run = simulate(resting_spring(), inputs=still, accuracy=1e-4)
    assert run.stats["error_estimate"] == 0
    assert isinstance(run.stats, RunStats)


@pytest.mark.parametrize("worse", [1.0, 5.0, 10.0])
def test_an_estimate_is_a_bound_if_the_check_is_worse_than_predicted(worse):
    """With other values than the predicted ones; 4 % below the error before, in the second case."""
    exact = simulate(oscillator().dae, stop_time=1.0, outputs=["x"])
    wrong = (1e-3, worse * 1e-5)
    runs = [
        choice.CandidateRun(
            Candidate(solver, 1e-6, {"x": predicted}, 0.0, 0, 0.0),
            replace(exact, values=exact.values + off * exact.column("x").nominal),
        )
        for solver, predicted, off in zip(("cvodes", "erk"), (1e-3, 1e-5), wrong, strict=True)
    ]
    assert 1e-3 * 0.999999 <= choice.Pair(*runs).error <= 1.2e-3


@pytest.mark.slow_rows("100000.0-0.001", "100000.0-1e-08", "100000000.0-1e-06")
@pytest.mark.parametrize(("rate", "accuracy"), [(1e5, 1e-3), (1e5, 1e-6), (1e5, 1e-8), (1e8, 1e-6)])
def test_a_stiff_model_is_checked_by_a_second_implicit_solver(rate, accuracy):
    """'erk at 0.01 and cvodes are 4.4e-03 nominal values apart' before, with every accuracy.

    With the larger rate no explicit solver gets to the next output time.
    """
    model = Model("stiff", stop_time=2.0, output_interval=0.025)
    x, y = model.state("x", "1", 0.0, "follows y"), model.state("y", "1", 1.0, "decays")
    model.derivative(y, -y)
    model.derivative(x, -rate * (x - y))
    run = simulate(model.freeze(), accuracy=accuracy)
    right = rate / (rate - 1) * (np.exp(-run.time) - np.exp(-rate * run.time))
    wrong = max(np.abs(run["x"] - right).max(), np.abs(run["y"] - np.exp(-run.time)).max())
    assert wrong <= run.stats["error_estimate"] <= accuracy


@pytest.mark.slow
def test_span_for_which_explicit_solvers_need_too_many_steps_is_left_to_implicit_ones():
    """x' = -1000 (x - y), y' = -1e-5 y: explicit ones do for 2 s, and stopped the run of 2e5 s."""
    model = Model("long_decay", stop_time=2.0)
    x, y = model.state("x", "1", 1.0, "x"), model.state("y", "1", 1.0, "y")
    model.derivative(x, -1000 * (x - y))
    model.derivative(y, -1e-5 * y)
    span = {"stop_time": 2e5, "output_interval": 2e3}
    run = simulate(model.freeze(), accuracy=1e-6, outputs=["y"], **span)
    assert np.abs(run["y"] - np.exp(-1e-5 * run.time)).max() <= run.stats["error_estimate"] <= 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("goal", [{"accuracy": 1e-6}, {"budget": 60.0}])
def test_run_that_no_solver_completes_says_what_to_do(goal):
    """x' = x^2 is infinite at 1 s."""
    model = Model("blows_up", stop_time=0.5)
    x = model.state("x", "1", 1.0, "x")
    model.derivative(x, x * x)
    with pytest.raises(SolverError, match=r"and .* fail: .* at t = 1, .*; request a shorter run"):
        simulate(model.freeze(), stop_time=2.0, **goal)


def test_next_tolerance_is_below_all_that_a_solver_has_had():
    """Predicted errors need not fall with the tolerance; the run at 1e-9 would tell nothing new."""
    every = [
        Candidate("erk", tolerance, {}, 0.0, 0, 0.0) for tolerance in (1e-8, 1e-9, 1e-10, 1e-11)
    ]
    chooser = choice._Chooser(None, Candidates(tuple(every), {}), ())
    runs = [choice.CandidateRun(every[2], None), choice.CandidateRun(every[0], None)]
    assert chooser.with_smaller_tolerance(runs, 0.1, ()) == every[3]


@pytest.mark.slow_rows("accuracy")
@pytest.mark.parametrize(
    ("goal", "said"),
    [
        ({"accuracy": 1e-6, "compiled": False}, "is not reached: .* and .* fail"),
        ({"budget": 60.0}, "descriptor: .* fails?"),
    ],
    ids=("accuracy", "budget"),
)
def test_model_that_no_solver_runs_says_so(goal, said, monkeypatch):
    """Without compiler two solvers take algebraic unknowns; 'accuracy cannot be checked' before."""
    model = Model("descriptor", stop_time=0.5)
    x, z = model.state("x", "1", 1.0, "x"), model.algebraic("z", "1", -1.0, "its rate")
    model.derivative(x, z)
    model.equation(z + x)

    def endless(_request):
        raise SolverError.of("descriptor", "too many steps", kind=EndKind.TOO_MANY_STEPS)

    monkeypatch.setattr(choice, "run", endless)
    with pytest.raises(SolverError, match=f"{said}: too many steps; request a shorter run, or"):
        simulate(model.freeze(), **goal)


@pytest.mark.parametrize(("accuracy", "noted"), [(1e-6, True), (1e-9, False)])
@pytest.mark.parametrize("coupled", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_accuracy_above_all_values_of_a_variable_names_it(coupled, accuracy, noted):
    """A charge of 5e-9 C has the nominal value 1 C, in which an accuracy counts."""
    capacitor = cosim.Model("capacitor", stop_time=1.0, output_interval=0.1)
    charge = capacitor.state("charge", "C", 5e-9, "charge")
    capacitor.derivative(charge, -3 * charge)
    subject = capacitor.freeze()
    if coupled:
        meter = cosim.Model("meter")
        meter.output("seen", "C", meter.input("charge", "C", 0.0, "charge"), "charge")
        parts = {"capacitor": subject, "meter": meter.freeze()}
        subject = cosim.couple(parts, {"meter.charge": "capacitor.charge"})
    run = subject.simulate if coupled else partial(cosim.simulate, subject)
    note = run(accuracy=accuracy).stats.get("note") or ""
    assert ("more than all values of" in note) == noted
    assert ("charge (at most 5e-09)" in note) == noted


@pytest.mark.slow_rows("goal0")
@pytest.mark.parametrize("goal", [{"accuracy": 1e-6}, {"budget": 0.1}])
def test_a_run_that_ends_before_the_model_s_own_span_fails_is_accurate(goal):
    model = cosim.Model("blow_up", stop_time=2.0)
    x = model.state("x", "m", 1.0, "infinite after 1 s")
    model.derivative(x, x**2)
    run = cosim.simulate(model.freeze(), stop_time=0.9, **goal)
    error = np.abs(run["x"] - 1 / (1 - run.time)).max()
    assert error < min(1e-6, run.stats["error_estimate"])  # measured 7.5e-10 and 3.1e-13
    with pytest.raises(SolverError, match=r"stopped after 0\.99 s"):
        cosim.simulate(model.freeze(), **goal)
