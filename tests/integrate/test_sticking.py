"""What dry friction does at rest, by any law of friction; impacts that die out; rare samples."""

import casadi as ca
import numpy as np
import pytest
from helpers.samples import sampled

import cosim
from cosim.errors import CosimError, SolverError

SOLVERS = ("cvodes", "dop853", "idas", "rosenbrock")


def block(law, load, speed=1.0):
    """A block of 1 kg under a load, with a friction force as an output."""
    model = cosim.Model("block", stop_time=6.0, output_interval=0.01)
    v = model.state("v", "m/s", speed, "speed")
    force = load(model.t)
    model.derivative(v, force - law(v))
    model.output("friction", "N", law(v), "friction force")
    model.output("a", "m/s2", force - law(v), "acceleration")
    return model.freeze()


LAWS = {
    "sign": ca.sign,
    "sides": lambda v: ca.if_else(v > 0, 1 + 0.1 * v, -1 + 0.1 * v),
    "three sides": lambda v: ca.if_else(v > 0, 1.0, ca.if_else(v < 0, -1.0, 0.0)),
    "stribeck": lambda v: ca.sign(v) * (0.8 + 0.3 * ca.exp(-ca.fabs(v) / 0.1)),
    "viscous": lambda v: ca.sign(v) * (1 + 0.1 * ca.fabs(v)),
    "quotient": lambda v: v / ca.fabs(v),
}


@pytest.mark.quick_share(0.3)
@pytest.mark.quick_rows(
    "sign-idas",
    "sign-ModelExchange",
    "sides-idas",
    "three sides-idas",
    "three sides-ModelExchange",
    "stribeck-idas",
    "viscous-idas",
    "quotient-idas",
)
@pytest.mark.parametrize("backend", [*SOLVERS, "CoSimulation", "ModelExchange"])
@pytest.mark.parametrize("law", LAWS)
def test_friction_at_rest_equals_the_load(law, backend, tmp_path):
    mean = 0.7 if law == "three sides" else 0.1  # which has no side between load and no load
    dae = block(LAWS[law], lambda t: mean + 0.4 * ca.sin(t) - 0.2)
    if backend in SOLVERS:
        run = cosim.simulate(dae, solver=backend)
    else:
        run = cosim.simulate_fmu(cosim.export_fmu(dae, tmp_path / "b.fmu"), interface=backend)
    rests = np.abs(run["v"]) < 1e-10
    assert rests[run.time > 4].all()
    load = mean + 0.4 * np.sin(run.time[rests]) - 0.2
    np.testing.assert_allclose(run["friction"][rests], load, rtol=0, atol=1e-9)
    np.testing.assert_allclose(run["a"][rests], 0, rtol=0, atol=1e-9)


@pytest.mark.quick_rows("0.4-dop853")
@pytest.mark.parametrize(
    "solver", ["cvodes", "cvodes_adams", "idas", "erk", "rosenbrock", "dop853"]
)
@pytest.mark.parametrize("restitution", [0.1, 0.4])
def test_impacts_that_die_out_end_the_run(restitution, solver):
    """Bounces smaller than the solver's error are none of which it could fall through."""
    model = cosim.Model("ball", stop_time=2.5)
    h, v = model.state("h", "m", 1.0, "height"), model.state("v", "m/s", 0.0, "speed")
    model.derivative(h, v)
    model.derivative(v, -9.81)
    model.when(h < 0, {v: -restitution * v}, name="impact")
    last = np.sqrt(2 / 9.81) * (1 + restitution) / (1 - restitution)
    for tolerance in (1e-6, 1e-8, 1e-10):
        with pytest.raises(SolverError, match="Zeno") as caught:
            cosim.simulate(model.freeze(), solver=solver, relative_tolerance=tolerance)
        assert caught.value.partial.time[-1] == pytest.approx(last, abs=0.02)
        assert caught.value.partial["h"].min() > -1e-9


@pytest.mark.slow
@pytest.mark.parametrize("period", [2.0, 60.0, 1e6])
def test_the_sample_at_the_start_is_taken_however_rare_samples_are(period, tmp_path):
    model = cosim.Model("counter", stop_time=2.5 * period, output_interval=period / 2)
    count = model.discrete("count", "1", 0.0, "samples")
    model.every(period, {count: count + 1}, name="sample")
    dae = model.freeze()
    file = cosim.export_fmu(dae, tmp_path / "counter.fmu")
    runs = [cosim.simulate(dae), cosim.simulate(dae, solver="dop853"), cosim.simulate_fmu(file)]
    for run in runs:
        np.testing.assert_array_equal(run["count"], [1, 1, 2, 2, 3, 3])


