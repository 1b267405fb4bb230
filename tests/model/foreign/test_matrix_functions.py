"""Matrix operations and functions inside of a model: written out, generated, or refused by name."""

import casadi as ca
import numpy as np
import pytest
from casadi import MX, SX

import cosim
from cosim.errors import UsageError

END = {"stop_time": 1.0, "relative_tolerance": 1e-10}


def of_mx(law) -> dict:
    x, A = MX.sym("x", 2), MX.sym("A", 2, 2)
    return {"x": x, "p": A, "ode": law(A, x)}


@pytest.mark.parametrize(
    ("law", "expected"),
    [
        (lambda A, x: A @ x, lambda A, x: A @ x),
        (ca.solve, np.linalg.solve),
        (lambda A, x: ca.solve(A.T, x), lambda A, x: np.linalg.solve(A.T, x)),
        (lambda A, x: ca.inv(A) @ x, lambda A, x: np.linalg.solve(A, x)),
        (lambda A, x: ca.solve(A, ca.solve(A, x)), lambda A, x: np.linalg.solve(A @ A, x)),
        (lambda A, x: ca.det(A) * x, lambda A, x: np.linalg.det(A) * x),
        (lambda A, x: ca.if_else(x[0] > 0, x, -x), lambda A, x: x),
        (lambda A, x: x / ca.norm_2(x), lambda A, x: x / np.hypot(*x)),
    ],
)
def test_matrix_operations_are_written_out(law, expected):
    A, x = np.array([[2.0, 1.0], [-1.0, 3.0]]), np.array([0.3, -0.4])
    dae = cosim.from_casadi(of_mx(law), {"x": x, "A": A})
    f = ca.Function("f", [dae.x, dae.p], [dae.ode])
    np.testing.assert_allclose(
        f(x, A.ravel(order="F")).full().ravel(), expected(A, x), rtol=0, atol=1e-14
    )


@pytest.mark.slow_rows("linear")
@pytest.mark.parametrize("plugin", ["linear", "bspline"])
def test_interpolant_is_integrated_and_exported(plugin, tmp_path):
    place = np.linspace(0, 2, 9)
    table = ca.interpolant("table", plugin, [place], 1 - place / 2)  # straight: no error
    x = MX.sym("x")
    dae = cosim.from_casadi({"x": x, "ode": table(x)}, name="table")
    exact = 2 * (1 - np.exp(-0.5))
    assert cosim.simulate(dae, **END)["x"][-1] == pytest.approx(exact, abs=1e-8)
    path = cosim.export_fmu(dae, tmp_path / "table.fmu")
    for interface in ("ModelExchange", "CoSimulation"):
        run = cosim.simulate_fmu(path, interface=interface, **END)
        assert run["x"][-1] == pytest.approx(exact, abs=1e-7)


def test_equations_that_call_two_functions_of_equal_sizes_have_events(tmp_path):
    x = MX.sym("x")
    first, last = (
        ca.interpolant(name, "linear", [[0.0, 10.0]], [0.0, height])
        for name, height in (("first", 1.0), ("last", 2.0))
    )
    rate = ca.if_else(x < 0.5, 1 + first(x), 2 + last(x))
    dae = cosim.from_casadi({"x": x, "ode": rate}, name="tables")
    exact = 10.5 * np.exp((1 - 10 * np.log(1.05)) / 5) - 10
    run = cosim.simulate(dae, solver="dop853", **END)
    assert run["x"][-1] == pytest.approx(exact, rel=1e-10)  # before: ValueError
    assert len(run.events) == 1
    path = cosim.export_fmu(dae, tmp_path / "tables.fmu")
    assert cosim.simulate_fmu(path, **END)["x"][-1] == pytest.approx(exact, rel=1e-9)


TABLE = np.array([0.0, 0.5, 1.0, 2.0])
SHIFT = np.arange(900.0).reshape(30, 30) % 7 + 50 * np.eye(30)


def large_system(x):
    return ca.solve(ca.DM(SHIFT) + ca.diag(ca.repmat(x[0], 30, 1)), ca.repmat(x[1], 30, 1))[3]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "expected"),
    [
        (
            large_system,
            lambda x: np.linalg.solve(SHIFT + np.diag(np.full(30, x[0])), np.full(30, x[1]))[3],
        ),
        (ca.logsumexp, lambda x: np.log(np.exp(x).sum())),
        (lambda x: ca.low(ca.DM(TABLE), x[0]), lambda x: float(np.searchsorted(TABLE, x[0]) - 1)),
        (lambda x: x[ca.floor(3 * x[0])], lambda x: x[int(3 * x[0])]),
    ],
    ids=["30 linear equations", "logsumexp", "low", "calculated place"],
)
def test_what_has_no_scalar_form_runs_and_is_exported_as_a_matrix_function(law, expected, tmp_path):
    x = MX.sym("x", 3)
    start = np.array([0.4, 0.7, 0.2])
    y = law(x)
    dae = cosim.from_casadi(
        {"x": x, "ode": ca.vertcat(-x[0], -x[1], y - x[2])}, {"x": start}, {"y": y}, name="whole"
    )
    run = cosim.simulate(dae, **END)
    assert run["y"][0] == pytest.approx(expected(start), rel=1e-12)
    path = cosim.export_fmu(dae, tmp_path / "whole.fmu")
    for interface in ("ModelExchange", "CoSimulation"):
        fmu = cosim.simulate_fmu(path, interface=interface, **END)
        assert fmu["x_3"][-1] == pytest.approx(run["x_3"][-1], abs=1e-6)
        assert fmu["y"][0] == pytest.approx(expected(start), rel=1e-12)


class Python(ca.Callback):
    """x -> x, in Python."""

    def __init__(self):
        super().__init__()
        self.construct("in_python", {})

    def eval(self, arguments):
        return [arguments[0]]


def test_callback_is_refused_by_name():
    called = Python()
    with pytest.raises(UsageError, match=r"calls 'in_python', a callback: .* write them"):
        cosim.from_casadi({"x": (x := MX.sym("x")), "ode": called(x)})


def root(plugin: str) -> ca.Function:
    y, p = SX.sym("y"), SX.sym("p")
    return ca.rootfinder("root", plugin, {"x": y, "p": p, "g": y**2 - p})


def test_newton_is_refused_by_name_and_fast_newton_taken():
    x = MX.sym("x")
    with pytest.raises(UsageError, match=r"calls 'root', of type Newton: use .*'fast_newton'"):
        cosim.from_casadi({"x": x, "ode": root("newton")(1, x)})
    dae = cosim.from_casadi({"x": x, "ode": -2 * root("fast_newton")(1, x)}, {"x": 4.0})
    assert cosim.simulate(dae, **END)["x"][-1] == pytest.approx(
        1.0, abs=1e-7
    )  # x' = -2 sqrt x: x = (2 - t)^2


def test_integrator_inside_is_refused_by_name():
    x = MX.sym("x")
    y = SX.sym("y")
    inner = ca.integrator("inner", "cvodes", {"x": y, "ode": -y})
    with pytest.raises(UsageError, match="calls 'inner', of type CvodesInterface"):
        cosim.from_casadi({"x": x, "ode": inner(x0=x)["xf"]})
