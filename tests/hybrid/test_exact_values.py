"""Relations whose arguments rest exactly at their boundary, on every kind of backend."""

from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import casadi as ca
import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave
from helpers.mechanical_cases import opening

import cosim
from cosim.errors import SolverError

SLOW = pytest.mark.slow
BACKENDS = ["cvodes", "dop853", pytest.param("rk4", marks=SLOW), "CoSimulation", "ModelExchange"]
FOLDER = Path(mkdtemp())


@cache
def exported(dae, fmi=2):
    """Return an FMU of a model, made once."""
    name = f"{dae.name}_{len(list(FOLDER.iterdir()))}.fmu"
    return cosim.export_fmu(dae, FOLDER / name, fmi=fmi)


def simulated(dae, backend, **options):
    """Return the run of a model on a native solver, or as an FMU."""
    if backend in ("CoSimulation", "ModelExchange"):
        return cosim.simulate_fmu(exported(dae), interface=backend, **options)
    return cosim.simulate(dae, solver=backend, **options)


def driven(title, law):
    """Return x' = law(u) with an input u, from x = 0."""
    x, u = ca.SX.sym("x"), ca.SX.sym("u")
    system = {"x": x, "u": u, "ode": law(u)}
    facts = {"name": title, "stop_time": 5, "output_interval": 0.1}
    return cosim.from_casadi(system, {"x": 0, "u": 0.0}, {}, **facts)


LAWS = {
    "greater": driven("greater", lambda u: ca.if_else(u > 0, 1.0, 0.0)),
    "at_least": driven("at_least", lambda u: ca.if_else(u >= 1, 1.0, 0.0)),
    "at_most": driven("at_most", lambda u: ca.if_else(u <= 0, 1.0, 0.0)),
    "less": driven("less", lambda u: ca.if_else(u < 1, 1.0, 0.0)),
    "floor": driven("floor", lambda u: ca.if_else(ca.floor(u) > 0.5, 1.0, 0.0)),
    "sign": driven("sign", lambda u: 2.0 * ca.sign(u) ** 2),
}
TIME = [0, 1, 5]
PRESSED, RELEASED, RESTS = [0, 1, 1], [1, 0, 0], [0, 0, 0]


@pytest.mark.quick_share(0.3)
@pytest.mark.slow_rows(
    "at_least-values0-4-CoSimulation",
    "greater-values1-1-CoSimulation",
    "floor-values2-4-cvodes",
    "floor-values2-4-CoSimulation",
    "less-values3-1-CoSimulation",
    "at_most-values4-4-CoSimulation",
    "sign-values6-0-CoSimulation",
)
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(
    ("law", "values", "right"),
    [
        ("at_least", PRESSED, 4), ("greater", RELEASED, 1), ("floor", PRESSED, 4),
        ("less", PRESSED, 1), ("at_most", RELEASED, 4), ("greater", PRESSED, 5),
        ("sign", RESTS, 0), ("sign", RELEASED, 2), ("at_most", RESTS, 5), ("greater", RESTS, 0),
    ],
)  # fmt: skip
def test_an_input_that_ramps_to_a_threshold_and_rests_has_the_operators_value(
    law, values, right, backend
):
    inputs = cosim.InputSeries(("u",), TIME, [[value] for value in values])
    run = simulated(LAWS[law], backend, inputs=inputs)
    assert run.final["x"] == pytest.approx(right, abs=1e-6)  # measured 1e-8


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("law", ["greater", "at_least"])
def test_a_signal_of_zero_and_one_switches_at_its_jumps(law, backend):
    time = [0, 1, 1, 2, 2, 3, 3, 5]
    signal = cosim.InputSeries(("u",), time, [[v] for v in (0, 0, 1, 1, 0, 0, 1, 1)])
    run = simulated(LAWS[law], backend, inputs=signal)
    assert run.final["x"] == pytest.approx(3, abs=1e-6)


def meeting():
    """Return how long one input has been at least another one, more than it, and equal to it."""
    model = cosim.Model("meeting", stop_time=4.0, output_interval=0.1)
    a, b = model.input("a", "1", 0.0, "one"), model.input("b", "1", 0.0, "other")
    for name, law in {"least": a >= b, "more": a > b, "equal": ca.fabs(a - b) <= 0}.items():
        model.derivative(model.state(name, "s", 0.0, "time"), ca.if_else(law, 1.0, 0.0))
    return model.freeze()


MEETING = meeting()