@pytest.mark.quick_rows("ModelExchange")
@pytest.mark.parametrize("backend", ["cvodes", "dop853", "CoSimulation", "ModelExchange"])
def test_two_events_do_not_give_one_variable_two_values(backend, tmp_path):
    model = cosim.Model("two", stop_time=2.0)
    d = model.discrete("d", "1", 0.0, "value")
    model.when(model.t > 1, {d: 2 * d + 1}, name="first")
    model.when(2 * model.t > 2, {d: d + 10}, name="second")
    dae = model.freeze()
    file = cosim.export_fmu(dae, tmp_path / "two.fmu")
    run, ways = cosim.simulate, {"solver": backend}
    if backend not in SOLVERS:
        dae, run, ways = file, cosim.simulate_fmu, {"interface": backend}
    with pytest.raises(CosimError, match=r"'first' and 'second' give d different values at 1 s"):
        run(dae, **ways)


@pytest.mark.slow
@pytest.mark.parametrize("solver", SOLVERS)
def test_events_within_rounding_of_the_end_do_not_stop_a_run(solver):
    model = cosim.Model("timer", stop_time=1.0)
    x, count = model.state("x", "s", 0.0, "since the last"), model.discrete("n", "1", 0.0, "number")
    period = model.parameter("T", "s", 0.5, "time between two")
    model.derivative(x, 1 + 0 * x)
    model.when(x > period, {x: 0.0, count: count + 1}, name="reset")
    dae = model.freeze()
    for length in (0.5, 0.25, 0.2, 0.1, 0.05, 1 / 3, 0.125, 1.0, 0.3, 0.7, 0.15, 1 / 7):
        for stop in (1.0, 2.0, 3.0):
            values = {"T": length}
            run = cosim.simulate(dae, solver=solver, start_values=values, stop_time=stop)
            assert run.final["n"] * length + run.final["x"] == pytest.approx(stop, abs=1e-6)


def ran(dae, backend, folder, **inputs):
    if backend in (*SOLVERS, "erk", "rk4"):
        return cosim.simulate(dae, solver=backend, **inputs)
    interface, *fmi = backend.split()
    file = cosim.export_fmu(dae, folder / "m.fmu", fmi=int(fmi[0]) if fmi else 2)
    return cosim.simulate_fmu(file, interface=interface, master="fmpy", **inputs)


EVERY = [*SOLVERS, "erk", "rk4", "CoSimulation", "ModelExchange"]


@pytest.mark.slow_rows("cvodes", "ModelExchange")
@pytest.mark.parametrize("backend", sampled(EVERY, ["cvodes", "dop853", "ModelExchange"]))
def test_play_follows_its_pin_though_the_solver_drifts_from_it(backend, tmp_path):
    """The pin sin(t) moves the slot by its edges, 0.3 away on both sides."""
    model = cosim.Model("play", stop_time=10.0)
    w, u, du = model.state("w", "1", 0.0, "slot"), ca.sin(model.t), ca.cos(model.t)
    right, left = (ca.logic_and(s * (u - w) >= 0.3, s * du > 0) for s in (1, -1))
    model.derivative(w, ca.if_else(ca.logic_or(right, left), du, 0))
    run = ran(model.freeze(), backend, tmp_path)
    exact = np.sin(run.time) - 0.3  # pushed to the right at first
    turned = run.time > 1.5 * np.pi
    assert run.final["w"] == pytest.approx(np.sin(10.0) + 0.3, abs=1e-6)
    assert np.abs(run["w"] - exact)[(run.time > 0.4) & (run.time < np.pi / 2)].max() < 1e-6
    assert run["w"][turned].min() == pytest.approx(-0.7, abs=1e-6)
    meets, turns = [np.arcsin(0.3), np.pi - np.arcsin(0.4)], [np.pi / 2, 3 * np.pi / 2]
    times = [meets[0], turns[0], meets[1], turns[1], *(np.pi + meets[1], 5 * np.pi / 2)]
    times.append(2 * np.pi + meets[1])
    found = np.unique(np.round([event.time for event in run.events], 5))
    np.testing.assert_allclose(found, times, rtol=0, atol=2e-5)


