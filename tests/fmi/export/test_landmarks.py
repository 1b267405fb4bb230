"""An FMU names the places where a term of one state changes: no importer steps over them."""

import casadi as ca
import fmpy
import numpy as np
import pytest
from casadi import SX
from fmpy.fmi2 import FMU2Slave

import cosim
from casadi_models.dae.inner_terms import inner_terms
from cosim.codegen.landmarks import landmarks
from cosim.model.inputs import InputSeries

SPEED, HEIGHT, PLACE, WIDTH = 10.0, 0.05, 50.3, 1e-3  # m/s, m
INTERFACES = ["CoSimulation", "ModelExchange"]


def on_road(road, kind=SX, **values):
    """Return a mass on a spring and a damper over a road that parameters describe."""
    t, x, p = kind.sym("t"), kind.sym("x", 3), [kind.sym(name) for name in values]
    ode = ca.vertcat(SPEED, x[2], -25 * (x[1] - road(x[0], *p)) - x[2])
    laws = {"t": t, "x": x, "ode": ode} | ({"p": ca.vertcat(*p)} if p else {})
    return cosim.from_casadi(laws, values, name="road", stop_time=7, output_interval=0.5)


def gauss(s, place, width):
    return HEIGHT * ca.exp(-(((s - place) / width) ** 2))


def two_slopes(s, begin, end):
    return HEIGHT / 2 * (ca.tanh((s - begin) / WIDTH) - ca.tanh((s - end) / WIDTH))


def product(s, place, other):
    return HEIGHT * ca.exp(-(((s - place) / WIDTH) ** 2) - ((s - other) / WIDTH) ** 2)


def after_an_impulse(area, place=PLACE):
    """Return the height at 7 s after a narrow bump, from the response to an impulse."""
    t, w = 7 - place / SPEED, np.sqrt(25 - 0.25)
    return 25 * area / SPEED * np.exp(-t / 2) * np.sin(w * t) / w


def heights(path, **options):
    return [cosim.simulate_fmu(path, interface=i, **options)["x_2"][-1] for i in INTERFACES]


@pytest.mark.slow_rows("2")
@pytest.mark.parametrize("fmi", [2, 3])
def test_no_importer_steps_over_a_bump_that_parameters_move(fmi, tmp_path):
    dae = on_road(gauss, place=PLACE, width=WIDTH)
    path = cosim.export_fmu(dae, tmp_path / "x.fmu", fmi=fmi)
    area = HEIGHT * np.sqrt(np.pi)
    np.testing.assert_allclose(heights(path), after_an_impulse(area * WIDTH), rtol=1e-3)
    moved = heights(path, start_values={"place": 33.3, "width": 1e-2})
    np.testing.assert_allclose(moved, after_an_impulse(area * 1e-2, 33.3), rtol=1e-3)  # before: 0


@pytest.mark.parametrize("solver", ["rk4", "ode8"])
def test_fixed_steps_end_at_a_bump(solver, tmp_path):
    """Its width is a 500th of a step; native fixed steps only say that they pass over it."""
    dae = on_road(gauss, place=PLACE, width=WIDTH)
    path = cosim.export_fmu(dae, tmp_path / "x.fmu", solver=solver, step_size=0.05)
    run = cosim.simulate_fmu(path, interface="CoSimulation")
    right = after_an_impulse(HEIGHT * np.sqrt(np.pi) * WIDTH)
    assert run["x_2"][-1] == pytest.approx(right, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["linear", "bspline"])
def test_no_importer_steps_over_a_bump_of_a_table(kind, tmp_path):
    knots = np.linspace(0, 200, 2001)
    rows = np.where((knots > 50.25) & (knots < 50.35), HEIGHT, 0.0)  # one knot: a hat
    table = ca.interpolant("table", kind, [knots], rows)
    path = cosim.export_fmu(on_road(table, ca.MX), tmp_path / "x.fmu")
    np.testing.assert_allclose(heights(path), after_an_impulse(HEIGHT * 0.1), rtol=1e-3)


