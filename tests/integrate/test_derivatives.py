"""Derivatives of `integrator`: the whole table of models, solvers and arguments, or a refusal.

The truth are differences of order 4 of runs of `dop853` at 1e-13, whose own derivatives are not
used.
"""

from functools import cache
from itertools import product

import casadi as ca
import numpy as np
import pytest

import cosim
from casadi_models import CATALOG
from casadi_models.dae import Model
from cosim.errors import UsageError
from cosim.integrate.solvers import SOLVERS
from cosim.model.catalogue import loaded

GRID = np.linspace(0, 0.06, 4)
ARGUMENTS = ("x0", "p", "u")
BOUND = 1e-6  # of the largest derivative; measured 1e-12 to 3e-8


@cache
def dae_of(name):
    return loaded(name)


def arguments(name):
    """Return a call with inputs that change from one interval to the next."""
    found = cosim.start_vectors(dae_of(name))
    steps = 0.01 * np.arange(len(GRID))
    return found | {"u": found["u"][:, None] + steps * np.ones((len(found["u"]), 1))}


@cache
def truth(name):
    """Return by argument a direction, and the derivative of all states in it."""
    given, random = arguments(name), np.random.default_rng(7)
    run = cosim.integrator(
        dae_of(name), GRID, solver="dop853", relative_tolerance=1e-13, derivatives=False
    )
    found = {}
    for key in ARGUMENTS:
        base = np.array(given[key], dtype=float)
        if not base.size:
            continue
        direction = random.uniform(-1, 1, base.shape) * np.maximum(np.abs(base), 0.1)

        def at(shift, key=key, base=base, direction=direction):
            return np.array(run(**given | {key: base + shift * direction})["xf"])

        h = 2e-4
        slope = (8 * (at(h) - at(-h)) - (at(2 * h) - at(-2 * h))) / (12 * h)
        found[key] = direction, slope
    return found


def products(name, solver, compiled):
    """Return by argument the worst errors of forward and reverse products, scaled."""
    numbers = {"relative_tolerance": 1e-10} if SOLVERS[solver].adaptive else {"step_size": 5e-4}
    run = cosim.integrator(dae_of(name), GRID, solver=solver, compiled=compiled, **numbers)
    given = arguments(name)
    result = run(**given)
    fixed = given | {f"out_{key}": value for key, value in result.items()}
    weights = np.random.default_rng(8).uniform(-1, 1, result["xf"].shape)
    back = run.reverse(1)(**fixed, adj_xf=weights)
    errors = {}
    for key, (direction, slope) in truth(name).items():
        size = np.abs(slope).max()
        forward = np.array(run.forward(1)(**fixed, **{f"fwd_{key}": direction})["fwd_xf"])
        reverse = np.vdot(np.array(back[f"adj_{key}"]), direction.reshape(back[f"adj_{key}"].shape))
        errors[key, "forward"] = np.abs(forward - slope).max() / size
        errors[key, "reverse"] = abs(reverse - np.vdot(weights, slope)) / size
    return errors


EASY = ("crank_shaft/multipliers", "bar_on_frame/reduced", "bar_on_frame/two_body")
LARGE = "disk_two_bars/multipliers"
SLOW_TO_COMPILE = ("rosenbrock", "erk")


def is_refused(name, solver, compiled):
    """Return whether a solver has to reject a formulation."""
    chosen = SOLVERS[solver]
    implicit = dae_of(name).algebraics and not chosen.solves_dae
    return bool(implicit) or (chosen.compiled_only and not compiled)


def table():
    """Yield every formulation with every solver that takes it, compiled and not."""
    for name, solver, compiled in product(CATALOG, SOLVERS, (False, True)):
        quick = is_refused(name, solver, compiled) or (solver == "dop853" and name == LARGE)
        quick = quick or (name in EASY and not (compiled and solver in SLOW_TO_COMPILE))
        yield pytest.param(name, solver, compiled, marks=[] if quick else pytest.mark.slow)


@pytest.mark.quick_share(0.3)
@pytest.mark.slow_rows(
    "crank_shaft/multipliers-idas-False",
    "crank_shaft/multipliers-idas-True",
    "bar_on_frame/two_body-idas-False",
    "bar_on_frame/two_body-idas-True",
    "bar_on_frame/two_body-rosenbrock-False",
    "bar_on_frame/two_body-dop853-True",
    "disk_two_bars/multipliers-dop853-True",
)
@pytest.mark.parametrize(("name", "solver", "compiled"), [*table()])
def test_products_are_right_or_refused(name, solver, compiled):
    chosen = SOLVERS[solver]
    if dae_of(name).algebraics and not chosen.solves_dae:
        with pytest.raises(UsageError, match="use idas or rosenbrock or dop853"):
            products(name, solver, compiled)
        return
    if chosen.compiled_only and not compiled:
        with pytest.raises(UsageError, match="use erk"):
            products(name, solver, compiled)
        return
    found = products(name, solver, compiled)
    assert max(found.values()) < BOUND, found


