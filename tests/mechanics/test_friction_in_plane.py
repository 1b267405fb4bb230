"""Dry friction in a plane: a block comes to rest at the exact time, stays, and slides again."""

from math import cos, inf, pi, sin, tan

import casadi as ca
import pytest
from helpers.samples import sampled

import cosim
from casadi_models.dae import Model
from casadi_models.mechanics.contact import friction_in_plane

G = 9.81  # m/s2
SOLVERS = pytest.mark.parametrize("solver", ["dop853", "cvodes", "rosenbrock"])


def block(mu, tilt, angle, *, speed=1.0, push=0.0, sticking=None, slow=1e-8, stop_time=1.5):
    """Return a block of 2 kg on a table; it is thrown at an angle to the steepest way down.

    Args:
        mu, sticking: Coefficients of friction (1).
        tilt: Of the table, rad.
        angle: Of the first velocity to the steepest way down, rad.
        speed: m/s.
        push: Growth of a horizontal force, N/s.
        slow: Speed below which the direction of sliding is constant, m/s.
        stop_time: s.
    """
    model = Model("block", stop_time=stop_time)
    place = ca.vertcat(*(model.state(n, "m", 0.0, "place") for n in ("down", "across")))
    v = ca.vertcat(
        model.state("v_down", "m/s", speed * cos(angle), "velocity"),
        model.state("v_across", "m/s", speed * sin(angle), "velocity"),
    )
    m = 2.0
    load = ca.vertcat(m * G * sin(tilt), push * model.t)
    force = friction_in_plane(
        model, v, m * ca.SX.eye(2), v, load, m * G * cos(tilt), mu,
        sticking=sticking, slow_speed=slow,
    )  # fmt: skip
    model.derivative(place, v)
    model.derivative(v, (load + force) / m)
    model.output("force_down", "N", force[0], "friction")
    model.output("force_across", "N", force[1], "friction")
    return model.freeze()


def at_rest(mu, tilt, angle):
    """Return time and place of rest of a block thrown at 1 m/s, in closed form, s and m.

    With the angle psi of the velocity to the way down, s' = a cos psi - mu g' and psi' = -a sin
    psi / s, so s = c tan(psi/2)^p / sin psi with p = mu g'/a; the rest are integrals of powers.
    """
    a = G * sin(tilt)
    p, c = mu / tan(tilt), sin(angle) / tan(angle / 2) ** (mu / tan(tilt))
    u = tan(angle / 2)
    time = c / (2 * a) * (u ** (p - 1) / (p - 1) + u ** (p + 1) / (p + 1))
    down = c**2 / (4 * a) * (u ** (2 * p - 2) / (2 * p - 2) - u ** (2 * p + 2) / (2 * p + 2))
    across = c**2 / (2 * a) * (u ** (2 * p - 1) / (2 * p - 1) + u ** (2 * p + 1) / (2 * p + 1))
    return time, down, across


def times(run, what):
    return [event.time for event in run.events if event.name == f"friction {what}"]


# Measured error of the time: 4e-13 s (dop853), 2e-12 s (others)
@pytest.mark.quick_rows(
    "0.0-0.7-cvodes", "0.0--2.0-cvodes", "0.2-0.0-cvodes", "0.2-3.141592653589793-cvodes"
)
@SOLVERS
@pytest.mark.parametrize(("tilt", "angle"), [(0.0, 0.7), (0.0, -2.0), (0.2, 0.0), (0.2, pi)])
def test_a_block_thrown_straight_stops_at_the_exact_time_and_stays(solver, tilt, angle):
    run = cosim.simulate(block(0.5, tilt, angle), solver=solver, relative_tolerance=1e-10)
    deceleration = 0.5 * G * cos(tilt) - G * sin(tilt) * cos(angle)
    assert times(run, "sticks") == [pytest.approx(1 / deceleration, abs=1e-9)]
    assert run.final["down"] == pytest.approx(cos(angle) / (2 * deceleration), abs=1e-9)
    assert run.final["across"] == pytest.approx(sin(angle) / (2 * deceleration), abs=1e-9)
    late = run.time > 1 / deceleration + 0.01
    assert max(abs(run["v_down"][late]).max(), abs(run["v_across"][late]).max()) == 0
    assert run.final["force_down"] == pytest.approx(-2 * G * sin(tilt), abs=1e-12)