@pytest.mark.slow_rows("dop853", "CoSimulation")
@pytest.mark.parametrize("backend", BACKENDS)
def test_inputs_that_meet_and_move_on_together_are_equal(backend):
    both = cosim.InputSeries(("a", "b"), [0, 1, 2, 4], [[0, 1], [2, 2], [3, 3], [6, 5]])
    run = simulated(MEETING, backend, inputs=both)
    found = [run.final[name] for name in ("least", "more", "equal")]
    assert found == pytest.approx([3, 2, 1], abs=1e-5)  # measured 2e-15, 2e-6 (model exchange)


def lowered():
    """Return the time for which an input is at least what an event of a state lowers to 1."""
    model = cosim.Model("lowered", stop_time=4.0, output_interval=0.1)
    x, u = model.state("x", "s", 0.0, "time"), model.input("u", "1", 0.0, "input")
    level, y = model.discrete("d", "1", 5.0, "threshold"), model.state("X", "s", 0.0, "time above")
    model.derivative(x, 1)
    model.derivative(y, ca.if_else(u >= level, 1.0, 0.0))
    model.when(x >= 0.53, {level: 1})
    return model.freeze()


LOWERED = lowered()


@pytest.mark.slow_rows("cvodes", "CoSimulation")
@pytest.mark.parametrize("backend", BACKENDS)
def test_an_input_rests_at_a_threshold_that_an_event_has_moved_there(backend):
    pressed = cosim.InputSeries(("u",), [0, 1, 4], [[0], [1], [1]])
    run = simulated(LOWERED, backend, inputs=pressed)
    assert run.final["X"] == pytest.approx(3, abs=1e-6)


def counter():
    """Return a count that falls to 0 and stays there, and the integral of its sign."""
    model = cosim.Model("counter", stop_time=5.0)
    count, total = model.discrete("n", "1", 1.0, "count"), model.state("X", "1", 0.0, "total")
    model.every(1.0, {count: ca.fmax(count - 1, 0)})
    model.derivative(total, ca.sign(count))
    return model.freeze(), 0.0


def latch():
    """Return a gate that opens when an input is 1."""
    model = cosim.Model("latch", stop_time=5.0)
    x, n = model.state("X", "1", 0.0, "x"), model.discrete("n", "1", 0.0, "n")
    model.derivative(x, n)
    model.when(model.t >= 1, {n: 1})
    return model.freeze(), 4.0


def saw(law):
    """Return the integral of a law of time."""
    model = cosim.Model("saw", stop_time=2.0, output_interval=0.05)
    x = model.state("X", "1", 0.0, "x")
    model.derivative(x, law(model.t))
    return model.freeze()


JUMPING = {
    "counter": counter(),
    "latch": latch(),
    "sign below 1": (saw(lambda t: ca.sign(t - ca.floor(t) - 1)), -2.0),
    "ceil above": (saw(lambda t: ca.if_else(ca.ceil(t) - t > 0, 1, 0)), 2.0),
    "full duty": (saw(lambda t: ca.if_else(ca.fmod(t, 0.25) < 0.25, 1, 0)), 2.0),
    "cyclic": (saw(lambda t: ca.if_else(ca.fmod(ca.floor(4 * t), 4) >= 2, 1, 0)), 1.0),
    "floor": (saw(lambda t: ca.sign(ca.floor(t) - 1) + 1), 1.0),
}


@pytest.mark.quick_share(0.3)
@pytest.mark.slow_rows("counter-CoSimulation", "sign below 1-CoSimulation")
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(
    "name",
    [n if n in ("counter", "sign below 1") else pytest.param(n, marks=SLOW) for n in JUMPING],
)
def test_a_value_that_is_only_approached_before_a_jump_is_never_the_value(name, backend):
    dae, right = JUMPING[name]
    assert simulated(dae, backend).final["X"] == pytest.approx(right, abs=1e-7)  # measured 1e-9


def two_balls():
    """Return two balls that land together; each adds its loss, and a hit."""
    model = cosim.Model("two_balls", stop_time=0.6)
    loss, hits = model.discrete("loss", "J", 0.0, "loss"), model.discrete("hits", "1", 0.0, "hits")
    for ball in "ab":
        h, v = model.state(f"h{ball}", "m", 1.0, "height"), model.state(f"v{ball}", "m/s", 0.0, "v")
        model.derivative(h, v)
        model.derivative(v, -9.81)
        new = {v: -0.7 * v, loss: loss + 0.5 * v**2 * (1 - 0.49), hits: hits + 1}
        model.when(h < 0, new, name=f"impact {ball}")
    return model.freeze()