def test_no_importer_steps_over_a_bump_beyond_a_million_of_its_unit(tmp_path):
    t, x = SX.sym("t"), SX.sym("x", 3)
    bump = HEIGHT * ca.exp(-((x[0] - 5.03e7) ** 2) / 1e8)  # which begins at 0
    ode = ca.vertcat(1e7, x[2], -25 * (x[1] - bump) - x[2])
    dae = cosim.from_casadi({"t": t, "x": x, "ode": ode}, {}, name="far", stop_time=7)
    path = cosim.export_fmu(dae, tmp_path / "x.fmu")
    right = after_an_impulse(HEIGHT * np.sqrt(np.pi) * 1e-2)
    np.testing.assert_allclose(heights(path), right, rtol=1e-3)  # before: 0


@pytest.mark.slow
def test_two_opposite_slopes_of_one_state_are_a_bump(tmp_path):
    dae = on_road(two_slopes, begin=PLACE, end=PLACE + 3 * WIDTH)
    path = cosim.export_fmu(dae, tmp_path / "x.fmu")
    middle = PLACE + 1.5 * WIDTH
    right = after_an_impulse(HEIGHT * 3 * WIDTH, middle)
    np.testing.assert_allclose(heights(path), right, rtol=1e-3)


def test_a_place_follows_a_parameter_that_is_tuned_in_a_run(tmp_path):
    dae = on_road(gauss, place=PLACE, width=WIDTH)
    path = str(cosim.export_fmu(dae, tmp_path / "x.fmu", tunable=["place"]))
    description = fmpy.read_model_description(path)
    numbers = {v.name: v.valueReference for v in description.modelVariables}
    unzipped = fmpy.extract(path)
    area = HEIGHT * WIDTH * np.sqrt(np.pi)
    for place, right in (
        (45.3, after_an_impulse(area, 45.3)),
        (60.3, after_an_impulse(area, 60.3)),
        (30.0, after_an_impulse(area / 2, 30.0)),  # where it is: half of it is ahead
        (20.3, 0.0),  # behind
    ):
        fmu = FMU2Slave(
            guid=description.guid,
            unzipDirectory=unzipped,
            modelIdentifier=description.coSimulation.modelIdentifier,
        )
        fmu.instantiate()
        fmu.setupExperiment(startTime=0, stopTime=7)
        fmu.enterInitializationMode()
        fmu.exitInitializationMode()
        for k in range(14):
            if k == 6:
                fmu.setReal([numbers["place"]], [place])
            fmu.doStep(currentCommunicationPoint=k / 2, communicationStepSize=0.5)
        (height,) = fmu.getReal([numbers["x_2"]])
        assert abs(height - right) <= 1e-3 * abs(right)
        fmu.terminate()
        fmu.freeInstance()


def on_hill(form, place=PLACE, width=WIDTH):
    """Return a mass on a spring and a damper that moves over a hill along its diagonal."""
    t, x, p = SX.sym("t"), SX.sym("x", 4), SX.sym("p", 2)
    hill = HEIGHT * form((x[0] - p[0]) / p[1], (x[3] - p[0]) / p[1])
    ode = ca.vertcat(SPEED, x[2], -25 * (x[1] - hill) - x[2], SPEED)
    laws = {"t": t, "x": x, "ode": ode, "p": p}
    start = {"p_1": place, "p_2": width}
    return cosim.from_casadi(laws, start, name="hill", stop_time=7, output_interval=0.5)


@pytest.mark.slow
def test_no_importer_steps_over_a_hill_of_two_states(tmp_path):
    dae = on_hill(lambda c, d: ca.exp(-(c**2 + d**2)))
    area = np.sqrt(np.pi / 2)  # of a slice along the diagonal
    path = cosim.export_fmu(dae, tmp_path / "x.fmu")
    right = after_an_impulse(HEIGHT * WIDTH * area)
    np.testing.assert_allclose(heights(path), right, rtol=2e-3)  # before: 0
    moved = heights(path, start_values={"p_1": 33.3, "p_2": 1e-2})
    right = after_an_impulse(HEIGHT * 1e-2 * area, 33.3)
    np.testing.assert_allclose(moved, right, rtol=2e-3)
    np.testing.assert_allclose(
        cosim.simulate(dae, start_values={"p_1": 33.3, "p_2": 1e-2})["x_2"][-1], right, rtol=2e-3
    )
    many = cosim.simulate_many(dae, {"p_1": [33.3, 50.3], "p_2": [1e-2, 1e-2]})
    np.testing.assert_allclose(many["x_2"][0, -1], right, rtol=2e-3)