@pytest.mark.slow_rows("cvodes", "dop853")
@pytest.mark.parametrize("backend", sampled(EVERY, ["cvodes", "dop853", "CoSimulation"]))
def test_friction_of_three_sides_follows_a_load_that_changes_its_sign(backend, tmp_path):
    dae = block(LAWS["three sides"], lambda t: 0.4 * ca.sin(t) - 0.1)
    run = ran(dae, backend, tmp_path)
    rests = run.time > 1.2
    assert np.abs(run["v"][rests]).max() < 1e-12
    load = 0.4 * np.sin(run.time[rests]) - 0.1
    np.testing.assert_allclose(run["friction"][rests], load, rtol=0, atol=1e-9)
    assert len(run.events) <= 3  # it stops, and the load passes 0


def belt():
    """A block of 1 kg in oil on a belt whose speed is an input."""
    model = cosim.Model("belt", stop_time=3.0, output_interval=0.01)
    u, v = model.input("u", "m/s", 1.0, "belt speed"), model.state("v", "m/s", 0.0, "speed")
    model.derivative(v, -2 * ca.sign(v - u) - 0.5 * v)
    model.output("friction", "N", -2 * ca.sign(v - u), "friction force")
    return model.freeze()


FEW = ["cvodes", "dop853", "CoSimulation 3"]
BELTS = sampled([*SOLVERS, "erk", "rk4", "CoSimulation 2", "CoSimulation 3"], FEW)


@pytest.mark.slow_rows("cvodes", "dop853", "CoSimulation 3", "ModelExchange 2")
@pytest.mark.parametrize("backend", [*BELTS, "ModelExchange 2", "ModelExchange 3"])
def test_a_block_slides_when_the_belt_that_it_rests_on_jumps(backend, tmp_path):
    """It rests again when 4 - 3 exp(-t/2) = 2, 2 ln(3/2) after the jump."""
    speed = cosim.InputSeries(("u",), [0, 1.5, 1.5, 3], [[1], [1], [2], [2]])
    run = ran(belt(), backend, tmp_path, inputs=speed)
    after = run.time - 1.5
    right = np.where(after < 0, run["v"], np.minimum(4 - 3 * np.exp(-after / 2), 2.0))
    np.testing.assert_allclose(run["v"], right, rtol=0, atol=1e-6)
    slides = (after > 0.005) & (after < 2 * np.log(1.5))
    np.testing.assert_allclose(run["friction"][slides], 2.0, rtol=0, atol=1e-9)


@pytest.mark.slow_rows("cvodes-series", "dop853-series")
@pytest.mark.parametrize("kind", sampled(["series", "formula", "function"], ["series"]))
@pytest.mark.parametrize("backend", BELTS)
def test_a_block_at_rest_on_a_belt_follows_it(backend, kind, tmp_path):
    speed = {
        "series": cosim.InputSeries(("u",), [0, 1.5, 2.5, 3], [[1], [1], [2], [2]]),
        "formula": {"u": "where(t < 1.5, 1, where(t < 2.5, t - 0.5, 2))"},
        "function": {"u": lambda t: 1 + np.clip(t - 1.5, 0, 1)},
    }[kind]
    run = ran(belt(), backend, tmp_path, inputs=speed)
    rests = run.time > 1
    moving = np.clip(run.time - 1.5, 0, 1)[rests]
    np.testing.assert_allclose(run["v"][rests], 1 + moving, rtol=0, atol=1e-9)
    inside = (moving > 0.005) & (moving < 0.995)
    np.testing.assert_allclose(run["friction"][rests][inside], 1.5 + moving[inside] / 2, atol=1e-9)


@pytest.mark.parametrize("fmi", [2, 3])
def test_model_exchange_refuses_an_input_that_moves_what_rests_on_it(fmi, tmp_path):
    file = cosim.export_fmu(belt(), tmp_path / "belt.fmu", fmi=fmi)
    speed = {"u": "where(t < 1.5, 1, t - 0.5)"}
    with pytest.raises(CosimError, match=r"an input moves 'sign of \(v-u\)'.*co-simulation"):
        cosim.simulate_fmu(file, interface="ModelExchange", inputs=speed)


@pytest.mark.slow_rows("dop853")
@pytest.mark.parametrize(
    "backend", sampled(["idas", "rosenbrock", "dop853", "CoSimulation"], ["idas", "dop853"])
)
def test_friction_of_a_speed_that_an_equation_gives_stops_it(backend, tmp_path):
    """The speed at the contact is 1.5 v; 21 exp(-t/10) - 20 = 0 at 10 ln(1.05)."""
    model = cosim.Model("wheel", stop_time=2.0, output_interval=0.01)
    v, z = model.state("v", "m/s", 1.0, "speed"), model.algebraic("z", "m/s", 0.5, "half of it")
    model.derivative(v, -2 * ca.sign(v + z) - 0.1 * v)
    model.equation(z - 0.5 * v)
    run = ran(model.freeze(), backend, tmp_path)
    assert [event.time for event in run.events] == pytest.approx([10 * np.log(1.05)], abs=1e-7)
    assert np.abs(run["v"][run.time > 0.5]).max() < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["cvodes", "dop853"])