# Measured error of the time: 1e-10 s (dop853), 2e-12 s (rosenbrock), 1e-9 s (cvodes at 1e-10)
@pytest.mark.slow_rows(
    "cvodes-1e-12-0.5-1.2",
    "dop853-1e-10-0.5-1.2",
    "dop853-1e-10-1.5-2.0",
    "rosenbrock-1e-10-0.5-1.2",
)
@pytest.mark.parametrize(
    ("solver", "tolerance", "mu", "angle"),
    [
        ("dop853", 1e-10, 0.5, 1.2),
        ("dop853", 1e-10, 1.5, 2.0),
        ("rosenbrock", 1e-10, 0.5, 1.2),
        ("rosenbrock", 1e-10, 1.5, 2.0),
        ("cvodes", 1e-12, 0.5, 1.2),
        ("cvodes", 1e-12, 1.5, 2.0),
    ],
)
def test_a_block_thrown_across_a_slope_stops_at_the_exact_time_and_stays(
    solver, tolerance, mu, angle
):
    run = cosim.simulate(block(mu, 0.3, angle), solver=solver, relative_tolerance=tolerance)
    time, down, across = at_rest(mu, 0.3, angle)
    assert times(run, "sticks") == [pytest.approx(time, abs=1e-9)]
    assert run.final["down"] == pytest.approx(down, abs=1e-10)
    assert run.final["across"] == pytest.approx(across, abs=1e-10)
    assert run.final["v_down"] == run.final["v_across"] == 0
    assert len(run.events) < 8  # turns by 45 deg, slows down, sticks


@pytest.mark.parametrize(("mu", "angle"), [(0.5, 1.2), (1.5, 2.0)])
def test_an_fmu_sees_the_slow_phase_of_some_nanoseconds_before_the_rest(mu, angle, tmp_path):
    """What rounding makes of a relation is far above it at full speed, and far below it there."""
    file = cosim.export_fmu(block(mu, 0.3, angle), tmp_path / "block.fmu")
    run = cosim.simulate_fmu(file, interface="CoSimulation", relative_tolerance=1e-10)
    time, _, across = at_rest(mu, 0.3, angle)
    assert [event.name.split()[1] for event in run.events][-2:] == ["slows", "sticks"]
    assert times(run, "sticks") == [pytest.approx(time, abs=1e-9)]
    assert run.final["across"] == pytest.approx(across, abs=1e-10)
    assert run.final["v_down"] == run.final["v_across"] == 0


@pytest.mark.quick_rows("0.0025")
@pytest.mark.parametrize("interval", [0.008, 0.005, 0.0025])
def test_the_time_of_rest_depends_on_no_output_interval(interval):
    """A cubic shows the block slow where it is not; at 0.008 s it came to rest 2 ms late."""
    dae = block(0.33, 0.3, 2.0, slow=1e-7, stop_time=2.5)
    for tolerance in (1e-8, 1e-10):
        options = {"relative_tolerance": tolerance, "output_interval": interval}
        run = cosim.simulate(dae, solver="cvodes", **options)
        assert times(run, "sticks") == [pytest.approx(at_rest(0.33, 0.3, 2.0)[0], abs=3e-6)]


@SOLVERS
@pytest.mark.parametrize("tolerance", sampled([1e-4, 1e-6, 1e-8, 1e-10], (), [1e-6]))
@pytest.mark.parametrize(("mu", "angle"), [(0.4, 2.8), (0.33, 2.0), (1.5, 2.0)])
def test_no_tolerance_makes_it_chatter(solver, tolerance, mu, angle):
    dae = block(mu, 0.3, angle, slow=1e-7, stop_time=2.5)
    run = cosim.simulate(dae, solver=solver, relative_tolerance=tolerance)
    time, down, across = at_rest(mu, 0.3, angle)
    (stuck,) = times(run, "sticks")
    assert len(run.events) < 40  # measured 3 to 21
    # 0.33 is close to the slope's 0.309: its speed fades slowly
    assert stuck == pytest.approx(time, abs=3e-6 + 1e3 * tolerance)
    assert run.final["down"] == pytest.approx(down, abs=1e-8 + 10 * tolerance)
    assert run.final["across"] == pytest.approx(across, abs=1e-8 + 10 * tolerance)
    assert run.final["v_down"] == run.final["v_across"] == 0


