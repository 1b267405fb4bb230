"""Events against closed forms, on every solver."""

import casadi as ca
import numpy as np
import pytest
from helpers import event_models
from helpers.event_models import FIXED, SOLVERS, simulate
from helpers.samples import sampled
from scipy.integrate import quad
from scipy.optimize import brentq

import cosim
from casadi_models.dae import Model
from cosim.errors import SolverError
from cosim.integrate import location

G = 9.81


def ball():
    model = Model("ball", stop_time=2.55, output_interval=0.01)
    h = model.state("h", "m", 1.0, "height")
    v = model.state("v", "m/s", 0.0, "speed")
    e = model.parameter("e", "1", 0.7, "restitution")
    model.derivative(h, v)
    model.derivative(v, -G)
    model.when(h < 0, {v: -e * v}, name="impact")
    return model, h, v


def impact_times(n, e=0.7):
    first = np.sqrt(2 / G)
    return first + np.concatenate(([0.0], np.cumsum(2 * first * e ** np.arange(1, n))))


def block(force):
    """Return a block of 1 kg on a table with dry friction of 0.5 N."""
    model = Model("block", stop_time=10.0)
    x = model.state("x", "m", 0.0, "place")
    v = model.state("v", "m/s", 0.0, "speed")
    model.derivative(x, v)
    model.derivative(v, force(model.t) - 0.5 * ca.sign(v))
    return model.freeze()


BALL_ERRORS = {
    "dop853": 1e-12,
    "ode8": 1e-12,
    "rk4": 1e-12,
    "erk": 1e-8,
    "rosenbrock": 1e-8,
    "cvodes": 3e-6,
    "cvodes_adams": 3e-6,
    "idas": 3e-6,
}


@pytest.mark.quick_share(0.3)
@pytest.mark.slow_rows("ode8", "erk", "rosenbrock")
@pytest.mark.parametrize("solver", SOLVERS)
def test_impacts_of_a_ball_happen_at_their_closed_form(solver):
    exact = impact_times(30)
    run = simulate(ball()[0].freeze(), solver, stop_time=float(exact[29] + 1e-6))
    times = [event.time for event in run.events]
    assert len(times) == 30
    np.testing.assert_allclose(times, exact, rtol=0, atol=BALL_ERRORS[solver])
    assert run["h"].min() >= -1e-9
    assert all(event.name == "impact" for event in run.events)
    first = run.events[0]
    assert first.after["v"] == pytest.approx(-0.7 * first.before["v"], rel=1e-14)


@pytest.mark.quick_rows("ode8")
@pytest.mark.parametrize("solver", ["dop853", "rk4", "ode8"])
def test_compiled_solvers_go_through_impacts_in_one_call(solver, monkeypatch):
    model, _, v = ball()
    count = model.discrete("count", "1", 0, "number of fast impacts")
    model.when(v > 0.5, {count: count + 1}, name="fast")  # an impact causes it
    calls, scaled_call = [], location.scaled_call
    monkeypatch.setattr(
        location, "scaled_call", lambda *a, **k: calls.append(a) or scaled_call(*a, **k)
    )
    run = simulate(model.freeze(), solver)
    times = [event.time for event in run.events if event.name == "impact"]
    np.testing.assert_allclose(times, impact_times(len(times)), rtol=0, atol=1e-12)
    speeds = G * impact_times(1) * 0.7 ** np.arange(1, len(times) + 1)
    fast = int(np.sum(speeds > 0.5))
    assert [e.time for e in run.events if e.name == "fast"] == times[:fast]
    assert run.final["count"] == fast
    steps = np.searchsorted(times[:fast], run.time, "right")
    np.testing.assert_array_equal(run["count"], steps)
    assert len(calls) == (2 if solver in FIXED else 1)  # fixed steps are checked by smaller ones