TWO_BALLS = two_balls()


@pytest.mark.slow_rows("cvodes", "CoSimulation", "dop853")
@pytest.mark.parametrize("backend", BACKENDS)
def test_what_several_events_add_at_one_instant_adds_up(backend):
    run = simulated(TWO_BALLS, backend)
    assert run.final["hits"] == 2
    assert run.final["loss"] == pytest.approx(2 * 9.81 * 0.51, abs=1e-4)  # measured 2e-6
    assert len(run.events) == 2


def falling(speed):
    """Return a body that its event stops at the ground, without anything that holds it there."""
    model = cosim.Model("falling", stop_time=2.0)
    h, v = model.state("h", "m", 1.0, "height"), model.state("v", "m/s", 0.0, "speed")
    model.derivative(h, v)
    model.derivative(v, -9.81)
    model.when(h < 0, {v: speed(v)}, name="landing")
    return model.freeze()


STOPPED = falling(lambda v: 0 * v)


@pytest.mark.slow_rows("cvodes", "CoSimulation")
@pytest.mark.parametrize("backend", BACKENDS)
def test_a_condition_that_stays_true_beyond_its_boundary_ends_the_run(backend):
    with pytest.raises(cosim.CosimError, match="condition of 'landing' stays true"):
        simulated(STOPPED, backend)


def test_a_body_that_an_event_sets_on_the_ground_without_support_is_rejected_at_the_start():
    with pytest.raises(SolverError, match="condition of 'landing' stays true after 0 s"):
        cosim.simulate(falling(lambda v: -0.5 * v), start_values={"h": 0.0})


def sampler():
    """Return a sampler of an input each 0.5 s, and the integral of what it holds."""
    model = cosim.Model("sampler", stop_time=5.0)
    u, x = model.input("U", "1", 0.0, "u"), model.state("X", "1", 0.0, "x")
    held = model.discrete("h", "1", 0.0, "held")
    model.derivative(x, held)
    model.every(0.5, {held: u}, name="sample")
    return model.freeze()


SAMPLER = sampler()


@pytest.mark.slow_rows("CoSimulation")
@pytest.mark.parametrize("backend", BACKENDS)
def test_a_sample_at_a_jump_of_its_input_takes_the_new_value_and_happens_once(backend):
    step = cosim.InputSeries(("U",), [0, 1, 1, 5], [[0], [0], [1], [1]])
    run = simulated(SAMPLER, backend, inputs=step)
    assert run.final["X"] == pytest.approx(4, abs=1e-6)
    assert len({event.time for event in run.events}) == len(run.events) == 11


@pytest.mark.quick_share(0.3)
@pytest.mark.slow_rows("1e-15-dop853")
@pytest.mark.parametrize("solver", ["cvodes", "erk", "rosenbrock", "idas", "dop853"])
@pytest.mark.parametrize("duration", [1.0, 1e-12, 1e-15])
def test_the_time_of_an_event_does_not_depend_on_the_unit_of_time(duration, solver):
    model = cosim.Model("electron", stop_time=1.51 * duration, output_interval=0.0151 * duration)
    x = model.state("x", "m", 0.0, "place", nominal=1e-6)
    v = model.state("v", "m/s", 0.0, "speed", nominal=1e-6 / duration)
    model.derivative(x, v)
    model.derivative(v, 2e-6 / duration**2)
    model.stop(x > 1e-6, "hit")
    run = cosim.simulate(model.freeze(), solver=solver)
    assert run.time[-1] / duration == pytest.approx(1, abs=1e-7)  # measured 2e-8


@pytest.mark.slow_rows("cvodes-0.05", "dop853-0.05", "dop853-1.0")
@pytest.mark.parametrize("interval", [0.05, 1.0])
@pytest.mark.parametrize("solver", ["cvodes", "erk", "dop853"])
def test_a_switch_that_is_only_touched_does_not_move(interval, solver):
    model = cosim.Model("belt", stop_time=20.0, output_interval=interval)
    x, v = model.state("x", "m", 0.0, "place"), model.state("v", "m/s", 0.0, "speed")
    model.derivative(x, v)
    model.derivative(v, -x - 0.3 * ca.sign(v - 0.1))
    sticks = np.arcsin(1 / 3)
    slides = sticks + (0.3 - 0.3 * (1 - np.cos(sticks))) / 0.1
    run = cosim.simulate(model.freeze(), solver=solver, relative_tolerance=1e-8)
    assert run.final["x"] == pytest.approx(0.3 + 0.1 * np.sin(20 - slides), abs=1e-6)


