"""States that reach a boundary at an output time, or at the last one, on every backend.

There, rounding alone tells on which side the solver's state is. The event belongs to the time: what
it changes is in that row.
"""

from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import casadi as ca
import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import FMU2Slave

import cosim

SOLVERS = ["dop853", "cvodes", "idas", "rk4", "ode8", "erk", "rosenbrock"]
INTERFACES = [(fmi, kind) for fmi in (2, 3) for kind in ("CoSimulation", "ModelExchange")]
INTERVAL, STOP = 0.5, 3.0  # s
ROWS = np.arange(0, STOP + INTERVAL / 2, INTERVAL)
FOLDER = Path(mkdtemp())


@cache
def clock():
    """Return x = t, the whole seconds as a floor, and what counts the third one."""
    model = cosim.Model("clock", stop_time=STOP, output_interval=INTERVAL)
    x = model.state("x", "1", 0.0, "time")
    y = model.state("y", "1", 0.0, "integral of the whole seconds")
    n, m = (model.discrete(name, "1", 0.0, name) for name in "nm")
    model.derivative(x, 1.0)
    model.derivative(y, ca.floor(x))
    model.when(x >= 3, {n: n + 1}, name="three")
    model.when(ca.floor(2 * x) >= 6, {m: m + 1}, name="six halves")
    model.output("whole", "1", ca.floor(x), "whole seconds")
    return model.freeze()


@cache
def exported(fmi):
    return cosim.export_fmu(clock(), FOLDER / f"clock_{fmi}.fmu", fmi=fmi)


def assert_all_at_its_time(time, whole, counts):
    """Assert that rows hold what happens at their times; of equal times, the last one tells."""
    last = [np.flatnonzero(time <= t * (1 + 1e-12))[-1] for t in ROWS]
    assert list(whole[last]) == list(np.floor(ROWS))
    assert [count[-1] for count in counts] == [1, 1]


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("solver", SOLVERS)
def test_what_is_reached_at_an_output_time_happens_there(solver):
    run = cosim.simulate(clock(), solver=solver)
    assert_all_at_its_time(run.time, run["whole"], (run["n"], run["m"]))
    assert [round(event.time, 12) for event in run.events if event.name == "three"] == [3.0]


@pytest.mark.parametrize("solver", ["dop853", "idas", "rosenbrock"])
def test_no_event_lies_beyond_the_row_it_belongs_to(solver):
    model = cosim.Model("scaled", stop_time=STOP, output_interval=0.1)
    x, n = model.state("x", "1", 0.0, "time"), model.discrete("n", "1", 0.0, "n")
    z = model.algebraic("z", "1", 0.0, "a tenth")
    model.derivative(x, 1.0)
    model.equation(3 * z - 0.3 * x)
    model.when(z >= 0.3, {n: n + 1}, name="at the end")
    run = cosim.simulate(model.freeze(), solver=solver)
    assert [event.time <= STOP for event in run.events] == [True]
    assert run.final["n"] == 1


def test_runs_of_a_block_do_as_single_ones():
    runs = cosim.simulate_many(clock(), {"x": [0.0, 0.0]}, solver="dop853", outputs=["whole", "n"])
    assert runs["n"][:, -1].tolist() == [1, 1]
    assert runs["whole"][:, -1].tolist() == [3, 3]


@pytest.mark.parametrize(("fmi", "interface"), INTERFACES)
def test_an_fmu_does_so_in_an_importer(fmi, interface):
    found = fmpy.simulate_fmu(
        exported(fmi), fmi_type=interface, stop_time=STOP, output_interval=INTERVAL,
        output=["whole", "n", "m"],
    )  # fmt: skip
    assert_all_at_its_time(found["time"], found["whole"], (found["n"], found["m"]))