@pytest.mark.slow_rows("dop853")
@pytest.mark.parametrize("solver", ["dop853", "cvodes"])
def test_events_are_recorded_with_both_sides(solver):
    model, h, v = ball()
    model.output("energy", "J", v**2 / 2 + G * h, "energy of 1 kg")
    dae = model.freeze()
    run = simulate(dae, solver, stop_time=1.5)
    recorded = simulate(dae, solver, stop_time=1.5, record_events=True)
    assert len(run.events) == 2
    assert len(recorded) == len(run) + 4
    assert recorded.with_events() is recorded
    for event in run.events:
        rows = np.flatnonzero(recorded.time == event.time)
        np.testing.assert_array_equal(np.diff(rows), 1)
        before, after = recorded["energy"][rows]
        assert after == pytest.approx(0.49 * before, rel=1e-9)
        assert [event.before["energy"], event.after["energy"]] == [before, after]
    assert len(recorded.at([0.1, 1.4])) == 2  # another run, without rows of events
    lines = run.plot("v").axes[0].lines[0]
    assert len(lines.get_xdata()) == len(recorded)  # a jump is drawn as a jump


@pytest.mark.slow_rows("cvodes")
@pytest.mark.parametrize("solver", ["dop853", "rk4", "cvodes"])
def test_impacts_without_end_are_reported(solver):
    with pytest.raises(SolverError, match=r"'impact' happens ever faster before 2\.558.* \(Zeno\)"):
        simulate(ball()[0].freeze(), solver, stop_time=3.0)


@pytest.mark.slow
def test_sampled_stop_ends_the_impacts():
    """A controller looks every 0.1 s whether the ball is slow, and a stop ends the run."""
    model, h, v = ball()
    slow = model.discrete("slow", "1", 0.0, "1 once the ball is slow")
    model.every(0.1, {slow: ca.if_else(v * v + 2 * G * h < 0.2, 1, 0)}, name="look")
    model.stop(slow > 0.5, "the ball is slow")
    run = simulate(model.freeze(), stop_time=3.0)
    exact = impact_times(30)
    speeds = G * exact[0] * 0.7 ** np.arange(1, 31)
    quiet = exact[np.argmax(speeds**2 < 0.2)]
    assert run.time[-1] == pytest.approx(np.ceil(quiet * 10) / 10, rel=1e-14)
    assert "the ball is slow" in run.stats.stop
    assert run.status == "complete"


def sliding_block():
    """Return a block whose dry friction rises within 1 mm/s before it comes to rest."""
    model = Model("slide", stop_time=2.0)
    v = model.state("v", "m/s", 5.0, "speed")
    model.derivative(v, cosim.contact.friction(v, G, 0.4, sticking=0.6))
    return model.freeze()


def sliding_time(speed=5.0):
    """Return how long the block slides from a speed on."""

    def slowness(v):
        return 1 / (G * (0.4 + 0.2 * np.exp(-((v / 1e-3) ** 2))))

    points = [v for v in (1e-3, 3e-3, 6e-3) if v < speed] or None
    return quad(slowness, 0, speed, points=points, limit=500, epsabs=1e-15)[0]


@pytest.mark.slow_rows("dop853", "erk", "rosenbrock")
@pytest.mark.parametrize("solver", [s for s in SOLVERS if s not in FIXED])
def test_friction_that_rises_just_before_the_rest_is_not_stepped_over(solver):
    run = simulate(sliding_block(), solver)
    assert run.events[0].time == pytest.approx(sliding_time(), abs=1e-9)  # measured 1e-10, cvodes
    assert np.abs(run["v"][run.time > 1.3]).max() < 1e-14


def test_fmu_does_not_step_over_friction_that_rises_just_before_the_rest(tmp_path):
    path = cosim.export_fmu(sliding_block(), tmp_path / "x.fmu")
    options = {"output_interval": 1e-3, "relative_tolerance": 1e-9}
    run = cosim.simulate_fmu(path, interface="CoSimulation", **options)
    last = int(np.searchsorted(run.time, sliding_time())) - 1
    ahead = sliding_time() - run.time[last]
    speed = brentq(lambda v: sliding_time(v) - ahead, 0, 0.1, xtol=1e-12)
    assert run["v"][last] == pytest.approx(speed, abs=1e-8)
    assert np.abs(run["v"][run.time > 1.3]).max() < 1e-14