@pytest.mark.slow_rows("0.5-dop853", "0.5-rosenbrock", "0.6-dop853")
@SOLVERS
@pytest.mark.parametrize("sticking", [0.5, 0.6])
def test_a_push_tears_it_off_where_it_exceeds_the_friction_cone(solver, sticking):
    tilt = 0.2
    dae = block(0.5, tilt, 0.0, speed=0.0, push=10.0, sticking=sticking, stop_time=1.5)
    run = cosim.simulate(dae, solver=solver, relative_tolerance=1e-10)
    weight = 2 * G * sin(tilt)
    torn = ((sticking * 2 * G * cos(tilt)) ** 2 - weight**2) ** 0.5 / 10
    first, *later = times(run, "slides")
    assert first == pytest.approx(torn, abs=1e-9)
    # With equal coefficients, it may stop once more while the push has hardly grown
    assert len(later) < (2 if sticking == 0.5 else 1)
    assert max(later, default=torn) < torn + 1e-3
    assert abs(run["down"][run.time < torn]).max() == 0
    assert run.final["across"] > 0.01
    # Sliding, the force is mu N against the velocity
    last = run.final
    speed = (last["v_down"] ** 2 + last["v_across"] ** 2) ** 0.5
    assert last["force_down"] == pytest.approx(
        -0.5 * 2 * G * cos(tilt) * last["v_down"] / speed, rel=1e-9
    )


@pytest.mark.slow
def test_a_block_that_starts_at_rest_on_a_steep_slope_slides_at_once():
    run = cosim.simulate(block(0.2, 0.3, 0.0, speed=0.0), solver="dop853")
    acceleration = G * (sin(0.3) - 0.2 * cos(0.3))
    assert run.final["down"] == pytest.approx(acceleration * 1.5**2 / 2, rel=1e-12)


def test_the_direction_at_the_start_follows_from_start_values():
    dae = block(0.5, 0.0, 0.0)
    run = cosim.simulate(dae, solver="dop853", start_values={"v_down": -1.0, "v_across": 1e-3})
    speed = (1 + 1e-6) ** 0.5
    assert times(run, "sticks") == [pytest.approx(speed / (0.5 * G), abs=1e-9)]


@pytest.mark.slow
@pytest.mark.parametrize("fmi", [2, 3])
def test_an_fmu_stops_at_the_exact_time(tmp_path, fmi):
    path = cosim.export_fmu(block(0.5, 0.3, 1.2), tmp_path / "x.fmu", solver="dop853", fmi=fmi)
    names = ["down", "across", "v_down", "v_across"]
    run = cosim.simulate_fmu(
        path, interface="CoSimulation", outputs=names, relative_tolerance=1e-10
    )
    _, down, across = at_rest(0.5, 0.3, 1.2)
    assert run["down"][-1] == pytest.approx(down, abs=1e-10)  # measured 1e-14
    assert run["across"][-1] == pytest.approx(across, abs=1e-10)
    assert run["v_down"][-1] == run["v_across"][-1] == 0


def test_a_mass_matrix_of_the_wrong_shape_is_rejected():
    model = Model("block")
    v = model.state("v", "m/s", 0.0, "speed")
    with pytest.raises(ValueError, match=r"1 speeds, but a mass matrix of shape \(2, 2\)"):
        friction_in_plane(model, v, ca.SX.eye(2), v, 0, 1, inf)


@pytest.mark.parametrize("scale", [1.0, 1e-9])
def test_tiny_forces_move_a_tiny_block_as_large_ones_a_large_block(scale):
    model = Model("block", stop_time=2.0)
    v = model.state("v", "m/s", 0.0, "velocity")
    load = scale * model.t  # N
    force = friction_in_plane(model, v, ca.SX(scale), v, load, scale, 0.5)
    model.derivative(v, (load + force) / scale)
    run = cosim.simulate(model.freeze())
    assert times(run, "slides") == pytest.approx([0.5], abs=1e-9)
    assert run.final["v"] == pytest.approx(1.5**2 / 2, abs=1e-7)  # measured 7e-9