@cache
def slow_clock(rate):
    """Return what passes its boundary at the last instant, at a rate of 1/s."""
    model = cosim.Model("slow_clock", stop_time=STOP, output_interval=INTERVAL)
    p = model.parameter("rate", "1/s", rate, "rate")
    x, n = model.state("x", "1", 0.0, "way"), model.discrete("n", "1", 0.0, "passages")
    model.derivative(x, p)
    model.when(x >= STOP * p, {n: n + 1}, name="end of the way")
    return model.freeze()


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("solver", SOLVERS)
def test_a_slow_state_reaches_its_boundary_at_the_last_instant(solver):
    for rate in (1e-6, 1e-12, 1e3):
        run = cosim.simulate(slow_clock(1.0), solver=solver, start_values={"rate": rate})
        assert run["n"].tolist() == [0, 0, 0, 0, 0, 0, 1]


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize(("fmi", "interface"), INTERFACES)
def test_a_slow_state_does_so_in_an_fmu(fmi, interface):
    path = cosim.export_fmu(slow_clock(1.0), FOLDER / f"slow_clock_{fmi}.fmu", fmi=fmi)
    found = fmpy.simulate_fmu(
        path, fmi_type=interface, stop_time=STOP, output_interval=INTERVAL, output=["n"],
        start_values={"rate": 1e-6},
    )  # fmt: skip
    assert found["n"][-1] == 1


# errors of others pass it, and so do those of dop853 where stability limits its steps
@pytest.mark.parametrize(
    ("solver", "steps"),
    [("dop853", {"max_step": 0.1}), ("rk4", {}), ("ode8", {"step_size": 0.1})],
)
@pytest.mark.parametrize("rate", [17.75, 20.0])
def test_what_comes_to_rest_at_a_boundary_never_reaches_it(solver, steps, rate):
    """x' = k (1 - x) is 1 but for rounding from 40 / k on."""
    model = cosim.Model("rest", stop_time=STOP, output_interval=INTERVAL)
    x, n = model.state("x", "1", 0.0, "way"), model.discrete("n", "1", 0.0, "passages")
    model.derivative(x, rate * (1 - x))
    model.when(x > 1, {n: n + 1}, name="beyond")
    assert cosim.simulate(model.freeze(), solver=solver, **steps).final["n"] == 0


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("solver", SOLVERS)
def test_a_touch_at_an_output_time_is_none(solver):
    model = cosim.Model("touch", stop_time=2.0, output_interval=INTERVAL)
    x, v = model.state("x", "1", 0.0, "height"), model.state("v", "1/s", 2.0, "rate")
    n = model.discrete("n", "1", 0.0, "n")
    model.derivative(x, v)
    model.derivative(v, -2.0)  # x = 2 t - t^2 has its maximum of 1 at 1 s
    model.when(x >= 1 + 1e-9, {n: n + 1}, name="beyond")
    model.when(x >= 1 - 1e-6, {n: n + 1}, name="just below")
    assert cosim.simulate(model.freeze(), solver=solver).final["n"] == 1


@pytest.mark.parametrize(("after", "beyond"), [(1.0, 1.0), (-1.0, 0.0)])
def test_what_an_importer_sets_at_a_communication_point_decides(after, beyond):
    """x' = u reaches 1 where u is set again: only what goes on is above."""
    model = cosim.Model("driven", stop_time=2.0, output_interval=0.125)
    u, x = model.input("u", "1/s", 1.0, "rate"), model.state("x", "1", 0.0, "way")
    above = model.state("above", "s", 0.0, "time above 1")
    model.derivative(x, u)
    model.derivative(above, ca.if_else(x > 1, 1.0, 0.0))
    path = cosim.export_fmu(model.freeze(), FOLDER / f"driven_{after:g}.fmu")
    description = fmpy.read_model_description(path)
    number = {v.name: v.valueReference for v in description.modelVariables}
    facts = {
        "guid": description.guid,
        "instanceName": "driven",
        "unzipDirectory": fmpy.extract(path),
    }
    facts["modelIdentifier"] = description.coSimulation.modelIdentifier
    slave = FMU2Slave(**facts)
    slave.instantiate()
    slave.setupExperiment(startTime=0.0, stopTime=2.0)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    for k in range(16):
        slave.setReal([number["u"]], [1.0 if k < 8 else after])
        slave.doStep(k * 0.125, 0.125)
    found = slave.getReal([number["above"]])
    slave.terminate()
    slave.freeInstance()
    assert found == pytest.approx([beyond], abs=1e-9)