@pytest.mark.quick_share(0.3)
@pytest.mark.slow_rows("dop853", "ode8")
@pytest.mark.parametrize("solver", SOLVERS)
def test_outputs_are_those_of_the_mode_of_their_time(solver):
    model = Model("turn", stop_time=2.0)
    v = model.state("v", "m/s", -0.955, "speed")
    model.derivative(v, ca.if_else(v > 0, 1, 2))  # v reaches 0 at 0.4775 s
    model.output("side", "1", ca.if_else(v > 0, 1, -1), "the relation of the equations")
    model.output("a", "m/s2", ca.if_else(v > 0, 1, 2), "dv/dt")
    run = simulate(model.freeze(), solver)
    after = run.time > 0.4775
    np.testing.assert_array_equal(run["side"], np.where(after, 1.0, -1.0))
    np.testing.assert_array_equal(run["a"], np.where(after, 1.0, 2.0))
    np.testing.assert_allclose(np.gradient(run["v"], run.time)[60:-1], 1.0, atol=1e-6)


@pytest.mark.parametrize("solver", ["idas", "rosenbrock", "dop853"])
def test_algebraic_unknowns_are_those_of_the_mode_of_their_time(solver):
    model = Model("turn", stop_time=2.0)
    v = model.state("v", "m/s", -0.955, "speed")
    z = model.algebraic("z", "m/s2", 1.0, "dv/dt")
    model.derivative(v, z)
    model.equation(z + 0.1 * z**3 - ca.if_else(v > 0, 1.1, 2.8))  # z is 2, then 1
    model.output("twice", "m/s2", 2 * z, "twice z")
    run = simulate(model.freeze(), solver)
    exact = np.where(run.time > 0.4775, 1.0, 2.0)
    np.testing.assert_allclose(run["z"], exact, rtol=0, atol=1e-8)
    np.testing.assert_allclose(run["twice"], 2 * exact, rtol=0, atol=1e-8)


@pytest.mark.quick_rows("cvodes", "cvodes_adams", "idas")
@pytest.mark.parametrize("solver", SOLVERS)
def test_block_comes_to_rest_and_stays(solver):
    model = Model("block", stop_time=3.0)
    x = model.state("x", "m", 0.0, "place")
    v = model.state("v", "m/s", 1.0, "speed")
    model.derivative(x, v)
    model.derivative(v, -0.7 * ca.sign(v))
    run = simulate(model.freeze(), solver)
    assert len(run.events) == 1
    assert run.events[0].time == pytest.approx(1 / 0.7, abs=1e-9)
    assert run.final["x"] == pytest.approx(1 / 1.4, abs=3e-9)
    assert abs(run["v"][run.time > 1.43]).max() < 1e-15


@pytest.mark.quick_rows("cvodes")
@pytest.mark.parametrize("solver", ["dop853", "cvodes", "rk4"])
def test_block_sticks_and_slips_under_a_periodic_force(solver):
    """It slips while |sin t| exceeds 0.5 and until the impulse is used up."""
    run = simulate(block(ca.sin), solver)
    begin = np.pi / 6

    def speed(t, t0, sign):
        return np.cos(t0) - np.cos(t) - sign * 0.5 * (t - t0)

    first = brentq(lambda t: speed(t, begin, 1), 3, 4.5)
    assert np.sin(first) < -0.5  # it slips backwards at once
    second = brentq(lambda t: speed(t, first, -1), first + 1, first + 4)
    times = [event.time for event in run.events[:3]]
    np.testing.assert_allclose(
        times, [begin, first, second], atol=1e-6 if solver == "cvodes" else 3e-9
    )


@pytest.mark.quick_share(0.3)
@pytest.mark.slow_rows("erk", "rosenbrock")
@pytest.mark.parametrize("solver", SOLVERS)
def test_relation_of_time_is_met_exactly(solver):
    """1000 N for 1 ms on 1 kg at a spring: the response is in closed form."""
    model = Model("pulse", stop_time=10.0)
    x = model.state("x", "m", 0.0, "place")
    v = model.state("v", "m/s", 0.0, "speed")
    model.derivative(x, v)
    on = ca.logic_and(model.t > 5, model.t < 5.001)
    model.derivative(v, ca.if_else(on, 1000, 0) - x)
    run = simulate(model.freeze(), solver)
    exact = 1000 * (np.cos(10 - 5.001) - np.cos(10 - 5))
    error = 1e-6 if solver in ("cvodes", "cvodes_adams", "idas") else 1e-8
    assert run.final["x"] == pytest.approx(exact, abs=error)
    assert [event.time for event in run.events] == [5.0, 5.001]