def test_derivatives_of_bodies_that_land_together_are_those_of_each():
    model = cosim.Model("balls", stop_time=1.0)
    for i in (1, 2):
        h, v = model.state(f"h{i}", "m", 1.0, "height"), model.state(f"v{i}", "m/s", 0.0, "speed")
        model.derivative(h, v)
        model.derivative(v, -9.81)
        model.when(h < 0, {v: -0.7 * v}, name=f"impact {i}")
    dae = model.freeze()
    run, start = cosim.integrator(dae, [0, 0.8]), cosim.start_vectors(dae)
    x, p = ca.MX.sym("x", 4), ca.MX.sym("p", dae.p.numel())
    by = ca.Function("by", [x, p], [ca.jacobian(run(x0=x, p=p)["xf"][:, 1], x)])
    found = np.array(by(start["x0"], start["p"]))
    speed = np.sqrt(2 * 9.81)  # of landing; its time grows by 1/speed with the height
    later = 0.8 - speed / 9.81
    right = 0.7 * 9.81 / speed * later - (0.7 * speed - 9.81 * later) / speed
    np.testing.assert_allclose(found[2, [0, 2]], [0, right], rtol=0, atol=1e-4)  # measured 3e-6
    np.testing.assert_allclose(found[0, [0, 2]], [right, 0], rtol=0, atol=1e-4)


def test_derivatives_that_depend_on_the_order_of_events_at_one_time_are_rejected():
    model = cosim.Model("two", stop_time=2.0)
    x, y = model.state("x", "1", 0.0, "x"), model.state("y", "1", 0.0, "y")
    p, q = model.parameter("p", "1", 1.0, "p"), model.parameter("q", "1", 1.0, "q")
    model.derivative(x, 1.0)
    model.derivative(y, y * 0 + 1.0)
    model.when(x > p, {y: 2 * y}, name="doubles")
    model.when(x > q, {y: y + 1}, name="adds")
    dae = model.freeze()
    run = cosim.integrator(dae, [0.0, 2.0])
    v = ca.MX.sym("p", 2)
    by = ca.Function("by", [v], [ca.jacobian(run(x0=[0, 0], p=v)["xf"][:, 1], v)])
    with pytest.raises((SolverError, RuntimeError)):
        by([1.0, 1.0])


def opened(path, kind, **options):
    """Return an FMU instance in its initial state, and references by name."""
    description, folder = fmpy.read_model_description(str(path)), fmpy.extract(str(path))
    references = {v.name: v.valueReference for v in description.modelVariables}
    fmu = kind(guid=description.guid, unzipDirectory=folder, instanceName="i",
               modelIdentifier=description.coSimulation.modelIdentifier)  # fmt: skip
    fmu.instantiate(**options)
    return fmu, references


def test_an_importer_that_adds_its_steps_gets_each_sample_at_its_communication_point(tmp_path):
    model = cosim.Model("sampled", stop_time=20.0)
    x, n = model.state("x", "1", 0.0, "x"), model.discrete("n", "1", 0.0, "count")
    model.derivative(x, -x)
    model.every(0.1, {n: n + 1})
    fmu, references = opened(cosim.export_fmu(model.freeze(), tmp_path / "s.fmu"), FMU2Slave)
    fmu.setupExperiment(startTime=0.0)
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    t, counts = 0.0, []
    for _ in range(200):
        fmu.doStep(t, 0.1)
        t += 0.1
        counts += fmu.getReal([references["n"]])
    assert counts == list(range(2, 202))


def test_an_event_of_an_input_in_event_mode_is_not_undone_by_the_next_step(tmp_path):
    model = cosim.Model("counter", stop_time=3.0)
    u, n = model.input("u", "1", 0.0, "u"), model.discrete("n", "1", 0.0, "count")
    w = model.state("w", "1", 0.0, "w")
    model.derivative(w, 1.0)
    model.when(u > 0.5, {n: n + 1, w: 0})
    path = cosim.export_fmu(model.freeze(), tmp_path / "counter.fmu", fmi=3)
    fmu, references = opened(path, FMU3Slave, eventModeUsed=True, earlyReturnAllowed=True)
    fmu.enterInitializationMode(startTime=0.0)
    fmu.exitInitializationMode()
    fmu.updateDiscreteStates()
    fmu.enterStepMode()
    fmu.doStep(0.0, 0.1)
    fmu.enterEventMode()
    for value in (1.0, 0.0):
        fmu.setFloat64([references["u"]], [value])
        fmu.updateDiscreteStates()
    fmu.enterStepMode()
    fmu.doStep(0.1, 0.1)
    found = list(fmu.getFloat64([references["n"], references["w"]]))
    np.testing.assert_allclose(found, [1, 0.1], rtol=0, atol=1e-12)


