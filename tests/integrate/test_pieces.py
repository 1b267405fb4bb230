"""Inputs that jump, against integrals in closed form: every solver keeps its accuracy.

With a ramp of 1e-9 s instead, `rk4` is off by 8e-2, `ode8` by 2e-2, and `cvodes` gives up.
"""

import numpy as np
import pytest
from helpers.samples import sampled

import cosim
from casadi_models.dae import Model
from cosim.errors import SolverError
from cosim.integrate.solvers import SOLVERS
from cosim.model.inputs import InputSeries

# up within an output interval, down at an output time that no double precision number hits
TIMES = [0.0, 1 / 3, 1 / 3, 0.7, 0.7, 1.0]
LEVELS = [0.0, 0.0, 2.0, 3.0, -1.0, -1.0]
JUMPS = InputSeries(("u",), TIMES, np.array(LEVELS)[:, None])
GRID = {"stop_time": 1.0, "output_interval": 0.1}


def lag(algebraic=False):
    """Declare x' = u - x, or the same with an algebraic unknown."""
    model = Model("lag", stop_time=1.0, output_interval=0.1)
    x = model.state("x", "1", 0.5, "what follows the input")
    u = model.input("u", "1", 0.0, "input")
    rate = u - x
    if algebraic:
        rate = model.algebraic("rate", "1/s", 0.0, "its rate")
        model.equation(rate - (u - x))
    model.derivative(x, rate)
    model.output("fed_through", "1", 2 * u, "what feels the input at once")
    return model.freeze()


def exact(times):
    """Return x: of x' = a + b s - x from y, x = (y - a + b) exp(-s) + a + b s - b."""
    found = np.empty(len(times))
    start = 0.5
    for begin, end, first, last in zip(
        TIMES[::2], TIMES[1::2], LEVELS[::2], LEVELS[1::2], strict=True
    ):
        slope = (last - first) / (end - begin)

        def x(t, y=start, t0=begin, a=first, b=slope):
            return (y - a + b) * np.exp(t0 - t) + a + b * (t - t0) - b

        here = (times >= begin - 1e-12) & (times <= end + 1e-12)
        found[here] = x(times[here])
        start = x(end)
    return found


QUICK = (("cvodes", False), ("idas", False), ("dop853", True), ("rk4", True), ("ode8", False))
BOTH_WAYS = [
    pytest.param(n, c, marks=[] if (n, c) in QUICK else pytest.mark.slow)
    for n, s in SOLVERS.items()
    for c in (True, False)
    if c or not s.compiled_only
]


@pytest.mark.slow_rows("rk4-True", "dop853-True")
@pytest.mark.parametrize(("solver", "compiled"), BOTH_WAYS)
def test_state_follows_a_jumping_input_as_accurately_as_any_other(solver, compiled):
    numbers = {"relative_tolerance": 1e-9} if SOLVERS[solver].adaptive else {}
    run = cosim.simulate(lag(), solver=solver, inputs=JUMPS, compiled=compiled, **GRID, **numbers)
    bound = {"rk4": 2e-6, "ode8": 1e-13}.get(solver, 5e-8)  # measured 6e-7, 7e-16, below 8e-9
    np.testing.assert_allclose(run["x"], exact(run.time), rtol=0, atol=bound)
    np.testing.assert_allclose(run.time, np.linspace(0, 1, 11), rtol=0, atol=1e-15)
    assert run.complete


@pytest.mark.parametrize(
    "solver", sampled((n for n, s in SOLVERS.items() if s.solves_dae), ["idas"])
)
def test_algebraic_unknowns_jump_with_the_input(solver):
    run = cosim.simulate(
        lag(True), solver=solver, inputs=JUMPS, outputs=["x", "rate", "fed_through"], **GRID
    )
    np.testing.assert_allclose(run["x"], exact(run.time), rtol=0, atol=1e-7)  # measured 8e-9
    after = JUMPS.with_jumps_at(run.time).at(run.time)[0]
    np.testing.assert_allclose(run["rate"], after - exact(run.time), rtol=0, atol=1e-7)
    np.testing.assert_array_equal(run["fed_through"], 2 * after)
    assert run["fed_through"][[6, 7]] == pytest.approx([2 * (2 + 0.8 / 1.1), -2])  # before, after


def test_jump_at_the_start_or_the_end_of_a_run_is_none_within_it():
    for times, levels, final in (
        ([0.0, 0.0, 1.0], [5.0, 1.0, 1.0], 1 - 0.5 / np.e),
        ([0.0, 1.0, 1.0], [1.0, 1.0, 9.0], 1 - 0.5 / np.e),
        ([-1.0, -1.0, 2.0, 2.0], [7.0, 1.0, 1.0, 5.0], 1 - 0.5 / np.e),
    ):
        series = InputSeries(("u",), times, np.array(levels)[:, None])
        run = cosim.simulate(lag(), inputs=series, solver="ode8", **GRID)
        assert run.final["x"] == pytest.approx(final, abs=1e-12)


def test_failure_after_a_jump_keeps_what_was_before_it():
    model = Model("blows_up", stop_time=2.0, output_interval=0.1)
    x, u = model.state("x", "1", 1.0, "a state"), model.input("u", "1", 0.0, "input")
    model.derivative(x, u * x**2)  # with u = 1 from 0.55 s on, no number at 1.55 s
    series = InputSeries(("u",), [0, 0.55, 0.55, 2], [[0.0], [0.0], [1.0], [1.0]])
    with pytest.raises(SolverError) as caught:
        cosim.simulate(model.freeze(), inputs=series)
    partial = caught.value.partial
    assert partial.time[-1] == pytest.approx(1.5)
    after = partial.time > 0.55
    expected = np.where(after, 1 / (1.55 - np.where(after, partial.time, 0)), 1.0)
    np.testing.assert_allclose(partial["x"], expected, rtol=1e-5)


def test_counts_of_pieces_are_those_of_the_run():
    run = cosim.simulate(lag(), inputs=JUMPS, solver="rk4", step_size=0.1, **GRID)
    assert run.stats.steps == 11  # ten intervals, one of them in two
    assert run.stats.rhs_calls == 44


@pytest.mark.parametrize("solver", ["idas", "dop853"])
def test_jump_after_which_there_is_no_solution_keeps_what_was_before(solver):
    model = Model("reciprocal", stop_time=1.0, output_interval=0.1)
    x = model.state("x", "1", 0.0, "sum")
    u = model.input("u", "1", 1.0, "input")
    z = model.algebraic("z", "1", 1.0, "one over it")
    model.equation(u * z - 1)
    model.derivative(x, z)
    gone = InputSeries(("u",), [0.0, 0.55, 0.55, 1.0], np.array([1.0, 1.0, 0.0, 0.0])[:, None])
    with pytest.raises(
        SolverError, match=r"no solution after the jump of an input at 0\.55 s"
    ) as told:
        cosim.simulate(model.freeze(), inputs=gone, solver=solver)
    assert told.value.partial["x"] == pytest.approx(np.arange(6) / 10, abs=1e-9)