ALONG = np.sqrt(np.pi)  # area of exp(-c**2)
ACROSS = {  # both are c on the diagonal: the form, with the area of a slice along it
    "ridge": (lambda c, d: ca.exp(-((3 * c - 2 * d) ** 2)), ALONG),
    "ridge by a quotient": (lambda c, d: 1 / (1 + (3 * c - 2 * d) ** 2) ** 3, 3 * np.pi / 8),
    "hill by a quotient": (lambda c, d: 1 / (1 + (c**2 + d**2) / 2) ** 3, 3 * np.pi / 8),
    "hill by a slope": (lambda c, d: (1 + ca.tanh(4 - 2 * (c**2 + d**2))) / 2, 1.98595443),
}


@pytest.mark.parametrize("shape", ACROSS)
@pytest.mark.slow_rows("ridge", "ridge by a quotient")
def test_nothing_steps_over_ridges_and_quotients_of_two_states(shape, tmp_path):
    form, area = ACROSS[shape]
    dae = on_hill(form)
    path = cosim.export_fmu(dae, tmp_path / "x.fmu")
    moved, area = {"p_1": 33.3, "p_2": 1e-2}, HEIGHT * area
    right = after_an_impulse(area * 1e-2, 33.3)
    np.testing.assert_allclose(heights(path), after_an_impulse(area * WIDTH), rtol=2e-3)
    np.testing.assert_allclose(heights(path, start_values=moved), right, rtol=2e-3)  # before: 0
    for solver in ("dop853", "cvodes"):
        run = cosim.simulate(dae, start_values=moved, solver=solver)
        assert run["x_2"][-1] == pytest.approx(right, rel=2e-3)  # before: 0 for quotients
    many = cosim.simulate_many(dae, {name: [value, value] for name, value in moved.items()})
    assert many["x_2"][0, -1] == pytest.approx(right, rel=2e-3)  # before: 0 for ridges


def on_lift(role):
    """Return a mass on a spring that a bump of an input or an unknown lifts, or starts a clock."""
    model = cosim.Model(role, stop_time=7.0, output_interval=0.5)
    s = model.state("s", "m", 0.0, "way")
    y, v = model.state("x_2", "m", 0.0, "height"), model.state("v", "m/s", 0.0, "speed")
    model.derivative(s, SPEED)
    if role == "input":
        moving = model.input("lift", "m", 0.0, "way")
    else:
        moving = model.algebraic("lift", "m", 0.0, "way")
        model.equation(moving + 1e-9 * moving**3 - s - 1e-9 * s**3)
    bump = gauss(moving, PLACE, WIDTH)
    model.derivative(y, v)
    if role == "condition":
        hits = model.discrete("hits", "1", 0, "hits")
        model.when(bump > HEIGHT / 2, {hits: hits + 1})
        bump = hits
    model.derivative(v, -25 * (y - bump) - v)
    return model.freeze()


@pytest.mark.slow_rows("unknown", "input")
@pytest.mark.parametrize("role", ["input", "unknown", "condition"])
def test_nothing_steps_over_a_bump_of_inputs_and_unknowns_or_in_conditions(role, tmp_path):
    path = cosim.export_fmu(on_lift(role), tmp_path / "x.fmu")
    ramp = InputSeries(("lift",), [0.0, 7.0], [[0.0], [70.0]]) if role == "input" else None
    right = after_an_impulse(HEIGHT * WIDTH * np.sqrt(np.pi))
    if role == "condition":
        t, w = 7 - PLACE / SPEED, np.sqrt(25 - 0.25)
        right = 1 - np.exp(-t / 2) * (np.cos(w * t) + np.sin(w * t) / (2 * w))
    np.testing.assert_allclose(heights(path, inputs=ramp), right, rtol=2e-3)  # before: 0


