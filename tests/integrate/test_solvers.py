"""Names and tolerances of the integrators."""

import inspect
import math
from dataclasses import FrozenInstanceError, dataclass
from fractions import Fraction

import numpy as np
import pytest
from helpers.engines import build
from helpers.oscillators import oscillator

import cosim
from cosim import solvers
from cosim.api import RareKeywords
from cosim.codegen import compiler
from cosim.codegen.runge_kutta.tableau import Tableau
from cosim.errors import ParameterError, UnknownName, UsageError
from cosim.integrate.families.fixed_step import FixedStep
from cosim.integrate.solvers import SOLVERS, default_solver, solver_named
from cosim.model.solver import Tolerance
from cosim.model.times import time_grid
from cosim.study.tradeoff.configuration import Selection
from cosim.study.tradeoff.fixed_steps import observed_order
from cosim.verify.reference import reference

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
    assert default_solver(ode, Tolerance()).name == "cvodes"
    assert default_solver(dae, Tolerance()).name == "idas"


@pytest.mark.parametrize(
    ("name", "hint"),
    [("cvode", "cvodes"), ("ode78", "ode8"), ("IDAS", "idas"), ("bdf", "it has cvodes, cvodes_ad")],
)
def test_unknown_solver_is_refused_with_near_names(ode, name, hint):
    with pytest.raises(UnknownName, match=f"cosim has no solver '{name}'; .*{hint}"):
        solver_named(ode, name)


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


# -- solvers as values ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "shorthand"),
    [
        (solvers.Cvodes(relative_tolerance=1e-6), {"solver": "cvodes", "relative_tolerance": 1e-6}),
        (solvers.Erk(relative_tolerance=1e-6, absolute_tolerance=1e-9),
         {"solver": "erk", "relative_tolerance": 1e-6, "absolute_tolerance": 1e-9}),
        (solvers.Ode8(step_size=0.05), {"solver": "ode8", "step_size": 0.05}),
        (solvers.Rk4(), {"solver": "rk4"}),
    ],
)  # fmt: skip
def test_value_and_shorthand_are_the_same_run(ode, value, shorthand):
    one, two = (
        cosim.simulate(ode, stop_time=0.5, compiled=False, **options)
        for options in ({"solver": value}, shorthand)
    )
    np.testing.assert_array_equal(one.values, two.values)
    assert one.stats["solver"] == value.name


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda: solvers.Dop853(relative_tolerance=0.5), "relative_tolerance = 0.5 is not within"),
        (lambda: solvers.Idas(absolute_tolerance=-1), "absolute_tolerance = -1 is negative"),
        (lambda: solvers.Ode8(step_size=0), "step_size = 0 is not positive"),
        (lambda: solvers.Rk4(step_size=math.nan), "is not finite"),
    ],
)
def test_constructor_refuses_what_cannot_be(make, reason):
    with pytest.raises(ParameterError, match=reason):
        make()


def test_adaptive_value_has_no_step_size_and_no_value_changes():
    with pytest.raises(TypeError, match="step_size"):
        solvers.Dop853(step_size=0.1)
    with pytest.raises(FrozenInstanceError):
        solvers.Dop853().relative_tolerance = 1e-3


def test_numbers_beside_a_value_are_refused(ode):
    with pytest.raises(
        UsageError, match=r"relative_tolerance cannot be combined with the solver Erk.*into Erk\("
    ):
        cosim.simulate(ode, solver=solvers.Erk(), relative_tolerance=1e-6)


def test_class_facts_are_those_of_the_methods():
    facts = {name: (s.order, s.adaptive, s.solves_dae) for name, s in SOLVERS.items()}
    assert facts == {
        "cvodes": (5, True, False),
        "cvodes_adams": (12, True, False),
        "idas": (5, True, True),
        "erk": (5, True, False),
        "rosenbrock": (5, True, True),
        "rk4": (4, False, False),
        "ode8": (8, False, False),
        "dop853": (8, True, True),
    }
    assert [name for name, s in SOLVERS.items() if s.compiled_only] == ["dop853"]
    assert [name for name, s in SOLVERS.items() if s.projects] == ["rk4", "ode8", "dop853"]


def test_every_solver_is_a_public_value():
    assert [getattr(solvers, solver.__name__) for solver in SOLVERS.values()] == [*SOLVERS.values()]
    assert {solver.__name__ for solver in SOLVERS.values()} <= {*solvers.__all__}


@dataclass(frozen=True, kw_only=True)
class Heun(FixedStep):
    """Heun's method of order 3: all that a file of a new solver holds."""

    name = "heun"
    order = 3
    tableau = Tableau(
        3,
        ((), (Fraction(1, 3),), (0, Fraction(2, 3))),
        (Fraction(1, 4), 0, Fraction(3, 4)),
        (0, Fraction(1, 3), Fraction(2, 3)),
    )