def test_a_sample_period_that_is_shortened_takes_no_sample_at_once(tmp_path):
    model = cosim.Model("sampled", stop_time=5.0)
    x, n = model.state("x", "1", 0.0, "x"), model.discrete("n", "1", 0.0, "count")
    period = model.parameter("T", "s", 1.0, "period")
    model.derivative(x, -x)
    model.every(period, {n: n + 1})
    path = cosim.export_fmu(model.freeze(), tmp_path / "s.fmu", tunable=["T"])
    fmu, references = opened(path, FMU2Slave)
    fmu.setupExperiment(startTime=0.0)
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    fmu.doStep(0.0, 1.5)
    assert fmu.getReal([references["n"]]) == [2]  # at 0 and 1 s
    fmu.setReal([references["T"]], [0.4])
    fmu.doStep(1.5, 0.05)
    assert fmu.getReal([references["n"]]) == [2]
    fmu.doStep(1.55, 0.1)  # the next one at 1.6 s
    assert fmu.getReal([references["n"]]) == [3]


@pytest.mark.slow
def test_a_contact_that_opens_is_not_pulled_back():
    model = cosim.Model("contacts", stop_time=1.0)
    opening(model)
    run = cosim.simulate(model.freeze(), solver="dop853")
    assert (run.final["a"], run.final["b"]) == (0.5, 1.0)


def oscillator():
    """Return x = sin t with a validity condition x < 0.9."""
    model = cosim.Model("oscillator", stop_time=20.0)
    x, v = model.state("x", "m", 0.0, "place"), model.state("v", "m/s", 1.0, "speed")
    model.derivative(x, v)
    model.derivative(v, -x)
    model.limit(0.9 - x, "x is below 0.9")
    return model.freeze()


@pytest.mark.slow_rows("0.01-dop853")
@pytest.mark.parametrize("solver", ["dop853", "cvodes"])
@pytest.mark.parametrize("interval", [0.01, 3.14159])
def test_the_end_of_validity_is_found_between_output_times(interval, solver):
    dae = oscillator()
    run = cosim.simulate(dae, solver=solver, output_interval=interval, stop_time=4 * 3.14159)
    assert run.stats["invalid_from"] == pytest.approx(np.arcsin(0.9), abs=1e-6)  # measured 3e-7


def test_a_result_whose_events_are_known_is_not_interpolated_across_them(tmp_path):
    model = cosim.Model("ball", stop_time=2.0)
    h, v = model.state("h", "m", 1.0, "height"), model.state("v", "m/s", 0.0, "speed")
    model.derivative(h, v)
    model.derivative(v, -9.81)
    model.when(h < 0, {v: -0.7 * v}, name="impact")
    path = cosim.export_fmu(model.freeze(), tmp_path / "ball.fmu")
    landing = np.sqrt(2 / 9.81)
    run = cosim.simulate_fmu(path, output_interval=0.05)
    right = 0.7 * 9.81 * landing - 9.81 * (0.46 - landing)
    assert run.at(0.46)["v"] == pytest.approx(right, abs=1e-6)
    assert run.at(0.451)["v"] == pytest.approx(-9.81 * 0.451, abs=1e-6)


INTEGRATOR = driven("integrator", lambda u: u)


@pytest.mark.slow_rows("where(t >= 2, 100, 0)-0-CoSimulation")
@pytest.mark.parametrize("interface", ["CoSimulation", "ModelExchange"])
@pytest.mark.parametrize(
    ("formula", "right"),
    [("where(t >= 2, 100, 0)", 0), ("where(t >= 1, where(t >= 2, 0, 1), 0)", 1)],
)
def test_an_input_that_jumps_at_the_stop_time_has_the_value_before_it_until_then(
    formula, right, interface
):
    inputs = {"u": formula}
    run = cosim.simulate_fmu(
        exported(INTEGRATOR), interface=interface, inputs=inputs, stop_time=2.0
    )
    assert run.final["x"] == pytest.approx(right, abs=1e-9)  # measured 4e-16