def test_a_ring_has_places_along_its_radius():
    dae = on_hill(lambda c, d: ca.exp(-((ca.sqrt(c**2 + d**2) - 3) ** 2)))
    found = landmarks(dae)
    assert (found.moving, found.passed) == (("x_1, x_4", "x_1", "x_4"), ())
    both = [
        a for a in ca.vertsplit(found.arguments) if all(ca.depends_on(a, dae.x[i]) for i in (0, 3))
    ]
    radii = ca.Function("radii", [dae.x, dae.p], [ca.vertcat(*both)])(
        [PLACE, 0, 0, PLACE], [50.3, 1]
    )
    np.testing.assert_allclose(np.median(np.array(radii)), -3, atol=0.2)


QUADRATICS = {  # of which both variables are c on the diagonal, with the area of a slice along it
    "along no state": (lambda c, d: (c + d) ** 2 + (c - 2 * d) ** 2, np.sqrt(np.pi / 5)),
    "multiplied out": (lambda c, d: c * c - 2 * c * d + 3 * d * d, np.sqrt(np.pi / 2)),
}


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("kind", QUADRATICS)
@pytest.mark.quick_share(0.5)
def test_no_importer_steps_over_the_peak_of_a_quadratic(kind, fmi, tmp_path):
    form, area = QUADRATICS[kind]
    dae = on_hill(lambda c, d: ca.exp(-form(c, d)))
    path = cosim.export_fmu(dae, tmp_path / "x.fmu", fmi=fmi)
    for place, width in ((PLACE, WIDTH), (33.3, 1e-2)):
        right = after_an_impulse(HEIGHT * width * area, place)
        found = heights(path, start_values={"p_1": place, "p_2": width})
        np.testing.assert_allclose(found, right, rtol=2e-3)  # before: 0


def test_a_hill_along_no_state_is_exported_with_a_warning():
    dae = on_hill(lambda c, d: ca.exp(-((c + d) ** 4) - (c - 2 * d) ** 4))
    assert landmarks(dae).arguments.numel() == 0
    assert landmarks(dae).passed == ("x_1, x_4",)


def test_plane_friction_is_not_looked_at():
    v = SX.sym("v", 2)
    dae = cosim.from_casadi({"x": v, "ode": -v / ca.sqrt(ca.sumsqr(v) + 1e-6)})
    assert (landmarks(dae).arguments.numel(), landmarks(dae).passed) == (0, ())


@pytest.mark.parametrize(
    "form", [lambda c, d: ca.tanh(c - d), lambda c, d: ca.exp(WIDTH * (c - d))]
)
def test_slopes_of_two_states_have_no_places(form):
    found = landmarks(on_hill(form))
    assert (found.arguments.numel(), found.passed) == (0, ())


@pytest.mark.slow
def test_an_fmu_warns_of_a_parameter_that_no_place_follows(tmp_path):
    dae = on_road(product, place=PLACE, other=PLACE)
    path, said = cosim.export_fmu(dae, tmp_path / "x.fmu"), []
    for start in ({}, {"other": PLACE + WIDTH}):
        said.clear()
        fmpy.simulate_fmu(
            path, start_values=start, debug_logging=True, logger=lambda *m: said.append(m[-1])
        )
        assert any(b"other moves a short change" in text for text in said) == bool(start)
        run = cosim.simulate_fmu(path, interface="ModelExchange", start_values=start)
        said_so = "other moves a short change" in run.stats.get("note", "")
        assert said_so == bool(start)  # before: nothing


@pytest.mark.parametrize(
    "force",
    [
        lambda v: ca.tanh(v / 0.01),  # a step over it sees other values before and after
        lambda v: ca.tanh(v / 0.01) * (1 + 0.5 * ca.exp(-((v / 0.1) ** 2))),  # Stribeck
        lambda v: 1 / (v - 0.5) ** 2,  # a pole is no bump
        lambda v: 1 / (1.5 + ca.cos(v)),  # it rests nowhere
        lambda v: ca.exp(v),
        lambda v: ca.sqrt(v),
        lambda v: v**3,
    ],
)
def test_terms_that_steps_see_have_no_places(force):
    x, v = SX.sym("x"), SX.sym("v")
    ode = ca.vertcat(v, -9 * x - force(v))
    dae = cosim.from_casadi({"x": ca.vertcat(x, v), "ode": ode}, {"x": 1.0})
    assert landmarks(dae).arguments.numel() == 0


