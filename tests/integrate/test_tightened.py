"""The default solver at tight tolerances."""

import pytest

import cosim
from cosim.errors import SolverError
from cosim.integrate.solvers import chosen_solver
from cosim.solvers import Rosenbrock, Tolerance


@pytest.fixture(scope="module")
def swing():
    """Return x'' = -x, whose energy drifts in BDF methods."""
    model = cosim.Model("swing", stop_time=20.0, output_interval=20.0)
    x = model.state("x", "1", 1.0, "place")
    v = model.state("v", "1/s", 0.0, "speed")
    model.derivative(x, v)
    model.derivative(v, -x)
    model.output("amplitude", "1", x**2 + v**2, "square of the amplitude")
    return model.freeze()


def inner_tolerance(dae, relative, absolute=None):
    """Return the relative tolerance with which the default solver of a model runs."""
    return chosen_solver(dae, Tolerance(relative, absolute))[1].relative_tolerance


def test_tolerances_of_1e_8_and_more_and_those_of_named_solvers_stay(swing):
    assert inner_tolerance(swing, 1e-8) == 1e-8
    assert inner_tolerance(swing, 1e-3) == 1e-3
    assert inner_tolerance(swing, 1e-10, 1e-6) == 1e-10
    named = Rosenbrock(relative_tolerance=1e-12)
    assert chosen_solver(swing, named) == (named, named)


@pytest.mark.parametrize("model", ["crank_shaft/driven", "crank_shaft/multipliers"])
def test_tighter_tolerances_are_reduced_as_far_as_the_solvers_reach(model):
    dae = cosim.load(model)
    desired = [1e-8 * 0.5**i for i in range(18)]
    inner = [inner_tolerance(dae, tolerance) for tolerance in desired]
    assert inner == sorted(inner, reverse=True)
    assert all(a / 30.001 <= i <= a for a, i in zip(desired, inner, strict=True))
    assert inner_tolerance(dae, 1e-10) == 1e-10 / 30
    assert inner_tolerance(dae, 1e-12) == 1e-12


def test_run_says_it_and_is_as_good_as_asked(swing):
    run = cosim.simulate(swing, relative_tolerance=1e-10)
    assert run.stats["relative_tolerance"] == 1e-10
    assert "cvodes ran at rtol 3.33333e-12" in run.stats["note"]
    named = cosim.simulate(swing, relative_tolerance=1e-10, solver="cvodes")
    assert "note" not in named.stats
    errors = [abs(r["amplitude"][-1] - 1) for r in (run, named)]
    assert errors[0] < 1e-8 < errors[1]  # measured 1.5e-9 and 3.4e-8


def test_defaults_are_what_they_were(swing):
    default, named = cosim.simulate(swing), cosim.simulate(swing, solver="cvodes")
    assert default.values.tobytes() == named.values.tobytes()
    assert "note" not in default.stats


def test_limit_that_stops_a_run_leaves_it_as_tight():
    model = cosim.Model("swing", stop_time=20.0, output_interval=0.1)
    x, v = model.state("x", "1", 1.0, "place"), model.state("v", "1/s", 0.0, "speed")
    model.derivative(x, v)
    model.derivative(v, -x)
    model.limit(x + 0.5, "it stays on the right")
    with pytest.raises(SolverError) as stopped:
        cosim.simulate(model.freeze(), relative_tolerance=1e-10, on_invalid="stop")
    assert "cvodes ran at rtol 3.33333e-12" in stopped.value.partial.stats["note"]
