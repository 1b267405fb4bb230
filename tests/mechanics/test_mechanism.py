"""Mechanisms with loops in one call, against energy, closed forms and each other."""

import casadi as ca
import numpy as np
import pytest
from casadi import SX, cos, sin
from scipy.integrate import solve_ivp

import cosim
from casadi_models.dae import Model
from casadi_models.mechanics import kane
from casadi_models.mechanics.mechanism import mechanism

LENGTHS = (1.0, 2.0, 1.5)  # crank, coupler, rocker; the ground link is 2


def bars(q, u, pivot, g):
    """Return inertias, loads, potential energy and loops of the bars; `pivot` is the rocker's x."""
    along = [length * ca.vertcat(cos(q[i]), sin(q[i])) for i, length in enumerate(LENGTHS)]
    starts = [SX(2, 1), along[0], ca.vertcat(pivot, 0)]
    inertias, loads, potential = [], [], SX(0)
    for i, length in enumerate(LENGTHS):
        center = starts[i] + along[i] / 2
        velocity = ca.jtimes(center, q, u)
        inertias += [
            kane.InertialTerm(velocity, length * velocity),
            kane.InertialTerm(u[i], length**3 / 12 * u[i]),
        ]
        loads.append(kane.Load(velocity, ca.vertcat(0, -length * g)))
        potential += length * g * center[1]
    return inertias, loads, potential, {"closure": along[0] + along[1] - starts[2] - along[2]}


def four_bar(form: str = "", **options):
    """Return a four-bar of slender bars, 1 kg/m, under gravity; absolute angles."""
    model = Model("four_bar", form)
    q = ca.vertcat(
        *(
            model.state(f"q{i}", "rad", start, f"angle {i}")
            for i, start in ((1, 1.2), (2, 0.4), (3, 1.3))
        )
    )
    u = SX.sym("u", 3)
    g = model.parameter("g", "m/s2", 9.81, "gravity")
    inertias, loads, potential, loops = bars(q, u, 2, g)
    if form == "ode":
        options = {"independent": q[0]} | options
    found = mechanism(model, q, u, inertias, loads, loops, speed_starts={"q1": 2.0}, **options)
    model.energies(found.kinetic_energy, potential)
    model.output("gap", "m", ca.norm_2(loops["closure"]), "gap of the loop")
    return model.freeze()


@pytest.fixture(scope="module")
def runs():
    options = {"stop_time": 2.0, "relative_tolerance": 1e-10, "compiled": False}
    return {form: cosim.simulate(four_bar(form), **options) for form in ("ode", "multipliers")}


def test_bars_of_any_length_close_before_their_constraints_are_judged():
    found = []
    for length in (1.0, 1e-13):
        model = Model("bars")
        angles = [model.state(f"q{i}", "rad", q, f"angle {i}") for i, q in enumerate((1.0, 0.1, 1))]
        q, u = ca.vertcat(*angles), SX.sym("u", 3)
        ends = [length * own * ca.vertcat(cos(q[i]), sin(q[i])) for i, own in enumerate(LENGTHS)]
        loop = {"loop": ends[0] + ends[1] - ends[2] - ca.vertcat(2 * length, 0)}
        mechanism(model, q, u, [kane.InertialTerm(u[i], u[i]) for i in range(3)], (), loop)
        dae = model.freeze().watching(["constraint_condition"])
        condition = ca.Function("condition", dae.arguments, [dae.constraint_condition])
        found.append(float(condition(0, [1.0, 0.3, 1.2, 0, 0, 0], 0, [], [])))
    assert found[1] == pytest.approx(found[0], rel=1e-12)  # before: 5e-3 apart


def test_both_forms_keep_the_energy_and_close_the_loop(runs):
    for run in runs.values():
        assert np.abs(run["energy"] - run["energy"][0]).max() < 1e-6
        assert run["gap"].max() < 1e-7
    assert runs["ode"]["gap"][0] < 1e-12


def test_both_forms_agree(runs):
    for name in ("q1", "q2", "q3", "q1_dot", "energy"):
        assert np.abs(runs["ode"][name] - runs["multipliers"][name]).max() < 1e-5


def test_starts_follow_from_the_loops(runs):
    run = runs["multipliers"]
    assert run["q1"][0] == 1.2
    assert run["q1_dot"][0] == 2.0
    q = [run[f"q{i}"][0] for i in (1, 2, 3)]
    u = [run[f"q{i}_dot"][0] for i in (1, 2, 3)]
    slip = [
        sum(
            s * length * u[i] * f(q[i])
            for i, (length, s) in enumerate(zip(LENGTHS, (1, 1, -1), strict=True))
        )
        for f in (np.sin, np.cos)
    ]
    np.testing.assert_allclose(slip, 0, atol=1e-12)


