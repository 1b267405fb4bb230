"""Names and tolerances of the integrators."""

import math

import pytest

import cosim
from cosim.errors import ParameterError, UnknownName, UsageError
from cosim.integrate.engine import build
from cosim.integrate.solvers import SOLVERS, Tolerance, method
from cosim.model.time_grid import time_grid

GRID = time_grid(0, 1, 0.1)


@pytest.fixture(scope="module")
def ode():
    return cosim.load("crank_shaft")


@pytest.fixture(scope="module")
def dae():
    return cosim.load("crank_shaft/multipliers")


def test_names_are_those_of_the_contract():
    names = ["cvodes", "cvodes_adams", "idas", "erk", "rosenbrock", "rk4", "ode8"]
    assert list(SOLVERS) == [*names, "dop853"]  # one more than the contract has


def test_default_is_cvodes_and_idas_for_algebraic_unknowns(ode, dae):
    assert method(ode, None)[0] == "cvodes"
    assert method(dae, None)[0] == "idas"


@pytest.mark.parametrize(
    ("name", "hint"),
    [("cvode", "cvodes"), ("ode45", "ode8"), ("IDAS", "idas"), ("bdf", "it has cvodes, cvodes_ad")],
)
def test_unknown_solver_is_refused_with_near_names(ode, name, hint):
    with pytest.raises(UnknownName, match=f"cosim has no solver '{name}'; .*{hint}"):
        method(ode, name)


@pytest.mark.parametrize("name", [n for n, m in SOLVERS.items() if not m.solves_dae])
def test_solver_of_odes_refuses_algebraic_unknowns(dae, name):
    with pytest.raises(UsageError, match=f"which {name} cannot integrate; use idas or rosenbrock"):
        build(dae, GRID, name)


@pytest.mark.parametrize("name", [n for n, m in SOLVERS.items() if m.adaptive])
def test_adaptive_solver_refuses_a_step_size(ode, name):
    with pytest.raises(UsageError, match=f"{name} chooses its own steps"):
        build(ode, GRID, name, step_size=0.1)


@pytest.mark.parametrize("name", ["rk4", "ode8"])
def test_fixed_steps_refuse_an_absolute_tolerance(ode, name):
    with pytest.raises(UsageError, match=f"{name} has no error control"):
        build(ode, GRID, name, Tolerance(1e-6, 1e-9))


@pytest.mark.parametrize(
    ("step", "reason"),
    [
        (0, "step_size = 0 is not positive"),
        (-0.1, "is not positive"),
        (math.nan, "is not finite"),
        (math.inf, "is not finite"),
        (True, "is not a real number"),
        (1e-8, r"step_size = 1e-08 s makes more than 2e\+06 steps; give a larger one"),
        (5e-324, "makes more than"),
    ],
)
def test_step_size_must_be_a_possible_one(ode, step, reason):
    with pytest.raises(ParameterError, match=reason):
        build(ode, GRID, "rk4", step_size=step)


@pytest.mark.parametrize(
    "relative", [-1e-6, math.nan, math.inf, 1e-15, 2.2e-14 * 0.9, 0.11, 1, "1e-6", True, None]
)
def test_relative_tolerance_outside_its_range_is_refused(relative):
    with pytest.raises(ParameterError, match="relative_tolerance"):
        Tolerance(relative)


@pytest.mark.parametrize("absolute", [-1e-9, math.nan, math.inf, "0", False])
def test_absolute_tolerance_that_is_no_size_is_refused(absolute):
    with pytest.raises(ParameterError, match="absolute_tolerance"):
        Tolerance(1e-6, absolute)


@pytest.mark.parametrize("absolute", [None, 0, 0.0])
def test_two_tolerances_of_zero_are_refused(absolute):
    with pytest.raises(ParameterError, match="both tolerances are 0"):
        Tolerance(0, absolute)


def test_legal_tolerances_keep_the_meaning_of_sundials():
    assert Tolerance(1e-6).pair == (1e-6, 1e-8)
    assert Tolerance(1e-6, 0).pair == (1e-6, 0)
    assert Tolerance(0, 1e-6).pair == (0, 1e-6)
    assert Tolerance(0.1).relative == 0.1
