"""Equations of motion formed by SymPy: published values, closed forms, our own models."""

import sys
from importlib import import_module
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

pytest.importorskip("sympy", reason='needs `pip install "cosim-rigid[sympy]"`')
pytest.importorskip("scipy", reason="needs `pip install scipy`")
import sympy as sm
from helpers import sympy_models
from scipy.special import ellipj, ellipk
from sympy.physics.mechanics import (
    KanesMethod,
    LagrangesMethod,
    ReferenceFrame,
    System,
    dynamicsymbols,
)

import cosim
from casadi_models.dae import expressions
from cosim.errors import InitialConditionError, MissingTool, ParameterError, UnknownName, UsageError

t = dynamicsymbols._t
PENDULUM = {"m": 1.3, "g": 9.81, "l": 0.7}
BARS = {"l1": 1, "l2": 2, "l3": 1.7, "l4": 2.2, "rho": 1.5, "g": 9.81}
CRANK = {"q1": 1.0, "q2": -1.0, "q3": -1.5}
LAGRANGE = CRANK | {"q1_dot": 0.5}


def swing(time, start=1.0):
    """Return the angle of a pendulum that starts at rest."""
    k = np.sin(start / 2)
    omega = np.sqrt(9.81 / 0.7)
    sn, *_ = ellipj(ellipk(k**2) - omega * time, k**2)
    return 2 * np.arcsin(k * sn)


def four_bar(method, **options):
    starts = LAGRANGE if method is LagrangesMethod else CRANK | {"u1": 0.5}
    formed, energy, gap = sympy_models.four_bar(method)
    outputs = {"energy": energy, "gap_x": gap[0], "gap_y": gap[1]}
    return cosim.from_sympy(formed, BARS, starts, outputs, name="four_bar", **options)


@pytest.fixture(scope="module")
def bicycle():
    kane, values = sympy_models.bicycle()
    return cosim.from_sympy(kane, values, {"u3": 4.6 / 0.3, "u2": 0.5}, name="whipple")


@pytest.mark.quick_share(0.3)
@pytest.mark.slow_rows("rosenbrock-kane", "rosenbrock-lagrange", "rosenbrock-system by lagrange")
@pytest.mark.parametrize(
    ("form", "names"),
    [
        (sympy_models.pendulum_by_kane, ["q", "u"]),
        (sympy_models.pendulum_by_lagrange, ["q", "q_dot"]),
        (sympy_models.pendulum_by_system, ["q", "u"]),
        (lambda: sympy_models.pendulum_by_system(LagrangesMethod), ["q", "q_dot"]),
    ],
    ids=["kane", "lagrange", "system", "system by lagrange"],
)
@pytest.mark.parametrize("solver", ["cvodes", "rosenbrock", "dop853", "rk4"])
def test_pendulum_is_its_closed_form(form, names, solver):
    dae = cosim.from_sympy(form(), PENDULUM, {"q": 1.0}, units={"q": "rad"}, name="pendulum")
    assert [s.name for s in dae.states] == names
    assert [s.unit for s in dae.states] == ["rad", "1"]
    tolerance, bound = ({}, 2e-7) if solver == "rk4" else ({"relative_tolerance": 1e-10}, 2e-8)
    run = cosim.simulate(dae, stop_time=2.0, solver=solver, **tolerance)
    np.testing.assert_allclose(run["q"], swing(run.time), rtol=0, atol=bound)  # 6e-9; rk4: 6e-8