def random_pulses(count, solver):
    """Return how many of some pulses of 1 N s on 1 kg a solver sees."""
    model = Model("pulse", stop_time=10.0, output_interval=0.5)
    v = model.state("v", "m/s", 0.0, "speed")
    begin = model.parameter("begin", "s", 1.0, "begin")
    length = model.parameter("length", "s", 1.0, "length")
    on = ca.logic_and(model.t >= begin, model.t < begin + length)
    model.derivative(v, ca.if_else(on, 1 / length, 0))
    dae, seen = model.freeze(), 0
    random = np.random.default_rng(1)
    for width in 10 ** random.uniform(-9, 0, count):
        values = {"begin": random.uniform(0, 9), "length": width}
        final = simulate(dae, solver, start_values=values, outputs=["v"]).final["v"]
        # the length of a nanosecond is known to 1e-7 only, where the time is 10 s
        seen += abs(final - 1) < 1e-8 + 4e-15 / width
    return seen


@pytest.mark.quick_share(0.3)
@pytest.mark.slow_rows("dop853", "erk", "rosenbrock")
@pytest.mark.parametrize("solver", SOLVERS)
def test_no_pulse_is_missed(solver):
    assert random_pulses(10, solver) == 10


@pytest.mark.parametrize("solver", sampled(SOLVERS, (), ["cvodes", "dop853"]))
def test_none_of_a_thousand_pulses_is_missed(solver):
    assert random_pulses(1000, solver) == 1000


@pytest.mark.slow_rows("dop853", "erk", "rosenbrock")
@pytest.mark.parametrize("solver", SOLVERS)
def test_maximum_switches_where_the_arguments_meet(solver):
    model = Model("half_waves", stop_time=4 * np.pi)
    x = model.state("x", "1", 0.0, "integral")
    model.derivative(x, ca.fmax(0, ca.sin(model.t)))
    error = 1e-7 if solver in ("cvodes", "cvodes_adams", "idas") else 1e-9
    assert simulate(model.freeze(), solver).final["x"] == pytest.approx(4, abs=error)


@pytest.mark.quick_rows("fmax-rk4", "fmax-cvodes", "fmax-cvodes_adams", "fmax-idas")
@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("form", ["fmax", "if_else", "power"])
def test_branch_ends_where_its_law_is_not_defined(form, solver):
    run = simulate(event_models.draining(form), solver)
    bound = 2e-5 if solver in FIXED else 1e-7  # the slope is infinite there; measured 7e-6, 2e-9
    assert run.final["x"] == pytest.approx(event_models.DRAINED, abs=bound)


def test_law_that_is_left_without_a_value_is_an_error():
    model = Model("beyond", stop_time=2.0)
    x = model.state("x", "1", 1.0, "a state")
    model.derivative(x, -1 - ca.sqrt(ca.fabs(x) - 0.5))
    with pytest.raises(SolverError, match=r"beyond: \w+ stopped after 0.34 s"):
        simulate(model.freeze())


@pytest.mark.slow
def test_square_wave_faster_than_the_output_interval():
    model = Model("square", stop_time=1.25, output_interval=1.0)
    x = model.state("x", "1", 0.0, "integral")
    model.derivative(x, ca.if_else(ca.sin(20 * np.pi * model.t) > 0, 1, -1))
    run = simulate(model.freeze(), "erk")
    assert run.final["x"] == pytest.approx(0.05, abs=1e-12)
    assert len(run.events) == 25


@pytest.mark.slow
def test_bicycle_at_rest_feels_a_torque_that_begins_later():
    """The case that the default solver did not see."""
    torque = {"steer_torque": "where(t > 3, where(t < 4, 1, 0), 0)"}
    runs = [
        cosim.simulate("bicycle", start_values={"phi_dot": 0}, inputs=torque, solver=solver)
        for solver in (None, "dop853", "idas")
    ]
    for run in runs:
        assert abs(run["phi"]).max() == pytest.approx(0.41143530, abs=1e-7)
        assert [event.time for event in run.events] == [3.0, 4.0]