def test_slopes_of_different_sums_of_the_same_quantities_have_no_places():
    x, y, u = SX.sym("x"), SX.sym("y"), SX.sym("u")
    ode = ca.vertcat(ca.tanh(x - y + 2 * u) - x, ca.tanh(2 * x + y - u) - y)
    dae = cosim.from_casadi({"x": ca.vertcat(x, y), "u": u, "ode": ode})
    assert landmarks(dae).arguments.numel() == 0


def test_one_slope_in_two_equations_has_no_places():
    x, v, w = SX.sym("x"), SX.sym("v"), SX.sym("w")
    friction = ca.tanh(v / 0.01)
    ode = ca.vertcat(v, -9 * x - 2 * friction, 3 * friction)
    dae = cosim.from_casadi({"x": ca.vertcat(x, v, w), "ode": ode})
    assert landmarks(dae).arguments.numel() == 0


def test_a_function_with_two_arguments_and_two_results_has_no_places():
    a, b = SX.sym("a"), SX.sym("b")
    both = ca.Function("both", [a, b], [ca.exp(-(a**2)) * b, a], {"never_inline": True})
    x = SX.sym("x", 2)
    ode = ca.vertcat(both(x[0], 2)[0], both(x[1], 3)[1])
    dae = cosim.from_casadi({"x": x, "ode": ode})
    assert landmarks(dae).arguments.numel() == 0


def test_a_term_is_a_function_of_what_parameters_shift():
    dae = on_road(two_slopes, begin=PLACE, end=PLACE)
    found = inner_terms(dae)
    assert [term.movers for term in found] == [(0,), (0,)]
    assert not any(term.given for term in found)
    (height, *_) = inner_terms(on_road(product, place=PLACE, other=PLACE))
    assert height.given == (0, 1)


def test_a_model_with_too_many_places_is_exported_with_a_warning():
    x, y = SX.sym("x"), SX.sym("y")
    bumps = sum(ca.exp(-(((x - 3 * k) * 100) ** 2)) for k in range(40))
    dae = cosim.from_casadi({"x": ca.vertcat(x, y), "ode": ca.vertcat(1, bumps)})
    assert landmarks(dae).passed == (dae.states[0].name,)


def test_a_pulse_of_time_after_the_default_stop_time_is_met(tmp_path):
    t, x = SX.sym("t"), SX.sym("x")
    ode = ca.exp(-(((t - 15.3) / WIDTH) ** 2)) / WIDTH
    dae = cosim.from_casadi({"t": t, "x": x, "ode": ode}, name="late", stop_time=10)
    path = cosim.export_fmu(dae, tmp_path / "late.fmu")
    for interface in INTERFACES:
        run = cosim.simulate_fmu(path, interface=interface, stop_time=20, output_interval=2)
        assert run["x"][-1] == pytest.approx(np.sqrt(np.pi), rel=1e-6)  # 0 before


@pytest.mark.slow
def test_the_compiled_master_sees_no_hill_before_it_is_there(tmp_path):
    """Stages of the interpolant of a step before a hill may lie in it."""
    model = cosim.Model("hills", stop_time=20.0, output_interval=0.1)
    x, y = model.state("x", "m", 0.0, "way"), model.state("y", "m", 0.0, "other way")
    z, w = model.state("z", "m", 0.0, "height"), model.state("w", "m/s", 0.0, "speed")
    places = [50.3, 57.3]
    hills = (ca.exp(-(((x - c) / 0.01) ** 2) - (y - c / 10) ** 2) for c in places)
    model.derivative(x, ca.SX(10))
    model.derivative(y, ca.SX(1))
    model.derivative(z, w)
    model.derivative(w, 1000 * sum(hills) - 4 * z - w)
    path = cosim.export_fmu(model.freeze(), tmp_path / "hills.fmu")
    run = cosim.simulate_fmu(path, interface="ModelExchange", master="c")
    t, own = run.time, np.sqrt(4 - 0.25)
    after = [(t - c / 10).clip(min=0) for c in places]
    right = sum(np.sqrt(np.pi) / own * np.exp(-s / 2) * np.sin(own * s) for s in after)
    np.testing.assert_allclose(run["z"], right, atol=5e-3)  # before: off by 2.3