@pytest.mark.slow_rows("rosenbrock")
@pytest.mark.parametrize("solver", ["idas", "rosenbrock", "dop853"])
def test_multiplier_of_a_pendulum_is_its_rod(solver):
    x, y, lam1 = dynamicsymbols("x y lam1")
    dae = cosim.from_sympy(
        sympy_models.pendulum_in_cartesian_coordinates(),
        PENDULUM,
        {"x": 0.7 * np.cos(1.0), "y": 0.7 * np.sin(1.0)},
        {"angle": sm.atan2(y, x), "tension": 2 * lam1 * sm.Symbol("l"), "fall": x.diff(t, 2)},
    )
    assert [z.name for z in dae.algebraics] == ["x_dot_dot", "y_dot_dot", "lam1"]
    run = cosim.simulate(dae, stop_time=2.0, relative_tolerance=1e-10, solver=solver)
    np.testing.assert_allclose(run["angle"], swing(run.time), rtol=0, atol=3e-8)  # 5e-9
    tension = 1.3 * 9.81 * (3 * np.cos(run["angle"]) - 2 * np.cos(1.0))
    np.testing.assert_allclose(run["tension"], tension, rtol=0, atol=3e-6)
    assert run["fall"][0] == pytest.approx(9.81 * np.sin(1.0) ** 2, rel=1e-12)


def test_rolling_disc_is_evaluated_as_by_sympy_and_keeps_its_energy():
    kane, energy = sympy_models.rolling_disc()
    values = {"m": 2.0, "g": 9.81, "r": 0.5}
    starts = {"q1": 0.3, "q2": 0.2, "u1": 0.1, "u2": 6.0, "u3": 0.3}
    dae = cosim.from_sympy(kane, values, starts, {"energy": energy}, name="disc")
    numbers = {sm.Symbol(n): v for n, v in values.items()}
    numbers |= {x: starts.get(x.name, 0.0) for x in (*kane.q, *kane.u)}
    expected = np.array(kane.rhs().xreplace(numbers).evalf(20), dtype=float).ravel()
    rates = ca.Function("rates", [dae.x, dae.p], [dae.ode])
    found = rates(dae.x_start, [p.start for p in dae.parameters])
    np.testing.assert_allclose(found.full().ravel(), expected, rtol=1e-13)
    run = cosim.simulate(dae, stop_time=5.0, relative_tolerance=1e-10)
    np.testing.assert_allclose(run["energy"], run["energy"][0], rtol=1e-8)


def test_auxiliary_speeds_give_the_contact_force():
    kane, energy = sympy_models.rolling_disc(forces=True)
    starts = {"q2": 0.2, "u2": 6.0, "u3": 0.3}
    dae = cosim.from_sympy(kane, {"m": 2.0, "g": 9.81, "r": 0.5}, starts, {"energy": energy})
    assert [v.name for v in dae.output_variables] == ["fx", "fy", "fz", "energy"]
    run = cosim.simulate(dae, stop_time=2.0, output_interval=1e-3, relative_tolerance=1e-10)
    height = 0.5 * np.cos(run["q2"])  # of the center
    lift = 2.0 * (9.81 + np.gradient(np.gradient(height, run.time), run.time))
    np.testing.assert_allclose(run["fz"][5:-5], lift[5:-5], rtol=0, atol=2e-4)  # measured 2e-5


@pytest.mark.slow
@pytest.mark.parametrize("method", [KanesMethod, LagrangesMethod])
def test_four_bars_stay_closed_and_keep_their_energy(method):
    dae = four_bar(method)
    run = cosim.simulate(dae, stop_time=5.0, relative_tolerance=1e-10)
    assert np.abs([run["gap_x"], run["gap_y"]]).max() < 1e-7  # measured 2e-8, 4e-10
    assert np.ptp(run["energy"]) < 1e-5  # J; measured 1.4e-6, 2e-8
    run = cosim.simulate(dae, stop_time=5.0, drift_control="projection")
    assert np.abs([run["gap_x"], run["gap_y"]]).max() < 1e-14