def test_solver_is_added_by_a_class_and_a_line_in_the_table(monkeypatch):
    """It runs compiled and interpreted, projects, is offered, refused, and measured like others."""
    monkeypatch.setitem(SOLVERS, "heun", Heun)
    known = oscillator()
    options = {"solver": "heun", "step_size": 0.01}
    for compiled in (True, False):
        run = cosim.simulate(known.dae, compiled=compiled, **options)
        assert np.abs(run["x"] - known.solution(run.time)[0]).max() < 1e-5  # measured 1.6e-6
        assert run.stats["steps"] == 500
    dae = cosim.load("disk_two_bars/reduced")
    with pytest.raises(UsageError, match="heun"):
        cosim.simulate(cosim.load("crank_shaft/multipliers"), solver="heun")
    with pytest.raises(UnknownName, match="did you mean heun"):
        cosim.simulate(dae, solver="hoin")
    request = cosim.requested(dae, stop_time=1.0, output_interval=0.1)
    measured = Selection(solvers=("heun",), backends=("native",)).configurations(request, None)
    assert {each.solver for each in measured} == {"heun"}
    request = cosim.requested(known.dae)
    found = observed_order(request, reference(request), "heun")
    assert found.expected == 3
    assert found.observed == pytest.approx(3, abs=0.15)


# -- what a call takes ----------------------------------------------------------------------------


def test_simulate_has_few_parameters_each_of_them_documented():
    names = list(inspect.signature(cosim.simulate).parameters)
    assert len(names) <= 11  # with **options
    for name in names:
        assert f"        {name}: " in cosim.simulate.__doc__
    assert all(f"`{name}`" in cosim.simulate.__doc__ for name in RareKeywords.__optional_keys__)


def test_unknown_keyword_is_refused_as_python_does(ode):
    for call in (cosim.simulate, cosim.requested):
        with pytest.raises(
            TypeError, match=rf"{call.__name__}\(\) got an unexpected keyword .*'tol'"
        ):
            call(ode, tol=1e-6)


@pytest.mark.parametrize(
    ("foreign", "own"),
    [
        ("rtol", "relative_tolerance"),
        ("abstol", "absolute_tolerance"),
        ("t_end", "stop_time"),
        ("tspan", "stop_time"),
        ("t_eval", "output_times"),
        ("dt", "output_interval"),
        ("parameters", "start_values"),
        ("x0", "start_values"),
        ("method", "solver"),
        ("output", "outputs"),
        ("relative_tol", "relative_tolerance"),
    ],
)
def test_keyword_of_another_tool_leads_to_the_own_one(ode, foreign, own):
    with pytest.raises(TypeError, match=rf"argument '{foreign}'; did you mean {own}\?"):
        cosim.simulate(ode, **{foreign: 1})


@pytest.mark.parametrize("a", [0.11, 1e300])
def test_absolute_tolerance_is_bounded_everywhere(ode, a):
    calls = (
        lambda: cosim.simulate(ode, absolute_tolerance=a),
        lambda: cosim.integrator(ode, [0.0, 1.0], absolute_tolerance=a),
        lambda: cosim.run_scene(
            cosim.Scene("s", cosim.requested(ode)), "fmu-cs", absolute_tolerance=a
        ),
    )
    for call in calls:
        with pytest.raises(ParameterError, match=r"absolute_tolerance = .* is above 0\.1"):
            call()


@pytest.mark.parametrize("number", ["relative_tolerance", "absolute_tolerance"])
def test_tolerance_of_fixed_steps_is_rejected(ode, number):
    with pytest.raises(UsageError, match=f"rk4 has no error control; leave {number} out"):
        cosim.simulate(ode, solver="rk4", **{number: 1e-6})


def test_stats_are_attributes_and_a_mapping(ode):
    stats = cosim.simulate(ode, solver="rk4", stop_time=0.1, compiled=False).stats
    assert stats.steps == stats["steps"] == 10
    assert "relative_tolerance" not in stats
    assert dict(stats)["solver"] == "rk4"
    assert stats.get("invalid", ()) == ()
    with pytest.raises(KeyError):
        stats["invalid"]


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["erk", "rosenbrock"])
def test_nothing_is_compiled_anew_for_other_output_times(solver, monkeypatch):
    dae = cosim.load("disk_two_bars/reduced")
    options = {"solver": solver, "compiled": True}
    once = cosim.simulate(dae, stop_time=0.4, output_interval=0.1, **options)
    monkeypatch.setattr(compiler, "compile_library", lambda *_, **__: pytest.fail("compiled"))
    times = [0.0, 0.17, 0.2, 0.4]
    again = cosim.simulate(dae, output_times=times, **options)
    assert again["theta1"][2] == once["theta1"][2]  # no step ends at an output
    interpreted = cosim.simulate(dae, output_times=times, solver=solver, compiled=False)
    np.testing.assert_allclose(again.values, interpreted.values, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("solver", ["dop853", "erk", "rosenbrock", "cvodes", "idas"])
def test_a_rest_at_late_times_is_integrated(solver):
    model = cosim.Model("rest", stop_time=1.0)
    x, k = model.state("x", "1", 1.0, "state"), model.parameter("k", "1/s", 0.0, "rate")
    model.derivative(x, -k * x)
    for start in (1e9, 1e10):
        times = {"start_time": start, "stop_time": start + 1, "solver": solver}
        assert cosim.simulate(model.freeze(), **times).final["x"] == 1
        many = cosim.simulate_many(model.freeze(), {"k": [0.0, 1.0]}, **times)
        np.testing.assert_allclose(many["x"][:, -1], [1, np.exp(-1)], rtol=1e-5)