def test_a_series_of_many_samples_costs_no_restarts_where_nothing_slides_along_it(solver):
    """A mass on a spring over a rough road, with a stop that it does not reach."""
    time, steps = np.linspace(0, 10, 2001), []
    series = cosim.InputSeries(("road",), time, 0.01 * np.sin(30 * time)[:, None])
    for stop in (0.0, 1e4):
        model = cosim.Model("car", stop_time=10.0, output_interval=0.01)
        road = model.input("road", "m", 0.0, "height")
        x, v = model.state("x", "m", 0.0, "position"), model.state("v", "m/s", 0.0, "speed")
        force = ca.if_else(x - road > 1, stop * (x - road - 1), 0) if stop else 0
        model.derivative(x, v)
        model.derivative(v, 100 * (road - x) - v - force)
        steps.append(cosim.simulate(model.freeze(), solver=solver, inputs=series).stats.steps)
    assert steps[1] < 1.1 * steps[0]


def test_derivatives_of_what_rests_on_a_series_are_refused():
    series = cosim.InputSeries(("u",), [0, 1.5, 2.5, 3], [[1], [1], [2], [2]])
    with pytest.raises(CosimError, match="derivatives of what rests on u, which a series moves"):
        cosim.sensitivity(belt(), with_respect_to=["v"], inputs=series)


@pytest.mark.slow
def test_a_name_of_the_users_own_is_no_rate():
    model = cosim.Model("belt", stop_time=3.0, output_interval=0.01)
    u, force = (model.input(name, "1", 1.0, name) for name in ("u", "rate_of_u"))
    v = model.state("v", "1", 0.0, "speed")
    model.derivative(v, -2 * ca.sign(v - u) - 0.5 * force)
    names, time = ("u", "rate_of_u"), [0, 1.5, 2.5, 3]
    series = cosim.InputSeries(names, time, [[1, 1], [1, 2], [2, 1], [2, 1]])
    run = cosim.simulate(model.freeze(), solver="dop853", inputs=series)
    rests = run.time > 1
    right = 1 + np.clip(run.time - 1.5, 0, 1)[rests]
    np.testing.assert_allclose(run["v"][rests], right, rtol=0, atol=1e-9)


@pytest.mark.parametrize("solver", ["cvodes", "rk4"])
def test_what_comes_to_rest_at_a_boundary_does_so_at_every_scale(solver):
    """x = size (1 - t)^2 rests at 0 from 1 s on; a power of 2 changes no digit of it."""
    options = {"step_size": 1e-3} if solver == "rk4" else {"relative_tolerance": 1e-9}
    for power in (-40, 0, 30):
        size = 1e9 * 2.0 ** (power - 30)
        model = cosim.Model("emptied", stop_time=2.0, output_interval=0.5)
        x = model.state("x", "1", size, "a state", nominal=size)
        n = model.discrete("n", "1", 0, "number of events")
        model.derivative(x, -2 * ca.sqrt(size * ca.fmax(x, 0)))
        model.when(x < 0, {n: n + 1})
        run = cosim.simulate(model.freeze(), solver=solver, **options)
        assert run.final["x"] / size == pytest.approx(0, abs=64 * np.finfo(float).eps)
        assert run.final["n"] == 0


@pytest.mark.parametrize("solver", ["dop853", "cvodes", "rk4"])
@pytest.mark.parametrize("size", [1e-9, 1.0, 1e9])
def test_a_stick_ends_at_its_time_whatever_the_unit_of_the_speed(size, solver):
    """Friction holds until the load, which rises as 2 t, exceeds it."""
    model = cosim.Model("load", stop_time=1.0, output_interval=0.1)
    scale = model.parameter("scale", "m/s2", 1.0, "unit of the acceleration")
    v = model.state("v", "m/s", 0.0, "speed", nominal=size)
    model.derivative(v, scale * (2 * model.t - ca.sign(v)))
    run = cosim.simulate(model.freeze(), solver=solver, start_values={"scale": size})
    assert [event.time for event in run.events] == pytest.approx([0.5], abs=1e-11)
    assert run.final["v"] == pytest.approx(0.25 * size, rel=1e-8)