def test_table_has_every_formulation_and_counts_its_refusals():
    rows = [row.values for row in table()]
    assert len(rows) == len(CATALOG) * len(SOLVERS) * 2
    refused = [row for row in rows if is_refused(*row)]
    implicit = sum(bool(dae_of(name).algebraics) for name in CATALOG)
    assert len(refused) == implicit * 5 * 2 + len(CATALOG)


@pytest.mark.slow_rows("True-bar_on_frame/two_body-idas-Omega_dot")
@pytest.mark.parametrize(
    ("name", "solver", "parameter"),
    [
        ("crank_shaft/driven", "cvodes", "alpha"),
        ("crank_shaft/multipliers", "idas", "alpha"),
        ("bar_on_frame/reduced", "cvodes", "Omega_dot"),
        ("bar_on_frame/two_body", "idas", "Omega_dot"),
    ],
)
@pytest.mark.parametrize("compiled", [False, True])
def test_gradient_of_an_angle_by_an_acceleration_is_a_half(name, solver, parameter, compiled):
    """phi(1) = phi(0) + omega + alpha / 2; CasADi's reverse mode gives 0.52 to 0.88."""
    dae = dae_of(name)
    run = cosim.integrator(dae, [0, 1], solver=solver, compiled=compiled)
    states, parameters = ([v.name for v in group] for group in (dae.states, dae.parameters))
    given = cosim.start_vectors(dae)
    p = ca.MX.sym("p", len(parameters))
    given["p"], numbers = p, given["p"]
    end = run(**given)["xf"][states.index("phi"), -1]
    gradient = ca.Function("g", [p], [ca.gradient(end, p)])(numbers)
    assert float(gradient[parameters.index(parameter)]) == pytest.approx(0.5, abs=1e-6)


@pytest.mark.slow_rows("True-rk4", "True-ode8")
@pytest.mark.parametrize("solver", ["rk4", "ode8"])
@pytest.mark.parametrize("compiled", [False, True])
def test_fixed_steps_are_differentiated_as_they_are(solver, compiled):
    """Step by step, not the solution's: with steps so long that the two differ."""
    model = Model("decay")
    x = model.state("x", "1", 1.0, "what decays")
    k = model.parameter("k", "1/s", 2.0, "rate")
    model.derivative(x, -k * x)
    run = cosim.integrator(model.freeze(), [0, 1], solver=solver, step_size=0.5, compiled=compiled)
    got = float(run.jacobian()(x0=1, p=2.0)["jac_xf_p"][-1])
    h = 1e-5
    own = float(run(x0=1, p=2 + h)["xf"][-1] - run(x0=1, p=2 - h)["xf"][-1]) / (2 * h)
    assert got == pytest.approx(own, abs=1e-9)
    if solver == "rk4":
        assert abs(got + np.exp(-2)) > 1e-3  # of the solution: -exp(-2)


@pytest.mark.slow_rows("rk4-True", "ode8-True")
@pytest.mark.parametrize(
    ("solver", "compiled"),
    [pytest.param(n, c, marks=[pytest.mark.slow] * (c and n in SLOW_TO_COMPILE))
     for n in SOLVERS for c in (False, True)],
)  # fmt: skip
def test_inputs_have_one_shape_for_every_solver(solver, compiled):
    """A column per output time, that holds on the way there; or one for all."""
    if not compiled and SOLVERS[solver].compiled_only:
        return
    model = Model("sum")
    x = model.state("x", "1", 0.0, "sum of an input")
    push = model.input("push", "1/s", 0.0, "what is summed")
    model.derivative(x, push)
    run = cosim.integrator(model.freeze(), [0, 1, 2, 4], solver=solver, compiled=compiled)
    assert run.size_in("u") == (1, 4)
    columns = np.array(run(u=np.array([[99.0, 1.0, -2.0, 0.5]]))["xf"]).ravel()
    np.testing.assert_allclose(columns, [0, 1, -1, 0], atol=1e-7)  # measured 2e-9
    single = np.array(run(u=3.0)["xf"]).ravel()
    np.testing.assert_allclose(single, [0, 3, 6, 12], atol=1e-7)


@pytest.mark.parametrize("compiled", [False, True])
def test_steps_are_those_asked_for_or_the_models_own(compiled):
    """Not one step over the whole interval."""
    dae = dae_of("bar_on_frame/reduced")
    start = cosim.start_vectors(dae)
    truth = cosim.integrator(dae, [0, 1], solver="dop853", relative_tolerance=1e-12)(**start)["xf"]
    for step, error in ((None, 1e-5), (0.002, 1e-7)):
        run = cosim.integrator(dae, [0, 1], solver="rk4", step_size=step, compiled=compiled)
        assert float(ca.norm_inf(run(**start)["xf"] - truth)) < error  # measured 5e-7 and 8e-10


def test_derivatives_of_too_long_a_grid_are_left_out_or_refused():
    dae, grid = dae_of("bicycle/independent"), np.linspace(0, 1, 1001)
    run = cosim.integrator(dae, grid, solver="dop853")
    assert run.size_out("xf") == (11, 1001)
    with pytest.raises(UsageError, match="derivatives at 1001 output times are 3e"):
        cosim.integrator(dae, grid, solver="dop853", derivatives=True)