def shaken(form: str):
    """Return the four-bar with its right pivot shaken by x = 2 + 0.1 sin 5t, crank as before."""
    model = Model("shaken", form)
    names = {"q1": 1.2, "q2": 0.4, "q3": 1.3, "s": 0.0}
    q = ca.vertcat(*(model.state(n, "rad", start, n) for n, start in names.items()))
    u = SX.sym("u", 4)
    inertias, loads, potential, loops = bars(q, u, 2 + q[3], 9.81)
    options = {"independent": q[0]} if form == "ode" else {}
    speeds = {"q1": 2.0, "s": 0.5}
    found = mechanism(
        model,
        q,
        u,
        inertias,
        loads,
        loops,
        driven={"s": -25 * q[3]},
        speed_starts=speeds,
        **options,
    )
    model.energies(found.kinetic_energy, potential)
    work = model.state("work", "J", 0.0, "of the drive")
    model.derivative(work, found.drives[0] * found.speeds[3])
    model.output("gap", "m", ca.norm_2(loops["closure"]), "gap of the loop")
    return model.freeze()


def test_loops_may_move_with_a_driven_coordinate():
    options = {"stop_time": 1.0, "relative_tolerance": 1e-10, "compiled": False}
    runs = [cosim.simulate(shaken(form), **options) for form in ("ode", "multipliers")]
    for run in runs:
        np.testing.assert_allclose(run["s"], 0.1 * np.sin(5 * run.time), rtol=0, atol=1e-8)
        gained = run["energy"] - run["energy"][0]
        assert np.abs(gained).max() > 0.1
        np.testing.assert_allclose(run["work"], gained, rtol=0, atol=1e-6)
        assert run["gap"].max() < 1e-7
    for name in ("q1", "q3", "energy"):
        assert np.abs(runs[0][name] - runs[1][name]).max() < 1e-5


def test_open_chain_is_an_ode():
    model = Model("pendulum")
    q = model.state("q", "rad", 0.0, "angle")
    u = SX.sym("u")
    mechanism(
        model, q, u, [kane.InertialTerm(u, u)], [kane.Load(u, -4 * q)], speed_starts={"q": 2.0}
    )
    run = cosim.simulate(model.freeze(), stop_time=1.0, relative_tolerance=1e-10, compiled=False)
    np.testing.assert_allclose(run["q"], np.sin(2 * run.time), rtol=0, atol=1e-8)
    assert run.units["q_dot"] == "rad/s"


def test_load_of_a_loop_carries_the_weight():
    """Two points of 1 kg, one hanging from the other by a rod; the upper one is held by springs."""
    model = Model("rod")
    q = ca.vertcat(*(model.state(n, "m", s, n) for n, s in (("y1", 0.0), ("y2", -1.0))))
    u = SX.sym("u", 2)
    inertias = [kane.InertialTerm(u[i], u[i]) for i in (0, 1)]
    loads = [kane.Load(u[0], 2 * 9.81 - 9.81), kane.Load(u[1], SX(-9.81))]
    found = mechanism(model, q, u, inertias, loads, {"rod": q[0] - q[1] - 1}, independent=q[0])
    model.output("tension", "N", found.loop_loads[0], "force of the rod")
    run = cosim.simulate(model.freeze(), stop_time=0.1, compiled=False)
    np.testing.assert_allclose(np.abs(run["tension"]), 9.81, rtol=1e-12)
    np.testing.assert_allclose(run["y2"], -1.0, rtol=0, atol=1e-12)


def small(loops=None, inertias=None, **options):
    model = Model("small")
    q = ca.vertcat(*(model.state(n, "m", 0.5, n) for n in "abc"))
    u = SX.sym("u", 3)
    inertias = inertias(q, u) if inertias else [kane.InertialTerm(u, u)]
    if "independent" in options:
        options["independent"] = q[options["independent"]]
    mechanism(model, q, u, inertias, (), loops(q) if loops else None, **options)
    return model.freeze()


@pytest.mark.parametrize(
    ("loops", "named"),
    [
        (lambda q: {"one": q[0] - q[1], "two": 2 * q[0] - 2 * q[1]}, "loop '(one|two)' repeats"),
        (lambda q: {"one": q[0] - 1, "two": q[0] ** 2 - 1}, "loop '(one|two)' repeats"),
        (lambda q: {"both": ca.vertcat(q[0], q[0] + q[1] - q[1])}, "loop 'both_2' repeats"),
        (lambda q: circle_and_line(q, 0.0), "loop 'sum' repeats"),  # the starts are not on them
        (lambda q: circle_and_line(q, 1.0), "loop 'sum' repeats"),
        (lambda q: {"one": q[0] - q[1], "nothing": SX(0)}, "loop 'nothing' repeats"),
    ],
)
def test_loop_that_repeats_another_is_named(loops, named):
    with pytest.raises(ValueError, match=named):
        small(loops)
    with pytest.raises(ValueError, match="repeats others"):  # not a coordinate too many
        small(loops, independent=0)


