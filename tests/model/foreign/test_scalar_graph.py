"""Matrix expressions written out in scalars against CasADi's own evaluation of them."""

import casadi as ca
import numpy as np
import pytest
from casadi import DM, MX, SX

import cosim
from cosim.model.foreign.casadi_system import scalar_graph

INDEX, X = MX.sym("i"), MX.sym("x")
CASES = [X, 2 * X, ca.sin(X)]
INDICES = [
    *np.arange(-1.5, len(CASES) + 1.6, 0.25),
    *(-0.0, 1e-300, np.nextafter(0, -1), np.nextafter(1, 0), np.nextafter(-1, 0)),
    *(np.nan, np.inf, -np.inf, 1e19),
]


def switch() -> ca.Function:
    """Return a Switch of two results, one of them with fewer entries in its default."""
    both = [ca.Function("a", [X], [X, ca.vertcat(X, 1)]), ca.Function("b", [X], [-X, MX(2, 1)])]
    return ca.Function.conditional("pick", both, both[0])


def nested() -> MX:
    return ca.conditional(INDEX, [X, ca.conditional(X, [INDEX, 2 * INDEX], -INDEX, True)], -X, True)


def called() -> MX:
    return ca.Function("inside", [INDEX, X], [nested()])(INDEX + 0.5, X)


def kept_as_a_call() -> MX:
    return ca.Function("inside", [INDEX, X], [nested()], {"never_inline": True})(INDEX + 0.5, X)


def mapped(kind: str = "serial") -> MX:
    indices = ca.horzcat(INDEX, INDEX + 1, INDEX - 1)
    first, second = switch().map(3, kind)(indices, ca.horzcat(X, X, 2 * X))
    return ca.vertcat(first, second)


def accumulated() -> MX:
    step = ca.Function("step", [X, INDEX], [X + ca.if_else(INDEX, X, -1, True)])
    return step.mapaccum("steps", 4)(X, ca.horzcat(INDEX, INDEX + 0.5, -INDEX, 0))


EXPRESSIONS = {
    "conditional": ca.conditional(INDEX, CASES, -X, True),
    "all cases evaluated": ca.conditional(INDEX, CASES, -X, False),
    "if_else": ca.if_else(INDEX, X, 1 / (X - X), True),
    "two results": ca.vertcat(*switch()(INDEX, X)),
    "nested": nested(),
    "called": called(),
    "kept as a call": kept_as_a_call(),
    "mapped": mapped(),
    "mapped on threads": mapped("thread"),
    "accumulated": accumulated(),
    "in a system": ca.solve(ca.diag(ca.vertcat(2, called(), 1)), ca.vertcat(X, nested(), 1)),
}


@pytest.mark.parametrize("name", EXPRESSIONS)
def test_scalars_are_what_casadi_evaluates(name):
    """A short-circuit conditional cuts its index towards zero; the others compare."""
    expression = EXPRESSIONS[name]
    own = ca.Function("own", [INDEX, X], [expression])
    scalar = scalar_graph("test", [INDEX, X], [expression])
    assert scalar.class_name() == "SXFunction"
    for index in INDICES:
        for x in (0.3, -1.2, 1.7, np.nan):
            np.testing.assert_array_equal(np.array(scalar(index, x)), np.array(own(index, x)))


def test_slopes_are_those_of_the_case():
    scalar = scalar_graph("test", [INDEX, X], [EXPRESSIONS["conditional"]])
    slope = ca.Function("slope", [INDEX, X], [ca.jacobian(scalar(INDEX, X), X)])
    found = [float(slope(index, 0.3)) for index in (-1.0, -0.5, 0.7, 1.9, 2.9, 3.0, np.nan)]
    assert found == [-1.0, 1.0, 1.0, 2.0, np.cos(0.3), -1.0, -1.0]


def system(kind) -> dict:
    """Return dx/dt chosen by the logarithm of u: NaN where u is negative."""
    x, u = kind.sym("x"), kind.sym("u")
    if kind is SX:  # SX knows no short circuit: a function of MX that is called
        pick = ca.Function("pick", [INDEX, X], [EXPRESSIONS["conditional"]], {"never_inline": True})
        return {"x": x, "u": u, "ode": pick.call([ca.log(u), x])[0]}
    cases = [x, 2 * x, ca.sin(x)]
    return {"x": x, "u": u, "ode": ca.conditional(ca.log(u), cases, -x, True)}


@pytest.mark.slow_rows("MX")
@pytest.mark.parametrize("kind", [SX, MX])
def test_short_circuit_on_both_backends(kind, tmp_path):
    system_ = system(kind)
    dae = cosim.from_casadi(system_, {"x": 0.4, "u": 1.0}, {"rate": system_["ode"]})
    own = ca.Function("own", [INDEX, X], [EXPRESSIONS["conditional"]])
    path = cosim.export_fmu(dae, tmp_path / "m.fmu")
    options = {"stop_time": 0.01, "output_interval": 0.01}
    for u in (-1.0, *np.exp([-1.5, -0.5, 0.6, 1.6, 2.5, 3.5])):
        exact = float(own(np.log(u) if u > 0 else np.nan, DM(0.4)))
        start_values = {"u": float(u)}
        runs = [cosim.simulate(dae, start_values=start_values, compiled=False, **options)]
        runs += [
            cosim.simulate_fmu(path, interface=i, start_values=start_values, **options)
            for i in ("ModelExchange", "CoSimulation")
        ]
        for run in runs:
            assert run["rate"][0] == pytest.approx(exact, rel=1e-15)