@pytest.mark.slow
def test_four_bars_by_both_methods_agree():
    kane, lagrange = (
        cosim.simulate(four_bar(m), stop_time=5.0, relative_tolerance=1e-10, solver="dop853")
        for m in (KanesMethod, LagrangesMethod)
    )
    for one, other in zip(("q1", "q2", "u1", "u3"), ("q1", "q2", "q1_dot", "q3_dot"), strict=True):
        np.testing.assert_allclose(kane[one], lagrange[other], rtol=0, atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("method", [KanesMethod, LagrangesMethod])
def test_fmu_is_the_native_run(method, tmp_path):
    loads = ("lam1", "lam2", "q1_dot_dot", "q2_dot_dot", "q3_dot_dot")
    sizes = dict.fromkeys(loads if method is LagrangesMethod else (), 100.0)
    dae = four_bar(method, nominals=sizes | {"energy": 100.0})
    options = {"stop_time": 1.0, "relative_tolerance": 1e-10}
    run = cosim.simulate(dae, **options)
    path = cosim.export_fmu(dae, tmp_path / "four_bar.fmu")
    for interface in ("ModelExchange", "CoSimulation"):
        again = cosim.simulate_fmu(path, interface=interface, output_interval=0.01, **options)
        assert cosim.compare(run, again).agrees


def test_skate_on_a_slope_is_its_closed_form():
    x, y, q = dynamicsymbols("x y q")
    m, inertia, pull = sm.symbols("m J a")
    kinetic = m * (x.diff() ** 2 + y.diff() ** 2) / 2 + inertia * q.diff() ** 2 / 2
    skate = LagrangesMethod(
        kinetic + m * pull * x, [x, y, q],
        nonhol_coneqs=[x.diff() * sm.sin(q) - y.diff() * sm.cos(q)],
    )  # fmt: skip
    skate.form_lagranges_equations()
    dae = cosim.from_sympy(skate, {m: 2, inertia: 0.3, pull: 1.5}, {q.diff(): 2.0})
    run = cosim.simulate(dae, stop_time=4.0, relative_tolerance=1e-10)
    s = np.sin(2 * run.time)
    np.testing.assert_allclose(run["x"], 1.5 / 8 * s**2, rtol=0, atol=1e-8)
    slid = 1.5 / 4 * (run.time - np.sin(4 * run.time) / 4)
    np.testing.assert_allclose(run["y"], slid, rtol=0, atol=1e-8)


def test_other_functions_of_time_are_inputs_and_their_derivatives_belong_together():
    x, y, f = dynamicsymbols("x y f")
    m, k = sm.symbols("m k")
    N = ReferenceFrame("N")
    P = sm.physics.mechanics.Point("P")
    P.set_vel(N, (x.diff() + y.diff()) * N.x)
    spring = LagrangesMethod(
        m * (x.diff() + y.diff()) ** 2 / 2 - k * x**2 / 2, [x], forcelist=[(P, f * N.x)], frame=N
    )
    spring.form_lagranges_equations()
    dae = cosim.from_sympy(spring, {m: 0.5, k: 8}, {y.diff(t, 2): 2.0, f: 3.0}, {"place": x + y})
    assert [s.name for s in dae.states] == ["x", "x_dot", "y", "y_dot"]
    assert {u.name: u.start for u in dae.inputs} == {"f": 3.0, "y_dot_dot": 2.0}
    run = cosim.simulate(dae, stop_time=2.0, relative_tolerance=1e-10)
    expected = (3.0 - 0.5 * 2.0) / 8 * (1 - np.cos(4 * run.time))
    np.testing.assert_allclose(run["x"], expected, rtol=0, atol=1e-8)
    np.testing.assert_allclose(run["place"] - run["x"], run.time**2, rtol=0, atol=1e-8)


def test_all_functions_that_casadi_has_are_printed():
    q, u, v = dynamicsymbols("q u v")
    a = sm.Symbol("a")
    shapes = [
        *(f(a * v) for f in (sm.sin, sm.cos, sm.tan, sm.asin, sm.acos, sm.atan, sm.exp, sm.sign)),
        *(f(v / 3) for f in (sm.sinh, sm.cosh, sm.tanh, sm.asinh, sm.atanh, sm.Abs)),
        sm.acosh(2 + v), sm.log(v), sm.atan2(v, a), sm.Min(v, a, 2), sm.Max(v, a), v**a, sm.pi * v,
        1 / sm.sqrt(v), v ** sm.Rational(-3, 2), (v + a) ** 3 / v, v * a + v * 2 - a * u, 0 * v + 5,
    ]  # fmt: skip
    kane = sympy_models.pendulum_by_kane()
    outputs = {f"y{i}": shape for i, shape in enumerate(map(sm.sympify, shapes))}
    starts = {"q": 0.4, "u": -0.3, "v": 0.7}
    dae = cosim.from_sympy(kane, PENDULUM | {"a": 0.6}, starts, outputs)
    run = cosim.simulate(dae, stop_time=0.01)
    numbers = {q: 0.4, u: -0.3, v: 0.7, a: 0.6}
    for name, shape in outputs.items():
        assert run[name][0] == pytest.approx(float(shape.xreplace(numbers)), rel=1e-14), shape


SPEEDS = np.arange(0.0, 11.0, 2.5)


@pytest.mark.slow
@pytest.mark.parametrize("v", SPEEDS)
def test_bicycle_has_the_published_matrices_and_our_eigenvalues(bicycle, v):
    starts = {"u3": v / 0.3, "u2": 0.0}
    linear = cosim.linearize(bicycle, start_values=starts, outputs=["u1"])
    names = [s.name for s in bicycle.states]
    rows = [names.index(n) for n in ("q2", "q5", "u2", "u5")]
    published = [  # Meijaard et al. 2007 in the order of SymPy's documentation
        [0, 0, 1, 0],
        [0, 0, 0, 1],
        [9.48977444677355, -0.891197738059089 * v**2 - 0.571523173729245,
         -0.105522449805691 * v, -0.330515398992311 * v],
        [11.7194768719633, -1.97171508499972 * v**2 + 30.9087533932407,
         3.67680523332152 * v, -3.08486552743311 * v],
    ]  # fmt: skip
    A = np.array(linear.A)[np.ix_(rows, rows)]
    np.testing.assert_allclose(A, published, rtol=0, atol=1e-11)
    ours = cosim.linearize(
        "bicycle", start_values={"thetaR_dot": -v / 0.3, "phi_dot": 0.0}, outputs=["phi"]
    )
    names = [s.name for s in cosim.load("bicycle").states]
    rows = [names.index(n) for n in ("phi", "delta", "phi_dot", "delta_dot")]
    other = np.array(ours.A)[np.ix_(rows, rows)]
    eigenvalues = [np.sort_complex(np.linalg.eigvals(matrix)) for matrix in (A, other)]
    np.testing.assert_allclose(*eigenvalues, rtol=0, atol=1e-10)


@pytest.mark.slow
def test_bicycle_weaves_as_ours(bicycle):
    options = {"stop_time": 2.0, "relative_tolerance": 1e-11}
    run = cosim.simulate(bicycle, **options)
    ours = cosim.simulate(
        "bicycle", start_values={"thetaR_dot": -4.6 / 0.3, "phi_dot": 0.5}, **options
    )
    for name, other, sign in (("q2", "phi", 1), ("q5", "delta", 1), ("q1", "psi", -1)):
        np.testing.assert_allclose(run[name], sign * ours[other], rtol=0, atol=1e-8)


@pytest.mark.slow
def test_bicycle_takes_a_bounded_number_of_operations(bicycle):
    """As C code it takes 1.2 to 1.4 times as long as ours."""
    assert bicycle.operations() < 1.5 * cosim.load("bicycle").operations()  # measured 1.46


def compared(monkeypatch, kane, values=PENDULUM, starts=None):
    """Return whether the equations from the bodies are those of SymPy."""
    found = []

    def is_cheaper(one, other):
        found.append(expressions.are_equal(one, other))
        return False

    monkeypatch.setattr(import_module("cosim.model.foreign.from_sympy"), "is_cheaper", is_cheaper)
    cosim.from_sympy(kane, values, starts)
    return found


DISC = {"m": 2.0, "g": 9.81, "r": 0.5}


@pytest.mark.slow_rows("four bars", "bicycle")
@pytest.mark.parametrize(
    "form",
    [
        lambda: (sympy_models.pendulum_by_kane(), PENDULUM),
        lambda: (sympy_models.pendulum_by_system(), PENDULUM),
        lambda: (sympy_models.rolling_disc()[0], DISC),
        lambda: (sympy_models.rolling_disc(forces=True)[0], DISC),
        lambda: (sympy_models.four_bar()[0], BARS),
        sympy_models.bicycle,
    ],
    ids=["pendulum", "system", "disc", "disc with forces", "four bars", "bicycle"],
)
def test_equations_from_the_bodies_are_those_of_sympy(monkeypatch, form):
    assert compared(monkeypatch, *form()) == [True]


def rod(rate=1, aside=0):
    """Return two particles on a rod; the force that holds the outer one along it does no work."""
    q, u, ua, pull, mass = dynamicsymbols("q u ua pull mass")
    N = ReferenceFrame("N")
    A = N.orientnew("A", "Axis", [q, N.z])
    A.set_ang_vel(N, rate * u * N.z)
    ends = [sm.physics.mechanics.Point(name) for name in "OPQ"]
    ends[1].set_pos(ends[0], A.x)
    ends[2].set_pos(ends[1], 2 * A.x)
    ends[1].set_vel(N, u * A.y)
    across = sm.cos(q) * N.y - sm.sin(q) * N.x  # A.y
    ends[2].set_vel(N, u * A.y + (2 + aside) * u * across + ua * A.x)
    bobs = [
        sm.physics.mechanics.Particle(end.name, end, m)
        for end, m in zip(ends[1:], (sm.Symbol("m"), mass), strict=True)
    ]
    kane = KanesMethod(N, [q], [u], [q.diff() - u], u_auxiliary=[ua])
    kane.kanes_equations(bobs, [(ends[2], pull * A.x), (A, sm.Symbol("l") * N.z)])
    return kane


def test_force_between_bodies_of_one_frame_is_its_closed_form(monkeypatch):
    values = {"m": 1.3, "l": 0.7, "mass": 2.0}
    dae = cosim.from_sympy(rod(), values, {"u": 4.0})  # the outer mass is an input
    run = cosim.simulate(dae, stop_time=1.0, relative_tolerance=1e-10)
    np.testing.assert_allclose(run["pull"], -2.0 * 3 * run["u"] ** 2, rtol=1e-12)
    np.testing.assert_allclose(run["u"], 4.0 + 0.7 / (1.3 + 9 * 2.0) * run.time, rtol=1e-9)
    assert compared(monkeypatch, rod(), values) == [True]


def test_contradictory_velocities_leave_the_equations_to_sympy(monkeypatch):
    values = {"m": 1.3, "l": 0.7, "mass": 2.0}
    assert compared(monkeypatch, rod(aside=1), values) == [True]  # positions count nowhere
    assert compared(monkeypatch, rod(rate=2), values) == [False]


@pytest.mark.slow
def test_example_is_the_disc_of_the_documentation():
    path = Path(__file__).parents[3] / "examples" / "rolling_disc.py"
    kane, _ = sympy_models.rolling_disc(forces=True)
    starts = {"q2": 0.2, "u2": 6.0, "u3": 0.3}
    dae = cosim.from_sympy(kane, {"m": 2.0, "g": 9.81, "r": 0.5}, starts)
    runs = [
        cosim.simulate(model, stop_time=2.0, relative_tolerance=1e-10)
        for model in (cosim.load(f"{path}:build"), dae)
    ]
    for name in ("q2", "u3", "fz"):
        np.testing.assert_allclose(runs[0][name], runs[1][name], rtol=0, atol=1e-7)


def message(error, *arguments, **options):
    with pytest.raises(error) as caught:
        cosim.from_sympy(*arguments, **options)
    text = str(caught.value)
    assert text.startswith("from_sympy")
    assert "\n" not in text
    return text


def test_bad_values_are_rejected():
    kane = sympy_models.pendulum_by_kane()
    assert "parameter l has no value" in message(ParameterError, kane, {"m": 1, "g": 9.81})
    assert "did you mean q" in message(UnknownName, kane, PENDULUM, {"qq": 1})
    assert "has no parameter 'zz'" in message(UnknownName, kane, PENDULUM | {"zz": 1})
    assert "start value of 'qq'" in message(UnknownName, kane, PENDULUM, {"qq": 1})
    assert "unit of" in message(UnknownName, kane, PENDULUM, units={"w": "rad"})
    assert "give numbers" in message(ParameterError, kane, PENDULUM | {"m": sm.Symbol("M")})
    assert "a dict" in message(UsageError, kane, [1, 2])
    assert "scalar expressions" in message(
        UsageError, kane, PENDULUM, outputs={"N": ReferenceFrame("N").x}
    )
    dependent, *_ = sympy_models.four_bar()
    assert "u2(t) depends on the others" in message(UsageError, dependent, BARS, {"u2": 1})
    assert "from_sympy(model): parameter" in message(ParameterError, kane)


def test_equations_that_are_not_formed_are_rejected():
    q, u = dynamicsymbols("q u")
    unformed = KanesMethod(ReferenceFrame("N"), [q], [u], [q.diff() - u])
    assert "kanes_equations" in message(UsageError, unformed)
    assert "form_lagranges_equations" in message(UsageError, LagrangesMethod(q.diff() ** 2, [q]))
    assert "form_eoms" in message(UsageError, System())
    assert "KanesMethod" in message(UsageError, "bicycle")


def test_expressions_without_casadi_form_are_rejected():
    kane, q = sympy_models.pendulum_by_kane(), dynamicsymbols("q")

    def output(expression):
        return message(UsageError, kane, PENDULUM, outputs={"y": expression})

    assert "Piecewise" in output(sm.Piecewise((q, q > 0), (0, True)))
    assert "gamma" in output(sm.gamma(q))
    assert "Derivative(q(t), (t, 2))" in output(q.diff(t, 2))
    assert "f(q(t))" in output(sm.Function("f")(q))
    assert "ImaginaryUnit" in output(sm.I * q)


def test_constraints_that_repeat_or_contradict_are_rejected():
    x, y = dynamicsymbols("x y")
    kinetic = (x.diff() ** 2 + y.diff() ** 2) / 2
    twice = LagrangesMethod(kinetic, [x, y], hol_coneqs=[x - y, 2 * x - 2 * y])
    twice.form_lagranges_equations()
    assert "repeats others" in message(UsageError, twice)
    apart, *_ = sympy_models.four_bar()
    dae = cosim.from_sympy(apart, BARS | {"l4": 9.0}, CRANK)
    with pytest.raises(InitialConditionError, match="satisfies the configuration constraints;"):
        cosim.simulate(dae, stop_time=1.0)


def test_loads_of_auxiliary_equations_need_as_many_unknowns():
    kane, _ = sympy_models.rolling_disc(forces=True)
    values = {"m": 2.0, "g": 9.81, "r": 0.5, "fz": 1.0}
    assert "3 auxiliary equations" in message(UsageError, kane, values)


def test_missing_package_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "sympy", None)
    with pytest.raises(MissingTool, match=r"cosim-rigid\[sympy\]"):
        cosim.from_sympy(None)