def circle_and_line(q, offset):
    circle, line = ca.sumsqr(q[:2]) - 1, q[2] - 2 * q[1]
    return {"circle": circle, "line": line, "sum": 2 * circle + line + offset}


@pytest.mark.parametrize(
    ("moving", "told"),
    [
        (lambda model, u: SX.sym("stranger"), "loop 'rod' depends on 'stranger', which is no coor"),
        (lambda model, u: u[0], "loop 'rod' depends on 'u_0', which is no coordinate"),
        (
            lambda model, u: model.input("f", "m", 0.0, "f"),
            r"loop 'rod' depends on 'f', .* rate is not known; let a coordinate of driven",
        ),
        (
            lambda model, u: model.state("s", "m", 0.0, "s"),
            r"loop 'rod' depends on 's', .* rate is not known; let a coordinate of driven",
        ),
    ],
)
def test_loop_of_something_whose_rate_is_not_known_is_refused_by_name(moving, told):
    model, u = Model("rod"), SX.sym("u", 2)
    q = ca.vertcat(model.state("x", "m", 1.0, "x"), model.state("y", "m", 0.0, "y"))
    loops = {"rod": ca.sumsqr(q) - 1 - moving(model, u)}

    def build():
        mechanism(model, q, u, [kane.InertialTerm(u, u)], [], loops)
        model.freeze()

    with pytest.raises(ValueError, match=told):
        build()


def test_momentum_of_something_whose_rate_is_not_known_is_refused_by_name():
    model, u = Model("tank"), SX.sym("u")
    x, mass = model.state("x", "m", 0.0, "place"), model.input("mass", "kg", 1.0, "mass")
    told = "the momentum of inertia 1 depends on 'mass', .* name it in constant="
    with pytest.raises(ValueError, match=told):
        mechanism(model, x, u, [kane.InertialTerm(u, mass * u)])


def test_rocket_s_fuel_takes_its_momentum_along():
    """Tsiolkovsky's equation: the exhaust leaves at 2 m/s."""
    model, u = Model("rocket"), SX.sym("u")
    x, mass = model.state("x", "m", 0.0, "place"), model.state("mass", "kg", 1.0, "mass")
    model.derivative(mass, -0.5)
    loads = [kane.Load(u, 2 * SX(0.5))]
    mechanism(model, x, u, [kane.InertialTerm(u, mass * u)], loads, constant=mass)
    run = cosim.simulate(model.freeze(), stop_time=1.0, relative_tolerance=1e-9, compiled=False)
    assert run["x_dot"][-1] == pytest.approx(2 * np.log(2), abs=1e-7)


# -- what moves with time: a pendulum of changing length, its pivot shaken ------------------------

SHAKE, PACE = 0.1, 7.0  # m, rad/s


def rod_and_pivot(t, m=ca):
    """Return length of the rod and height of its pivot, m."""
    return 1 + 0.1 * m.sin(3 * t), SHAKE * m.cos(PACE * t)


def shaken_pendulum(form: str):
    """Return it in absolute coordinates with a loop, or as an angle whose momenta hold time."""
    model = Model("shaken_pendulum", form, stop_time=1.2)
    g = model.parameter("g", "m/s2", 9.81, "gravity")
    length, height = rod_and_pivot(model.t)
    if form == "angle":
        q, u = model.state("angle", "rad", 0.6, "angle"), SX.sym("u")
        place = ca.vertcat(length * sin(q), height - length * cos(q))
        starts, loops = {"angle": 0.4}, None
    else:
        q = ca.vertcat(model.state("x", "m", 0.6, "x"), model.state("y", "m", -0.7, "y"))
        u, place = SX.sym("u", 2), q
        starts, loops = {"x": 0.4}, {"rod": q[0] ** 2 + (q[1] - height) ** 2 - length**2}
    velocity = ca.jtimes(place, q, u) + ca.jtimes(place, model.t, SX(1))
    inertias = [kane.InertialTerm(velocity, 2 * velocity)]
    options = {"independent": q[0]} if form == "ode" else {}
    loads = [kane.Load(velocity, ca.vertcat(0, -2 * g))]
    mechanism(model, q, u, inertias, loads, loops, speed_starts=starts, **options)
    model.output("across", "m", place[0], "place across")
    model.output("up", "m", place[1], "place up")
    return model.freeze()