def test_two_crossings_within_an_output_interval_are_seen():
    """The height is above the edge for 1 % of the interval."""
    model = Model("dip", stop_time=2.0, output_interval=1.0)
    x = model.state("x", "m", 0.0, "place")
    n = model.discrete("n", "1", 0.0, "crossings")
    model.derivative(x, ca.cos(np.pi * model.t) * np.pi)  # sin(pi t): its top is at 0.5 s
    model.when(x > 0.9999, {n: n + 1}, name="over")
    run = simulate(model.freeze())
    assert run.final["n"] == 1
    assert run.events[0].time == pytest.approx(np.arcsin(0.9999) / np.pi, abs=1e-9)


@pytest.mark.parametrize("by_model", [True, False])
def test_smooth_relations_are_no_events(by_model):
    Model("another").state("x", "m", -1.0, "place")
    model = Model("smooth", stop_time=2.0)
    x = model.state("x", "m", -1.0, "place")
    model.derivative(x, 1)
    y = model.state("y", "m", 0.0, "integral")
    smooth = model.smooth if by_model else cosim.smooth
    model.derivative(y, smooth(ca.fmax(x, 0) ** 4))
    run = simulate(model.freeze())
    assert run.events == ()
    assert run.final["y"] == pytest.approx(0.2, abs=1e-9)


def test_smooth_needs_the_symbols_of_a_model():
    with pytest.raises(ValueError, match="no model has declared all of 'stranger'"):
        cosim.smooth(ca.fabs(ca.SX.sym("stranger")))


@pytest.mark.slow
def test_relations_in_a_dae_are_located_on_its_unknowns():
    """The force in a spring-loaded contact is an algebraic unknown."""
    model = Model("contact", stop_time=5.0)
    x, v = model.state("x", "m", 1.0, "place"), model.state("v", "m/s", 0.0, "speed")
    force = model.algebraic("force", "N", 0.0, "contact force")
    model.derivative(x, v)
    model.derivative(v, force - 1)
    model.equation(force - ca.fmax(0, -100 * x))
    runs = [simulate(model.freeze(), solver) for solver in ("dop853", "idas", "rosenbrock")]
    first = np.sqrt(2)
    for run in runs:
        times = [event.time for event in run.events]
        assert times[0] == pytest.approx(first, abs=1e-7)
        energy = run["v"] ** 2 / 2 + run["x"] + 50 * np.minimum(run["x"], 0) ** 2
        np.testing.assert_allclose(energy, 1, atol=3e-7)


@pytest.mark.slow
def test_blocks_that_stick_to_each_other_move_as_one():
    model = Model("blocks", stop_time=3.0)
    x, v = model.state("x", "m", 0.0, "lower place"), model.state("v", "m/s", 1.0, "lower speed")
    w = model.state("w", "m/s", 0.0, "upper speed")
    between = 2.0 * ca.sign(v - w)
    model.derivative(x, v)
    model.derivative(v, -between - 0.5 * ca.sign(v))
    model.derivative(w, between)
    run = simulate(model.freeze())
    together = 1 / 4.5  # v = 1 - 2.5 t, w = 2 t
    speed = 2 * together
    assert run.events[0].time == pytest.approx(together, abs=1e-12)
    rest = together + speed / 0.25
    assert run.events[1].time == pytest.approx(rest, abs=1e-11)
    assert abs(run["v"] - run["w"])[run.time > together].max() < 1e-14
    assert abs(run["v"][run.time > rest]).max() < 1e-14