@pytest.mark.slow
def test_a_rough_road_is_exported_with_a_warning(tmp_path):
    knots = np.arange(0, 80, 0.02)
    heights = np.random.default_rng(0).normal(0, 0.02, len(knots))
    road = ca.interpolant("road", "linear", [knots], heights)
    s, y = ca.MX.sym("s"), ca.MX.sym("y")
    ode = ca.vertcat(10, road(s) - y)
    dae = cosim.from_casadi({"x": ca.vertcat(s, y), "ode": ode}, name="rough", stop_time=7)
    with pytest.warns(UserWarning, match="fixed steps, may step over some"):
        cosim.export_fmu(dae, tmp_path / "rough.fmu", solver="rk4", step_size=0.01)


def with_slopes(s, place, width):
    """Return a bump with its slope and curvature, each as a length."""
    bump = gauss(s, place, width)
    slope = ca.gradient(bump, s)
    return bump + width * slope / ca.sqrt(1 + slope**2) + width**2 * ca.gradient(slope, s)


def test_slopes_of_a_bump_share_its_places():
    every = []
    for road in (gauss, with_slopes):
        dae = on_road(road, place=PLACE, width=WIDTH)
        rows = landmarks(dae).arguments
        lines = [rows, ca.jacobian(rows, dae.x[0])]
        value, slope = ca.Function("lines", [dae.x, dae.p], lines)(np.zeros(3), [PLACE, WIDTH])
        every.append(np.sort(np.array(-value / slope).ravel()))
    own, shared = every
    assert len(own) <= len(shared) < 3 * len(own)  # before: 4.3 times as many
    assert shared[0] <= own[0]
    assert shared[-1] >= own[-1]
    assert np.diff(shared).max() <= 2 * np.diff(own).max()


WAVES = {  # of an angle: the form, with the starts of its parameters
    "cam": lambda a, k, place: ca.exp(k * (ca.cos(a - place) - 1)),
    "crank": lambda a, k, place: ca.exp(-k * (ca.sin(a) - ca.sin(place)) ** 2),
}


@pytest.mark.slow
@pytest.mark.parametrize("shape", WAVES)
def test_no_importer_steps_over_what_repeats_in_each_turn(shape, tmp_path):
    a, y, p = SX.sym("a"), SX.sym("y"), SX.sym("p", 2)
    laws = {"x": ca.vertcat(a, y), "ode": ca.vertcat(5, WAVES[shape](a, p[0], p[1]) - y), "p": p}
    starts = {"p_1": 1e5, "p_2": 0.4}
    dae = cosim.from_casadi(laws, starts, name="turns", stop_time=7, output_interval=0.5)
    path = cosim.export_fmu(dae, tmp_path / "x.fmu")
    for k, place in ((1e5, 0.4), (1e4, 0.9)):
        at = np.array([place] if shape == "cam" else [place, np.pi - place])
        slope = 1.0 if shape == "cam" else np.sqrt(2) * np.cos(place)
        times = (at[:, None] + 2 * np.pi * np.arange(6)) / 5
        pushes = np.where(times < 7, np.exp(np.minimum(times, 7) - 7), 0)
        right = np.sqrt(2 * np.pi / k) / slope / 5 * pushes.sum()
        values = {"p_1": k, "p_2": place}
        runs = [
            cosim.simulate_fmu(path, interface=i, start_values=values)["y"][-1] for i in INTERFACES
        ]
        np.testing.assert_allclose(runs, right, rtol=1e-3)  # before: 0
        many = cosim.simulate_many(dae, {"p_1": [k, k], "p_2": place})["y"][:, -1]
        np.testing.assert_allclose(many, right, rtol=1e-3)  # of the crank, before: 0


