"""Drift control: constraints that are kept through their derivatives only, and what it does."""

import casadi as ca
import numpy as np
import pytest

import cosim
from casadi_models.dae import Model
from cosim.cli.main import main
from cosim.codegen.initialization import projection_step
from cosim.errors import UnknownName, UsageError
from cosim.integrate.preparation import controllable
from cosim.model.request import DriftControl
from cosim.study.tradeoff.configuration import Selection
from cosim.study.tradeoff.study import tradeoff

MONITORS = ["position_drift", "velocity_drift"]
FREE_BODIES = ("bicycle/multipliers", "double_pendulum/multipliers")
JOINTS = ("crank_shaft/multipliers", "bar_on_frame/two_body", "disk_two_bars/multipliers")


def drift_of(name, **options):
    run = cosim.simulate(cosim.load(name), outputs=MONITORS, stop_time=4.0, **options)
    return np.array([np.abs(run[monitor]).max() for monitor in MONITORS]), run


def circle(nominal=1.0, radius=1.0):
    """A particle that turns about the origin at 1 rad/s; nothing keeps its distance."""
    model = Model("circle", stop_time=10.0)
    x = model.state("x", "m", radius, "place across", nominal=nominal)
    y = model.state("y", "m", 0.0, "place along")
    size = model.parameter("radius", "m", radius, "radius of the circle")
    place = ca.vertcat(x, y)
    model.derivative(place, ca.vertcat(-y, x))
    model.invariant("radius_drift", place, ca.dot(place, place) - size**2, "it stays on the circle")
    return model.freeze()


@pytest.mark.slow
@pytest.mark.parametrize("name", FREE_BODIES)
@pytest.mark.parametrize("rtol", [1e-4, 1e-8])
def test_projection_ends_every_output_on_the_constraints(name, rtol):
    free, _ = drift_of(name, solver="dop853", drift_control="none", relative_tolerance=rtol)
    held, run = drift_of(name, drift_control="projection", relative_tolerance=rtol)
    assert run.stats["solver"] == "dop853"
    assert held.max() < 1e-13  # m, m/s; measured up to 3e-15
    assert free.min() > 1e3 * held.max()


@pytest.mark.slow_rows("disk_two_bars/multipliers")
@pytest.mark.parametrize("name", JOINTS)
def test_constraints_with_constant_coefficients_drift_by_rounding_only(name):
    free, _ = drift_of(name, solver="dop853", drift_control="none", relative_tolerance=1e-4)
    assert free.max() < 2e-11  # measured up to 1.5e-12, the shaft


@pytest.mark.slow
def test_baumgarte_is_the_default_and_less_drifts_without():
    _, own = drift_of("bicycle/multipliers")
    _, damped = drift_of("bicycle/multipliers", drift_control="baumgarte")
    _, none = drift_of("bicycle/multipliers", drift_control="none")
    np.testing.assert_array_equal(own.values, damped.values)
    assert none["position_drift"].max() > own["position_drift"].max()


def gap(rate=2.0):
    """A gap g, open by 1 m and at rest, that closes with a rate in 1/s."""
    model = Model("gap", stop_time=3.0, output_interval=0.1)
    g, g_dot = model.state("g", "m", 1.0, "gap"), model.state("g_dot", "m/s", 0.0, "its rate")
    bend = model.algebraic("bend", "m/s2", 0.0, "its second derivative")
    rate, size = model.closing_rate(rate), model.parameter("size", "1", 1.0, "not used up")
    model.equation(size * (bend + 2 * rate * g_dot + rate**2 * g))
    model.derivative(ca.vertcat(g, g_dot), ca.vertcat(g_dot, bend))
    return model.freeze()


@pytest.mark.parametrize("reduced", [False, True])
@pytest.mark.parametrize("rate", [2.0, 0.5, 0.0])
def test_gap_closes_with_the_rate_that_is_chosen(rate, reduced):
    dae = cosim.reduce(gap(), ["g"], freeze=["size"]) if reduced else gap()
    run = cosim.simulate(dae if rate == dae.closing.rate else dae.closing_at(rate), outputs=["g"])
    exact = (1 + rate * run.time) * np.exp(-rate * run.time)
    np.testing.assert_allclose(run["g"], exact, atol=1e-6)  # measured 1e-7


@pytest.mark.parametrize("rates", [(0.0, 2.0), (2.0, 0.0), (0.5, 2.0)])
def test_gaps_of_coupled_parts_close_each_with_its_rate(rates):
    whole = cosim.couple({"a": gap(rates[0]), "b": gap(rates[1])}, {}).dae
    assert whole.closing.rate == 2
    run = cosim.simulate(whole, outputs=["a.g", "b.g"])
    for name, rate in zip(("a.g", "b.g"), rates, strict=True):
        exact = (1 + rate * run.time) * np.exp(-rate * run.time)
        np.testing.assert_allclose(run[name], exact, atol=1e-6)