@pytest.mark.parametrize("compiled", [False, True])
def test_derivatives_of_a_small_state_are_as_accurate_as_it(compiled):
    """Of x = 1e-9 sin(p t) / p, by p."""
    x, p, t = (ca.SX.sym(name) for name in "xpt")
    system = {"x": x, "p": p, "t": t, "ode": 1e-9 * ca.cos(p * t)}
    dae = cosim.from_casadi(system, start_values={"p": 50.0}, nominals={"x": 1e-9})
    run = cosim.integrator(
        dae, [0.0, 1.0], solver="dop853" if compiled else "erk", compiled=compiled
    )
    value = ca.MX.sym("p")
    slope = ca.jacobian(run(p=value)["xf"][1], value)
    exact = 1e-9 * (np.cos(50.0) / 50 - np.sin(50.0) / 2500)
    assert float(ca.Function("slope", [value], [slope])(50.0)) == pytest.approx(exact, rel=1e-6)


@pytest.mark.filterwarnings("ignore:model. a term of time changes")
def test_longest_step_holds_for_derivatives_whatever_the_interval():
    """A pulse of 10 ms in an interval of 100 s."""
    x, p, t = (ca.SX.sym(name) for name in "xpt")
    pulse = p * ca.exp(-(((t - 50.33) / 0.01) ** 2))
    system = {"x": x, "p": p, "t": t, "ode": pulse}
    dae = cosim.from_casadi(system, start_values={"p": 1.0})
    run = cosim.integrator(dae, [0.0, 100.0], solver=SOLVERS["erk"](max_step=0.02), compiled=False)
    value = ca.MX.sym("p")
    slope = ca.Function("slope", [value], [ca.jacobian(run(p=value)["xf"][1], value)])
    assert float(slope(1.0)) == pytest.approx(0.01 * np.sqrt(np.pi), rel=1e-6)


@pytest.mark.parametrize(("solver", "compiled"), [("dop853", True), ("erk", False), ("rk4", False)])
def test_factory_makes_functions_of_the_derivatives(solver, compiled):
    """x = cos(w t) with w^2 = p; dx/dp = -t sin(w t) / 2 w, dv/dp = -(sin(w t) + w t cos) / 2 w."""
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p")
    system = {"x": x, "p": p, "ode": ca.vertcat(x[1], -p * x[0])}
    dae = cosim.from_casadi(system, start_values={"x": [1, 0], "p": 4})
    run = cosim.integrator(dae, [0.0, 1.0, 2.0], solver=solver, compiled=compiled)
    exact = -np.array([2 * np.sin(4.0), np.sin(4.0) + 4 * np.cos(4.0)]) / 4
    given, seeds = {"x0": [1, 0], "p": 4.0}, np.zeros((2, 3))
    found = run.factory("f", ["x0", "p"], ["xf", "jac:xf:p"])(**given)
    assert found["xf"].shape == (2, 3)
    np.testing.assert_allclose(found["jac_xf_p"][-2:, 0], exact[:, None], atol=2e-7)
    forward = run.factory("f", ["x0", "p", "fwd:p"], ["fwd:xf"])(**given, fwd_p=3.0)
    np.testing.assert_allclose(forward["fwd_xf"][:, -1], 3 * exact[:, None], atol=6e-7)
    seeds[:, -1] = 1.0, 2.0
    back = run.factory("f", ["x0", "p", "adj:xf"], ["adj:p"])(**given, adj_xf=seeds)
    assert float(back["adj_p"]) == pytest.approx(exact @ [1.0, 2.0], abs=6e-7)


def hessian_of_the_end(solver, compiled):
    """Return d2x(1)/dk2 of x'' = -k x at k = 4 from x = 1 at rest."""
    x, k = ca.SX.sym("x", 2), ca.SX.sym("k")
    system = {"x": x, "p": k, "ode": ca.vertcat(x[1], -k * x[0])}
    dae = cosim.from_casadi(system, start_values={"x": [1, 0], "k": 4})
    run = cosim.integrator(dae, [0, 1], solver=solver, compiled=compiled)
    p = ca.MX.sym("p")
    return float(ca.Function("h", [p], [ca.hessian(run(x0=[1, 0], p=p)["xf"][0, 1], p)[0]])(4))


@pytest.mark.parametrize("solver", ["cvodes", "idas", "erk", "rosenbrock", "rk4", "ode8"])
def test_interpreted_runs_have_second_derivatives(solver):
    # of cos(sqrt(k)): (sin(s) / s - cos(s)) / (4 k) with s = 2
    assert hessian_of_the_end(solver, False) == pytest.approx(
        (np.sin(2) / 2 - np.cos(2)) / 16, rel=1e-4
    )


def test_missing_second_derivatives_name_the_remedy():
    with pytest.raises(RuntimeError, match="hessian_approximation_to_limited_memory"):
        hessian_of_the_end("dop853", True)