@pytest.mark.slow_rows("dop853")
@pytest.mark.parametrize("solver", ["dop853", "cvodes"])
def test_the_derivative_of_an_event_at_the_last_instant_counts_its_time(solver):
    """x' = p, halved at 3: x(3) = 1.5 + p (3 - 3 / p) from p = 1 on."""
    model = cosim.Model("halved", stop_time=STOP, output_interval=1.0)
    p, x = model.parameter("p", "1/s", 1.0, "rate"), model.state("x", "1", 0.0, "way")
    model.derivative(x, p)
    model.when(x >= 3, {x: 0.5 * x}, name="half")
    of_p = ca.MX.sym("p")
    run = cosim.integrator(model.freeze(), np.linspace(0, STOP, 4), solver=solver)
    last = run(x0=ca.DM([0.0]), p=of_p)["xf"][0, -1]
    found = ca.Function("found", [of_p], [last, ca.jacobian(last, of_p)])(1.0)
    assert [float(value) for value in found] == pytest.approx([1.5, 3.0], abs=1e-9)


@pytest.mark.parametrize(
    "steps",
    [{"accuracy": 1e-6}, *({"method": m, "macro_step": 0.25} for m in ("iterated", "jacobi"))],
)
def test_what_a_coupled_input_reaches_at_the_last_instant_happens(steps):
    clock, counter = (cosim.Model(name, stop_time=STOP) for name in ("clock", "counter"))
    x, u = clock.state("x", "1", 0.0, "time"), counter.input("u", "1", 0.0, "time")
    clock.derivative(x, 1.0)
    clock.output("y", "1", 1 * x, "time")
    n = counter.discrete("n", "1", 0.0, "count")
    counter.when(u >= STOP, {n: n + 1}, name="end")
    parts = {"clock": clock.freeze(), "counter": counter.freeze()}
    run = cosim.couple(parts, {"counter.u": "clock.y"}).simulate(**steps)
    assert run.final["counter.n"] == 1
    assert [(event.time, event.name) for event in run.events] == [(STOP, "counter: end")]


@pytest.mark.parametrize("solver", ["cvodes", "erk"])
def test_steps_beyond_an_event_are_few_at_any_output_interval(solver):
    model = cosim.Model("oscillator", stop_time=2.0)
    x, v = model.state("x", "1", 1.0, "place"), model.state("v", "1/s", 0.0, "speed")
    turns = model.discrete("turns", "1", 0, "turns")
    model.derivative(x, v)
    model.derivative(v, -2500 * x)
    model.when(x > 0.5, {turns: turns + 1})
    dae = model.freeze()
    far, near = (cosim.simulate(dae, solver=solver, output_interval=h) for h in (0.1, 0.01))
    assert far.final["turns"] == near.final["turns"] == 16  # once in a period of 2 pi / 50 s
    assert far.stats.steps < 3 * near.stats.steps  # measured 1.8 and 2.4; before, 6 and 7


@pytest.mark.slow_rows("ode8-native", "ode8-fmu")
@pytest.mark.parametrize("way", ["native", "fmu"])
@pytest.mark.parametrize("solver", ["rk4", "ode8"])
def test_rounding_of_many_steps_hides_no_event_at_the_stop_time(solver, way, tmp_path):
    model = cosim.Model("countdown", stop_time=4.0, output_interval=0.1)
    x, n = model.state("x", "1", 4.0, "rest"), model.discrete("n", "1", 0, "events")
    model.derivative(x, -1.0)
    model.when(x <= 0, {n: n + 1})
    dae, steps = model.freeze(), {"solver": solver, "step_size": 0.01}
    if way == "fmu":
        path = cosim.export_fmu(dae, tmp_path / "countdown.fmu", **steps)
        run = cosim.simulate_fmu(path, interface="CoSimulation")
    else:
        run = cosim.simulate(dae, **steps)
    assert run.final["x"] == pytest.approx(0, abs=1e-13)  # 4.3e-14, as 400 steps are rounded
    assert run.final["n"] == 1  # before: 0


@cache
def driven(kind):
    """Return what counts at every half second, by a sawtooth or a sampler, beside an input."""
    model = cosim.Model(kind, stop_time=2.0, output_interval=0.25)
    u, n = model.input("u", "1", 0.0, "drive"), model.discrete("n", "1", 0.0, "count")
    y, z = (model.state(name, "1", 0.0, name) for name in "yz")
    model.derivative(y, u)
    model.derivative(z, 1.0)
    if kind == "sampler":
        model.every(0.5, {z: 0, n: n + 1}, offset=0.5, name="sample")
    else:
        model.when(z >= 0.5, {z: 0, n: n + 1}, name="tooth")
    return model.freeze()