@pytest.mark.parametrize("rate", [-1.0, np.nan, np.inf])
def test_closing_rate_that_cannot_be_is_refused(rate):
    with pytest.raises(ValueError, match=r"gap: Baumgarte stabilization rate .* give 0 or more"):
        gap().closing_at(rate)


def test_closing_rate_of_what_closes_by_itself_is_refused():
    with pytest.raises(ValueError, match="crank_shaft/driven: no equation makes drift decay"):
        cosim.load("crank_shaft/driven").closing_at(1.0)


@pytest.mark.slow
@pytest.mark.parametrize("rtol", [1e-5, 1e-8])
def test_projection_leaves_the_order_of_accuracy(rtol):
    truth = cosim.simulate(cosim.load("bicycle/independent"), relative_tolerance=1e-11)
    dae, options = cosim.load("bicycle/multipliers"), {"relative_tolerance": rtol}
    free = cosim.simulate(dae, solver="dop853", drift_control="none", **options)
    held = cosim.simulate(dae, drift_control="projection", **options)
    errors = [np.abs(run["delta"] - truth["delta"]).max() for run in (free, held)]
    assert errors[1] < 2 * errors[0]  # measured 1.0


def test_projection_moves_along_the_shortest_way():
    project, x = projection_step(circle(), 1), ca.DM([3.0, 4.0]) * 0.21
    for _ in range(6):
        x, change = project(0.0, x, [], 1.0)
    np.testing.assert_allclose(x.full().ravel(), [0.6, 0.8], atol=1e-15)  # measured 0
    assert float(change) < 1e-15


def test_projection_moves_states_of_large_nominal_more():
    place = np.array([0.65, 0.85])
    moved, change = projection_step(circle(nominal=10.0), 1)(0.0, place, [], 1.0)
    move = moved.full().ravel() - place
    assert move[0] / move[1] == pytest.approx(100 * 0.65 / 0.85)  # least norm of (x / 10, y)
    assert float(change) == pytest.approx(np.abs(move / [10, 1]).max())


@pytest.mark.quick_rows("ode8")
@pytest.mark.parametrize("solver", ["rk4", "ode8", "dop853"])
def test_particle_stays_on_its_circle(solver):
    options = {"step_size": 0.5} if solver != "dop853" else {"relative_tolerance": 1e-3}
    options |= {"solver": solver, "output_interval": 0.5, "on_invalid": "ignore"}
    dae = circle(radius=2.0)
    free = cosim.simulate(dae, drift_control="none", **options)
    held = cosim.simulate(dae, drift_control="projection", **options)
    assert np.abs(np.hypot(held["x"], held["y"]) - 2).max() < 1e-14  # measured 4e-16
    assert np.abs(np.hypot(free["x"], free["y"]) - 2).max() > 1e-10  # ode8; rk4 5e-3


@pytest.mark.slow
def test_reduced_model_is_projected_like_the_full_one():
    dae = cosim.load("bicycle/multipliers")
    small = cosim.reduce(dae, ["phi", "delta"])
    assert len(small.invariants) == 2
    options = {"stop_time": 4.0, "drift_control": "projection"}
    both = cosim.simulate(dae, **options), cosim.simulate(small, **options)
    assert cosim.compare(*both).worst.scaled < 1e-6  # other steps; measured 1e-7
    assert cosim.reduce(dae, ["phi"], freeze=["w"]).invariants


def test_part_of_an_invariant_is_none():
    dae = cosim.load("crank_shaft/multipliers")
    assert cosim.reduce(dae, ["T"]).invariants == ()


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        (
            "crank_shaft/multipliers",
            {"drift_control": "baumgarte"},
            "has no Baumgarte stabilization rate",
        ),
        ("crank_shaft/driven", {"drift_control": "projection"}, "nothing to project"),
        (FREE_BODIES[0], {"drift_control": "projection", "solver": "idas"}, "idas cannot project"),
        (FREE_BODIES[0], {"drift_control": "projection", "compiled": False}, "compiled"),
        (FREE_BODIES[0], {"drift_control": "none", "accuracy": 1e-4}, "accuracy chooses"),
    ],
)
def test_control_that_cannot_be_is_refused(name, options, message):
    with pytest.raises(UsageError, match=message):
        cosim.simulate(cosim.load(name), **options)


def test_unknown_control_is_refused_with_the_nearest_name():
    with pytest.raises(UnknownName, match="did you mean projection"):
        cosim.simulate(cosim.load("bicycle/multipliers"), drift_control="projektion")