@pytest.mark.slow
def test_no_importer_steps_over_a_table_whose_argument_is_limited(tmp_path):
    knots = np.linspace(-1, 1, 401)
    rows = HEIGHT * np.exp(-((knots / 0.02) ** 2))
    table = ca.interpolant("table", "linear", [knots], rows)
    dae = on_road(lambda s, place: table(ca.fmin(ca.fmax(s - place, -1), 1)), ca.MX, place=PLACE)
    path = cosim.export_fmu(dae, tmp_path / "x.fmu")
    for place in (PLACE, 33.3):
        right = after_an_impulse(np.trapezoid(rows, knots), place)
        moved = heights(path, start_values={"place": place})
        np.testing.assert_allclose(moved, right, rtol=1e-2)  # before: 0


@pytest.mark.slow
def test_a_table_of_time_that_mostly_rests_at_zero_is_no_law_of_proportion(tmp_path):
    knots = np.linspace(0, 10, 501)
    table = ca.interpolant("table", "linear", [knots], 1.0 * (np.arange(501) == 166))
    t, y = ca.MX.sym("t"), ca.MX.sym("y")
    laws = {"t": t, "x": y, "ode": table(t) - 0.2 * y}
    dae = cosim.from_casadi(laws, name="hat", stop_time=7, output_interval=0.5)
    path = cosim.export_fmu(dae, tmp_path / "x.fmu")
    right = 0.02 * np.exp(-0.2 * (7 - knots[166]))
    for interface in INTERFACES:  # before: an error in co-simulation
        run = cosim.simulate_fmu(path, interface=interface)
        np.testing.assert_allclose(run["y"][-1], right, rtol=1e-4)


@pytest.mark.slow
def test_an_export_names_what_an_importer_may_step_over(tmp_path):
    knots, x = np.linspace(0, 100, 11), ca.MX.sym("x", 3)
    table = ca.interpolant("ground", "linear", [knots, knots], np.zeros(121))
    laws = {"x": x, "ode": ca.vertcat(1, 2, table(x[:2]))}
    with pytest.warns(UserWarning, match="terms of x_1, x_2 change in places"):  # before: none
        cosim.export_fmu(cosim.from_casadi(laws, name="ground", stop_time=1), tmp_path / "x.fmu")
    t, y = SX.sym("t"), SX.sym("y")
    laws = {"t": t, "x": y, "ode": ca.exp(-(((t - 5.3) / 1e-17) ** 2))}
    with pytest.warns(UserWarning, match="terms of time change in places"):  # before: none
        cosim.export_fmu(cosim.from_casadi(laws, name="brief", stop_time=7), tmp_path / "y.fmu")


def test_the_places_of_a_table_of_an_input_are_named(tmp_path):
    u, v = ca.MX.sym("u"), ca.MX.sym("v")
    knots = [-20, PLACE - WIDTH, PLACE, PLACE + WIDTH, 99]
    road = ca.interpolant("road", "linear", [knots], [0, 0, 1 / WIDTH, 0, 0])
    dae = cosim.from_casadi({"x": v, "u": u, "ode": road(u)}, name="table")
    assert landmarks(dae).moving == ("u",)
    path = cosim.export_fmu(dae, tmp_path / "table.fmu")  # before: with a warning
    for interface in INTERFACES:
        run = cosim.simulate_fmu(path, stop_time=70, inputs={"u": "t"}, interface=interface)
        assert run.final["v"] == pytest.approx(1, abs=1e-6)  # before, in model exchange: 0


def test_an_fmu_with_a_change_of_an_input_watches_its_limit(tmp_path):
    """Both parts of the runtime name what moves; compilers took the names for one."""
    model = cosim.Model("watched", stop_time=1.0, output_interval=0.1)
    x, u = model.state("x", "1", 0.0, "state"), model.input("u", "1", 0.0, "input")
    model.derivative(x, 2 + ca.exp(-(((u - 0.5) / 1e-3) ** 2)))
    model.limit(1 - x * x, "x is small")
    path = cosim.export_fmu(model.freeze(), tmp_path / "x.fmu")
    run = cosim.simulate_fmu(path, interface="CoSimulation")
    assert "from 0.5 s" in str(run.stats["invalid"])