def lagrange(times, run):
    """Return across and up, from Lagrange's equation of the angle written down by hand."""

    def rates(t, y):
        length, _ = rod_and_pivot(t, np)
        lifted = 9.81 - SHAKE * PACE**2 * np.cos(PACE * t)
        return y[1], -(0.6 * np.cos(3 * t) * y[1] + lifted * np.sin(y[0])) / length

    length, _ = rod_and_pivot(times[0], np)
    if "angle" in run:
        start = [run["angle"][0], run["angle_dot"][0]]
    else:
        angle = np.arcsin(run["x"][0] / length)
        growth = 0.3 * np.cos(3 * times[0]) * np.sin(angle)
        start = [angle, (run["x_dot"][0] - growth) / (length * np.cos(angle))]
    exact = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-13, "t_eval": times}
    angle = solve_ivp(rates, times[[0, -1]], start, **exact).y[0]
    length, height = rod_and_pivot(times, np)
    return length * np.sin(angle), height - length * np.cos(angle)


@pytest.mark.quick_rows("0.0-angle", "0.7-angle")
@pytest.mark.parametrize("form", ["angle", "ode", "multipliers"])
@pytest.mark.parametrize("begin", [0.0, 0.7])
def test_what_moves_with_time_moves_as_lagrange_says(form, begin):
    dae = shaken_pendulum(form)
    span = {"start_time": begin, "stop_time": begin + 1.2}
    runs = [cosim.simulate(dae, **span, relative_tolerance=1e-9)]  # error measured up to 9e-9
    if form != "angle":
        held = {"drift_control": "projection"}
        runs.append(cosim.simulate(dae, **span, **held, relative_tolerance=1e-12))
        runs.append(cosim.simulate(dae, **span, **held, solver="ode8", step_size=5e-3))
    for run, bound in zip(runs, (5e-8, 1e-10, 1e-11), strict=False):
        across, up = lagrange(run.time, run)
        np.testing.assert_allclose(run["across"], across, rtol=0, atol=bound)
        np.testing.assert_allclose(run["up"], up, rtol=0, atol=bound)


@pytest.mark.slow_rows("ModelExchange")
@pytest.mark.parametrize("interface", ["ModelExchange", "CoSimulation"])
def test_what_moves_with_time_moves_so_in_an_fmu(interface, tmp_path):
    path = cosim.export_fmu(shaken_pendulum("multipliers"), tmp_path / "shaken.fmu")
    span = {"start_time": 0.7, "stop_time": 1.9, "relative_tolerance": 1e-9}
    run = cosim.simulate_fmu(path, interface=interface, **span)
    across, up = lagrange(run.time, run)
    np.testing.assert_allclose(run["across"], across, rtol=0, atol=1e-6)
    np.testing.assert_allclose(run["up"], up, rtol=0, atol=1e-6)


def test_refusals():
    with pytest.raises(ValueError, match="the rate of inertia 1 is not linear in the speeds"):
        small(inertias=lambda q, u: [kane.InertialTerm(u[0] ** 2, u[0])])
    with pytest.raises(ValueError, match="speed of 'd': no such coordinate"):
        small(speed_starts={"d": 1.0})
    with pytest.raises(ValueError, match=r"1 loops for 3 coordinates .* 1 are named"):
        small(lambda q: {"l": q[0] - q[1]}, independent=0)


@pytest.mark.parametrize("size", [4e-7, 1e6])
def test_a_mechanism_of_any_size_has_the_motion_of_that_of_one_meter(size):
    """Slider and crank without loads: what is the unit of length does not count."""

    def slider(length):
        model = Model("slider", stop_time=0.5)
        rod = -np.arcsin(np.sin(1.0) / 2)
        a, b = model.state("a", "rad", 1.0, "crank"), model.state("b", "rad", rod, "rod")
        x = model.state("x", "m", (np.cos(1.0) + 2 * np.cos(rod)) * length, "slider")
        u = SX.sym("u", 3)
        inertias = [
            *(kane.InertialTerm(u[i], length**2 * u[i]) for i in (0, 1)),
            kane.InertialTerm(u[2], u[2]),
        ]
        gap = ca.vertcat(cos(a) + 2 * cos(b) - x / length, sin(a) + 2 * sin(b)) * length
        q = ca.vertcat(a, b, x)
        mechanism(model, q, u, inertias, loops={"rod": gap}, speed_starts={"a": 1.0})
        return cosim.simulate(model.freeze(), compiled=False).final

    usual, found = slider(1.0), slider(size)
    assert found["a"] == pytest.approx(usual["a"], abs=1e-6)
    assert found["x"] / size == pytest.approx(usual["x"], abs=1e-6)