@pytest.mark.slow
def test_command_line_projects(tmp_path):
    file = tmp_path / "run.csv"
    call = [
        "simulate",
        "bicycle/multipliers",
        "--stop-time",
        "1",
        "--outputs",
        "phi,velocity_drift",
    ]
    assert main([*call, "--drift-control", "projection", "--output-file", str(file)]) == 0
    drift = np.loadtxt(file, delimiter=",", skiprows=1)[:, 2]
    assert np.abs(drift).max() < 1e-13


@pytest.mark.slow
def test_tradeoff_measures_what_model_and_solver_can_have():
    selection = Selection(("idas", "dop853"), (1e-6,), (), ("native",), tuple(DriftControl))
    request = cosim.requested("bicycle/multipliers", outputs=["phi"], stop_time=0.5)
    study = tradeoff(request, selection=selection, every_formulation=False, repeats=1)
    full = [m.configuration for m in study.measurements if not m.configuration.reduced]
    assert {(c.solver, c.drift_control) for c in full} == {
        *(("idas", control) for control in ("none", "baumgarte")),
        *(("dop853", control) for control in tuple(DriftControl)),
    }
    assert all(m.error < 1e-4 for m in study.measurements)
    assert ("bicycle/multipliers projection, idas", "do not project their steps") in [
        tuple(row.values()) for row in study.missing()
    ]
    with pytest.raises(UnknownName, match="did you mean projection"):
        Selection(drift_controls=("projections",))


def test_explicit_form_without_constraints_has_nothing_to_measure():
    dae = cosim.load("crank_shaft/driven")
    assert [name for name in tuple(DriftControl) if controllable(dae, name)] == ["none"]


def test_invariant_of_too_many_rows_is_refused():
    model = Model("point")
    x = model.state("x", "m", 0.0, "place")
    with pytest.raises(ValueError, match="2 rows for 1 states"):
        model.invariant("drift", x, ca.vertcat(x, x), "it stays")


def tilted(planes=1):
    """A particle on a great circle of the unit sphere, by invariants that move the same states."""
    model = Model("tilted", stop_time=10.0)
    start = {"x": 0.6, "y": 0.0, "z": 0.8}
    place = ca.vertcat(*(model.state(name, "m", v, name) for name, v in start.items()))
    normal = ca.DM([0.8, 0.0, -0.6])
    model.derivative(place, ca.cross(normal, place))
    model.invariant("sphere", place, ca.dot(place, place) - 1, "it stays on the sphere")
    for k in range(planes):
        skew = ca.dot(normal + place, place) - 1
        model.invariant(f"plane_{k}", place, skew, "it stays in the plane")
    return model.freeze()


@pytest.mark.parametrize("solver", ["dop853", "rk4"])
def test_invariants_that_move_the_same_states_are_kept_at_once(solver):
    dae = tilted()
    steps = {"step_size": 0.1} if solver == "rk4" else {"relative_tolerance": 1e-3}
    run = cosim.simulate(dae, solver=solver, drift_control="projection", **steps)
    x, y, z = (run[name] for name in "xyz")
    assert np.abs(x**2 + y**2 + z**2 - 1).max() < 1e-14
    assert np.abs(0.8 * x - 0.6 * z).max() < 1e-14
    found = np.array(projection_step(dae, 0)(0, [0.61, 0.02, 0.8], [], [])[0]).ravel()
    flat = np.array([[1.22, 0.04, 1.6], [2.02, 0.04, 1.0]])  # slopes of both residuals
    gap = [0.61**2 + 0.02**2 + 0.8**2 - 1, 0.61**2 + 0.02**2 + 0.8**2 + 0.008 - 1]
    np.testing.assert_allclose(found - [0.61, 0.02, 0.8], -np.linalg.pinv(flat) @ gap, atol=1e-15)


@pytest.mark.parametrize("solver", ["dop853", "rk4"])
def test_projection_that_does_not_converge_is_said(solver):
    with pytest.raises(cosim.errors.SolverError, match=r"no projection|step size too small"):
        cosim.simulate(tilted(planes=2), solver=solver, drift_control="projection")


def test_reduced_model_keeps_what_only_an_invariant_needs():
    model = Model("fall", stop_time=2.0)
    h, v = model.state("h", "m", 10.0, "height"), model.state("v", "m/s", 1.0, "speed")
    level = model.parameter("level", "m2/s2", 98.6, "energy per mass at the start")
    model.derivative(h, v)
    model.derivative(v, -9.81)
    model.invariant("loss", v, v**2 / 2 + 9.81 * h - level, "energy stays")
    small = cosim.reduce(model.freeze(), ["h"])
    assert [p.name for p in small.parameters] == ["level"]
    assert len(small.invariants) == 1  # before: 0, and no parameter