def test_assignment_off_the_constraints_is_rejected():
    model = Model("pendulum", stop_time=2.0)
    x, y = model.state("x", "m", 1.0, "x"), model.state("y", "m", 0.0, "y")
    u, v = model.state("u", "m/s", 0.0, "u"), model.state("v", "m/s", 0.0, "v")
    tension = model.algebraic("tension", "1", 0.0, "tension")
    for state, rate in ((x, u), (y, v), (u, -tension * x), (v, -tension * y - G)):
        model.derivative(state, rate)
    model.equation(u**2 + v**2 - tension * (x**2 + y**2) - G * y)
    model.invariant("drift", ca.vertcat(x, y), x**2 + y**2 - 1, "the length is 1")
    model.when(model.t > 1, {x: 2 * x}, name="break")
    with pytest.raises(SolverError, match="'break' at 1 s leaves states that violate: the length"):
        simulate(model.freeze())


@pytest.mark.slow
def test_jump_of_an_input_series_meets_the_events_of_the_model():
    model = Model("driven", stop_time=2.0)
    x, u = model.state("x", "m", 0.0, "place"), model.input("u", "m/s", 0.0, "speed")
    model.derivative(x, ca.fmax(u, 0))
    series = cosim.InputSeries(
        ("u",), [0, 0.5, 0.5, 1.0, 1.0, 2.0], [[-1], [-1], [2], [2], [-1], [1]]
    )
    for solver in ("dop853", "cvodes", "rk4"):
        run = simulate(model.freeze(), solver, inputs=series)
        assert run.final["x"] == pytest.approx(1.0 + 0.25, abs=1e-8)
        assert run.events[-1].time == pytest.approx(1.5, abs=1e-9)


@pytest.mark.slow
def test_forward_derivatives_jump_at_events():
    """Impacts, a switching time that is a parameter, and friction that comes to rest."""
    model, *_ = ball()
    w = model.parameter("w", "s", 0.3, "when a wind begins")
    x, u = model.state("x", "m", 0.0, "place"), model.state("u", "m/s", 1.0, "speed")
    mu = model.parameter("mu", "1", 0.7, "friction")
    model.derivative(x, u)
    model.derivative(u, -mu * ca.sign(u) + ca.if_else(model.t > w, 0.1, 0))
    dae = model.freeze()
    names, by = ["h", "v", "x", "u"], ["e", "w", "mu"]
    options = {"stop_time": 2.3, "output_interval": 0.1}
    found = cosim.sensitivity(
        dae, outputs=names, with_respect_to=by, relative_tolerance=1e-10, **options
    )
    base = {"e": 0.7, "w": 0.3, "mu": 0.7}
    for name in by:
        step = 1e-5
        ends = [
            simulate(dae, tolerance=1e-12, start_values={name: base[name] + side * step}, **options)
            for side in (1, -1)
        ]
        for output in names:
            slope = (ends[0].final[output] - ends[1].final[output]) / (2 * step)
            assert found[output, name][-1] == pytest.approx(slope, rel=1e-6, abs=1e-6)


def test_reduction_keeps_events_that_outputs_depend_on():
    model, h, _ = ball()
    n = model.discrete("n", "1", 0.0, "number")
    model.when(h > 2, {n: n + 1}, name="high")
    small = cosim.reduce(model.freeze(), ["h"])
    assert [event.name for event in small.events] == ["impact"]
    assert [v.name for v in small.states] == ["h", "v"]
    assert any(line.startswith("events: high") for line in small.report)
    plain = simulate(model.freeze(), stop_time=2.0)
    np.testing.assert_allclose(simulate(small, stop_time=2.0)["h"], plain["h"], atol=1e-12)


@pytest.mark.quick_rows("cvodes")
@pytest.mark.parametrize("solver", ["cvodes", "dop853", "rk4"])
def test_jumps_of_a_python_function_are_located(solver):
    model = Model("mass", stop_time=2.0)
    v, force = model.state("v", "m/s", 0.0, "speed"), model.input("f", "N", 0.0, "force")
    model.derivative(v, force)

    def kick(t):
        return 2.0 if 0.5037 < t < 1.2541 else np.tanh(50 * (t - 1))  # steep, but no jump

    run = simulate(model.freeze(), solver, inputs={"f": kick})
    ends = [np.log(np.cosh(50 * (t - 1))) / 50 for t in (0, 0.5037, 1.2541, 2)]
    exact = ends[1] - ends[0] + 2 * (1.2541 - 0.5037) + ends[3] - ends[2]
    assert run.final["v"] == pytest.approx(exact, abs=1e-9)