TIMES = [0, 0.5, 0.5, 1, 1, 2]
KINKS = cosim.InputSeries(("u",), [0, 0.5, 1, 2], [[0], [0.5], [0], [-2]])
STEPS = cosim.InputSeries(("u",), [0, 0.5, 0.5, 1, 2], [[0], [1], [0], [1], [1]])
MOVING = pytest.mark.parametrize("drive", [{"u": "t"}, KINKS, STEPS], ids=["t", "kinks", "steps"])
COUNTING = pytest.mark.parametrize("kind", ["sawtooth", "sampler"])


def assert_inputs_move_no_event_off_its_row(run):
    np.testing.assert_allclose(run["z"], run.time % 0.5, rtol=0, atol=1e-13)  # measured 7e-15
    np.testing.assert_array_equal(run["n"], run.time // 0.5)


@MOVING
@COUNTING
@pytest.mark.parametrize("solver", SOLVERS)
def test_events_at_rows_stay_there_while_inputs_move(solver, kind, drive):
    run = cosim.simulate(driven(kind), inputs=drive, solver=solver)
    assert_inputs_move_no_event_off_its_row(run)


@MOVING
@COUNTING
@pytest.mark.parametrize("solver", ["dop853", "rk4"])
@pytest.mark.parametrize("fmi", [2, 3])
def test_events_at_communication_points_stay_there_while_inputs_move(fmi, solver, kind, drive):
    """The last one was lost, and the others came after their rows."""
    path = FOLDER / f"{kind}_{fmi}_{solver}.fmu"
    if not path.exists():
        cosim.export_fmu(driven(kind), path, fmi=fmi, solver=solver)
    run = cosim.simulate_fmu(path, interface="CoSimulation", inputs=drive)
    assert_inputs_move_no_event_off_its_row(run)


@pytest.mark.parametrize("other", [0, 1], ids=["others-rest", "others-move"])
@pytest.mark.parametrize("solver", ["dop853", "rk4"])
@pytest.mark.parametrize("fmi", [2, 3])
def test_an_input_that_jumps_where_a_state_reaches_a_boundary_turns_it(fmi, solver, other):
    """The event happened before the jump, and was counted even where the state turned."""
    path = FOLDER / f"turned_{fmi}_{solver}.fmu"
    if not path.exists():
        model = cosim.Model("turned", stop_time=2.0, output_interval=0.25)
        u, w = (model.input(name, "1", 0.0, name) for name in "uw")
        x, y = (model.state(name, "1", 0.0, name) for name in "xy")
        n = model.discrete("n", "1", 0.0, "count")
        model.derivative(x, u)
        model.derivative(y, w)
        model.when(x >= 0.5, {n: n + 1}, name="half")
        cosim.export_fmu(model.freeze(), path, fmi=fmi, solver=solver)
    for after, time in ((-1, 1.5), (2, 0.5)):  # the slope between 0.5 s and 1 s
        slopes = [1, 1, after, after, 1, 1]
        rows = [[slope, other * t] for t, slope in zip(TIMES, slopes, strict=True)]
        drive = cosim.InputSeries(("u", "w"), TIMES, rows)
        run = cosim.simulate_fmu(path, interface="CoSimulation", inputs=drive)
        np.testing.assert_array_equal(run["n"], run.time >= time)


@pytest.mark.parametrize("method", ["iterated", "jacobi", "gauss_seidel", "extrapolated"])
@pytest.mark.parametrize("lacks", ["no event mode", "no rollback", "no rollback, no event mode"])
def test_events_of_parts_without_abilities_stay_at_their_rows(lacks, method):
    """The last of four was lost, and the others came after their rows."""
    source = cosim.Model("source", stop_time=2.0, output_interval=0.25)
    x = source.state("x", "1", 0.0, "ramp")
    source.derivative(x, 1.0)
    source.output("y", "1", 1 * x, "ramp")
    parts = {"teeth": driven("sawtooth"), "source": source.freeze()}
    system = cosim.couple(parts, {"teeth.u": "source.y"}, abilities={"teeth": lacks})
    run = system.simulate(method=method, macro_step=0.25)
    np.testing.assert_array_equal(run["teeth.n"], run.time // 0.5)
