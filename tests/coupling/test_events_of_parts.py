"""Events of coupled parts happen at the same time in all parts, against the one model."""

from random import Random

import casadi as ca
import numpy as np
import pytest

import cosim

STOP = 3.0


def part(name):
    return cosim.Model(name, stop_time=STOP, output_interval=0.05)


def mass(restoring=1.0, damping=0.1, speed=0.3):
    model = part("plant")
    u = model.input("u", "N", 0.0, "force")
    x, v = model.state("x", "m", 1.0, "place"), model.state("v", "m/s", speed, "speed")
    model.derivative(x, v)
    model.derivative(v, u - restoring * x - damping * v)
    model.output("place", "m", x, "place")
    model.output("speed", "m/s", v, "speed")
    return model.freeze()


def sampled():
    """A controller that holds its output between samples."""
    controller = part("controller")
    y, w = controller.input("y", "m", 0.0, "place"), controller.input("w", "m/s", 0.0, "speed")
    held = controller.discrete("held", "N", 0.0, "force")
    controller.every(0.1, {held: -3 * y - 2 * w}, name="sample")
    controller.output("u", "N", held, "force")
    wires = {"plant.u": "c.u", "c.y": "plant.place", "c.w": "plant.speed"}
    return {"plant": mass(), "c": controller.freeze()}, wires


def ball():
    """A ball that bounces on a table that swings."""
    model = part("ball")
    y, w = model.input("y", "m", 0.0, "table"), model.input("w", "m/s", 0.0, "its speed")
    x, v = model.state("x", "m", 2.0, "height"), model.state("v", "m/s", 0.0, "speed")
    model.derivative(x, v)
    model.derivative(v, -9.81)
    model.when(x < y, {v: w - 0.8 * (v - w)}, name="impact")
    model.output("drag", "N", -0.05 * v, "force on the table")
    wires = {"ball.y": "plant.place", "ball.w": "plant.speed", "plant.u": "ball.drag"}
    return {"plant": mass(50.0), "ball": model.freeze()}, wires


def swing():
    """x'' = -x + u with a validity condition."""
    model = part("swing")
    u = model.input("u", "N", 0.0, "force")
    x, v = model.state("x", "m", 1.0, "place"), model.state("v", "m/s", 0.0, "speed")
    model.derivative(x, v)
    model.derivative(v, u - x)
    model.limit(x + 0.5, "x is high")
    return model.freeze()


def follower():
    """What it takes in drives nothing: y = 0."""
    model = part("follower")
    u, w = model.input("u", "m", 0.0, "place"), model.state("w", "m.s", 0.0, "integral")
    model.derivative(w, u)
    model.output("y", "N", 0 * w, "force")
    return model.freeze()


def relay():
    """A relay with hysteresis switches a heater, whose part counts the switches."""
    switch, room = part("relay"), part("room")
    x = switch.input("x", "1", 0.0, "temperature")
    on = switch.discrete("on", "1", 1.0, "state")
    switch.when(x > 1, {on: 0.0}, name="off")
    switch.when(x < 0.5, {on: 1.0}, name="on")
    switch.output("u", "1", on, "power")
    u, t = room.input("u", "1", 0.0, "power"), room.state("t", "1", 0.0, "temperature")
    count = room.discrete("count", "1", 0.0, "number of switches")
    room.derivative(t, 3 * u - t)
    room.when(u > 0.5, {count: count + 1}, name="rise")
    room.output("y", "1", t, "temperature")
    parts = {"relay": switch.freeze(), "room": room.freeze()}
    return parts, {"room.u": "relay.u", "relay.x": "room.y"}


def thermostat(high, low, heat, loss, rate):
    """T' = heat q - loss T, R' = rate (T - R), and a relay on R."""
    room, switch = part("room"), part("relay")
    t, r = (room.state(name, "1", 0.0, name) for name in ("T", "R"))
    room.derivative(t, heat * room.input("q", "1", 1.0, "power") - loss * t)
    room.derivative(r, rate * (t - r))
    m, on = switch.input("m", "1", 0.0, "measured"), switch.discrete("on", "1", 1.0, "state")
    switch.when(m > high, {on: 0}, name="off")
    switch.when(m < low, {on: 1}, name="on")
    parts = {"p": room.freeze(), "r": switch.freeze()}
    return cosim.couple(parts, {"p.q": "r.on", "r.m": "p.R"})


def ending():
    """A clock that ends the run where a mass is back."""
    clock = part("clock")
    x = clock.input("x", "m", 0.0, "place of the mass")
    clock.stop(x < 0, "the mass is back")
    clock.output("u", "N", 0.1 * clock.t, "force")
    return clock.freeze()


def block():
    """A block with dry friction, pulled by a spring."""
    model, motor = part("block"), part("motor")
    pull = model.input("pull", "m", 0.0, "end of the spring")
    x, v = model.state("x", "m", 0.0, "place"), model.state("v", "m/s", 0.0, "speed")
    model.derivative(x, v)
    model.derivative(v, 20 * (pull - x) - 3 * ca.sign(v) - 0.1 * v)
    model.output("place", "m", x, "place")
    y = motor.input("y", "m", 0.0, "place of the block")
    p, q = motor.state("p", "m", 0.0, "place"), motor.state("q", "m/s", 0.4, "speed")
    motor.derivative(p, q)
    motor.derivative(q, 2 * (0.4 - q) - 0.5 * (p - y) + 0.4 * motor.t)
    motor.output("place", "m", p, "place")
    parts = {"block": model.freeze(), "motor": motor.freeze()}
    return parts, {"block.pull": "motor.place", "motor.y": "block.place"}


SYSTEMS = {
    sampled: ("plant.x", "plant.v", "c.held"),
    ball: ("ball.x", "plant.x"),
    relay: ("room.t", "room.count", "relay.on"),
    block: ("block.x", "block.v", "motor.p"),
}


@pytest.mark.slow
@pytest.mark.parametrize("make", SYSTEMS)
def test_events_end_macro_steps_so_that_their_error_is_that_of_the_coupling(make):
    system = cosim.couple(*make())
    exact = cosim.simulate(system.dae, solver="dop853", relative_tolerance=1e-12)
    assert exact.events
    for accuracy in (1e-3, 1e-6, 1e-8):
        run = system.simulate(stop_time=STOP, accuracy=accuracy)
        for name in SYSTEMS[make]:
            np.testing.assert_allclose(run[name], exact[name], rtol=0, atol=accuracy)
    for method in ("iterated", "extrapolated"):
        run = system.simulate(stop_time=STOP, macro_step=0.02, method=method)
        for name in SYSTEMS[make]:
            np.testing.assert_allclose(run[name], exact[name], rtol=0, atol=1e-6)
        assert any("events end macro steps" in words for words in run.stats["order"].values())
        times = [sorted({round(event.time, 6) for event in r.events}) for r in (run, exact)]
        assert times[0] == times[1]


@pytest.mark.slow_rows(
    "relay-{'accuracy': 1e-06}", "block-{'accuracy': 1e-06}", "relay-{'macro_step': 0.02}"
)
@pytest.mark.parametrize("ways", [{"accuracy": 1e-6}, {"macro_step": 0.02}], ids=str)
@pytest.mark.parametrize("make", [relay, block])
def test_threads_change_nothing_where_events_end_steps(make, ways):
    system = cosim.couple(*make())
    alone, together = (system.simulate(stop_time=STOP, threads=t, **ways) for t in (False, True))
    np.testing.assert_array_equal(together.values, alone.values)
    assert together.stats["part_steps"] == alone.stats["part_steps"]
    assert together.events == alone.events


@pytest.mark.slow
def test_an_event_that_another_part_causes_at_an_output_time_is_in_its_row():
    source, counter = part("source"), part("counter")
    level = source.discrete("level", "1", 0.0, "level")
    source.every(0.5, {level: 1 - level}, name="turn")
    source.output("u", "1", level, "level")
    u = counter.input("u", "1", 0.0, "level")
    count = counter.discrete("count", "1", 0.0, "number")
    counter.when(u > 0.5, {count: count + 1}, name="rise")
    counter.output("n", "1", count, "number")
    for parts in ({"a": source, "b": counter}, {"b": counter, "a": source}):
        frozen = {name: model.freeze() for name, model in parts.items()}
        system = cosim.couple(frozen, {"b.u": "a.u"})
        run = system.simulate(stop_time=STOP, macro_step=0.1)
        exact = cosim.simulate(system.dae)
        np.testing.assert_array_equal(run["a.level"], exact["a.level"])
        np.testing.assert_array_equal(run["b.count"], exact["b.count"])


@pytest.mark.slow_rows("time")
@pytest.mark.parametrize("of", ["time", "state"])
def test_a_relation_in_an_output_that_drives_a_part_is_an_event(of):
    source, body = part("source"), part("body")
    x = source.state("x", "1", 0.0, "x")
    source.derivative(x, 1.0)
    source.output("push", "N", ca.if_else((x if of == "state" else source.t) > 1.111, 2, 1), "push")
    v, f = body.state("v", "m/s", 0.0, "speed"), body.input("f", "N", 0.0, "force")
    body.derivative(v, f)
    system = cosim.couple({"a": source.freeze(), "b": body.freeze()}, {"b.f": "a.push"})
    for method in ("iterated", "extrapolated"):
        run = system.simulate(stop_time=STOP, macro_step=0.05, method=method)
        assert run.final["b.v"] == pytest.approx(1.111 + 2 * (STOP - 1.111), abs=1e-12)
        assert [event.time for event in run.events] == pytest.approx([1.111], abs=1e-12)


@pytest.mark.slow
def test_an_event_soon_before_the_end_of_the_run_ends_its_macro_step():
    when = 2.9999
    clock = part("clock")
    n = clock.discrete("n", "N", 0.0, "force")
    clock.when(clock.t > when, {n: 1.0}, name="tick")
    clock.output("u", "N", n, "force")
    system = cosim.couple({"clock": clock.freeze(), "plant": mass()}, {"plant.u": "clock.u"})
    run = system.simulate(stop_time=STOP, accuracy=1e-6)
    assert [event.time for event in run.events] == pytest.approx([when], abs=1e-12)
    exact = cosim.simulate(system.dae, solver="dop853", relative_tolerance=1e-12)
    assert run.final["plant.x"] == pytest.approx(exact.final["plant.x"], abs=1e-6)


@pytest.mark.slow
def test_events_that_cause_each_other_without_end_are_an_error():
    def negating(name, sign):
        model = part(name)
        u = model.input("u", "1", 0.0, "u")
        y = model.discrete("y", "1", 0.0, "y")
        model.when(model.t > 1, {y: 1.0}, name="begin")
        model.when(u > 0.5, {y: float(sign < 0)}, name="up")
        model.when(u < 0.5, {y: float(sign > 0)}, name="down")
        model.output("out", "1", y, "out")
        return model.freeze()

    parts = {"a": negating("a", 1), "b": negating("b", -1)}
    system = cosim.couple(parts, {"a.u": "b.out", "b.u": "a.out"})
    with pytest.raises(cosim.errors.SolverError, match=r"1 s.*(Zeno|without end)"):
        system.simulate(stop_time=STOP, macro_step=0.1)


@pytest.mark.quick_rows("plant-gauss_seidel")
@pytest.mark.parametrize("method", ["iterated", "extrapolated", "gauss_seidel"])
@pytest.mark.parametrize("first", ["clock", "plant"])
def test_a_part_that_ends_the_run_ends_that_of_the_system(first, method):
    parts = {"plant": mass(), "clock": ending()}
    order = [first, *(parts.keys() - {first})]
    wires = {"plant.u": "clock.u", "clock.x": "plant.place"}
    system = cosim.couple({name: parts[name] for name in order}, wires)
    exact = cosim.simulate(system.dae, solver="dop853", relative_tolerance=1e-12)
    assert exact.stats["stop"].startswith("the mass is back")
    settings = {"macro_step": 0.01} if method == "gauss_seidel" else {"accuracy": 1e-7}
    run = system.simulate(stop_time=STOP, method=method, **settings)
    assert run.complete
    assert run.stats["stop"].startswith("the mass is back (part 'clock') from 2.0")
    if method == "gauss_seidel":
        assert exact.time[-1] - 0.06 < run.time[-1] <= exact.time[-1] + 0.01
        return
    assert run.time[-1] == run.stats["stop_time"] == pytest.approx(exact.time[-1], abs=1e-6)
    assert len(run) == len(exact)
    np.testing.assert_allclose(run["plant.x"], exact["plant.x"], rtol=0, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["iterated", "gauss_seidel"])
def test_a_part_without_event_mode_ends_the_run_as_near_as_steps_come(method, tmp_path):
    file = cosim.export_fmu(ending(), tmp_path / "clock.fmu", fmi=2)
    parts, without = {"plant": mass(), "clock": file}, {"clock": "no event mode"}
    system = cosim.couple(parts, {"clock.x": "plant.place"}, abilities=without)
    exact = cosim.simulate(mass(), solver="dop853", relative_tolerance=1e-12, stop_when="x < 0")
    settings = {"macro_step": 0.01} if method == "gauss_seidel" else {"accuracy": 1e-7}
    run = system.simulate(stop_time=STOP, output_interval=0.05, method=method, **settings)
    assert run.complete
    assert "(part 'clock')" in run.stats["stop"]
    late = {"iterated": 1e-5, "gauss_seidel": 0.07}[method]
    assert run.time[-1] == pytest.approx(exact.time[-1], abs=late)


@pytest.mark.slow
def test_files_that_jump_within_macro_steps_converge_and_the_interface_error_tells(tmp_path):
    parts, wires = relay()
    exact = cosim.simulate(cosim.couple(parts, wires).dae, solver="dop853")
    files = {n: str(cosim.export_fmu(part, tmp_path / f"{n}.fmu")) for n, part in parts.items()}
    system, errors = cosim.couple(files, wires, abilities=dict.fromkeys(files, "no event mode")), []
    for step in (0.005, 0.001):
        run = system.simulate(stop_time=STOP, macro_step=step, method="extrapolated")
        assert run.final["room.count"] == exact.final["room.count"]
        assert run["relay.u"].max() == 1
        assert run.stats["interface_error"] == pytest.approx(1.0)
        errors.append(abs(run.final["room.t"] - exact.final["room.t"]))
    assert errors[1] < 0.3 * errors[0] < 0.03


@pytest.mark.slow
def test_files_of_both_versions_sample_until_the_end(tmp_path):
    """Where one has no event mode, macro steps shrink to nearly nothing before a sample."""
    controller, filtered = part("controller"), part("filter")
    y, held = controller.input("y", "m", 0.0, "place"), controller.discrete("held", "N", 0.0, "u")
    k = controller.discrete("k", "1", 0.0, "number of samples")
    controller.every(0.1, {held: -2 * y, k: k + 1}, name="sample")
    controller.output("u", "N", held, "force")
    w, kept = filtered.input("w", "N", 0.0, "force"), filtered.discrete("kept", "N", 0.0, "force")
    filtered.every(0.2, {kept: w}, name="sample")
    filtered.output("z", "N", kept, "force")
    parts = {"plant": (mass(), 2), "c": (controller.freeze(), 3), "e": (filtered.freeze(), 2)}
    files = {
        name: str(cosim.export_fmu(dae, tmp_path / f"{name}.fmu", fmi=fmi))
        for name, (dae, fmi) in parts.items()
    }
    wires = {"plant.u": "e.z", "c.y": "plant.place", "e.w": "c.u"}
    system = cosim.couple(files, wires, abilities={"e": "no event mode"})
    run = system.simulate(stop_time=STOP, accuracy=1e-6)
    assert run.time[-1] == STOP
    assert run.final["c.k"] == 31
    row = int(np.argmin(np.abs(run.time - 1.8)))
    assert [run["c.k"][row], run["c.k"][row - 1]] == [19, 18]


@pytest.mark.slow
def test_a_reset_by_another_part_that_undoes_its_own_cause_happens_once():
    """An integrator, reset by a comparator as soon as it reaches 1, is a sawtooth."""
    one = cosim.Model("integrator", stop_time=2.0)
    x, r = one.state("x", "1", 0.0, "x"), one.input("r", "1", 0.0, "reset")
    one.derivative(x, 1.0)
    one.when(r > 0.5, {x: 0})
    one.output("y", "1", x + 0, "y")
    two = cosim.Model("comparator", stop_time=2.0)
    y, d = two.input("x", "1", 0.0, "x"), two.state("d", "1", 0.0, "d")
    two.derivative(d, 0 * d)
    two.output("r", "1", ca.if_else(y >= 1.0, 1, 0), "reset")
    parts = {"a": one.freeze(), "b": two.freeze()}
    system = cosim.couple(parts, {"a.r": "b.r", "b.x": "a.y"})
    for settings in ({"macro_step": 0.01}, {}):
        run = system.simulate(stop_time=1.5, **settings)
        assert run.final["a.x"] == pytest.approx(0.5, abs=1e-9)  # measured 2e-16


@pytest.mark.slow
def test_a_relay_in_another_part_switches_once_per_instant():
    """Times from matrix exponentials."""
    system = thermostat(1.2, 0.8, heat=2.0, loss=0.5, rate=4.0)
    times = [0.97207071, 2.54609546, 3.09667761, 4.61107678, 5.16157214]
    tight = {"solver": "dop853", "relative_tolerance": 1e-12}
    for accuracy in (1e-3, 1e-6):
        run = system.simulate(stop_time=6.0, output_interval=0.05, accuracy=accuracy)
        found = [event.time for event in run.events]
        assert found == pytest.approx(times, abs=accuracy)  # 12 to 20 times each before
        exact = cosim.simulate(system.dae, stop_time=6.0, output_interval=0.05, **tight)
        error = max(np.abs(run[name] - exact[name]).max() for name in ("p.T", "p.R"))
        assert error < run.stats["error_estimate"] < accuracy
        assert run.stats["all_macro_steps"] < 480  # measured 146, 433; 215, 529 before
        assert run.stats["rejected_steps"] < 3  # 33 before, after events


@pytest.mark.slow_rows("104")
@pytest.mark.parametrize("seed", [47, 104])
def test_a_relay_that_is_just_beyond_its_threshold_as_a_step_begins_switches_there(seed):
    """A relation that a settled input moves past its mode is an event of all parts, too."""
    numbers = Random(seed)
    heat, loss, rate, high, low = map(numbers.uniform, (1, 0.2, 2, 1.0, 0.5), (4, 1, 8, 1.4, 0.9))
    system = thermostat(high, low, heat, loss, rate)
    tight = {"solver": "dop853", "relative_tolerance": 1e-12}
    exact = cosim.simulate(system.dae, output_interval=0.015, **tight)
    run = system.simulate(stop_time=3.0, output_interval=0.015, accuracy=1e-8)
    times = [[event.time for event in one.events] for one in (run, exact)]
    assert times[0] == pytest.approx(times[1], abs=1e-10)  # 24 for 3 before
    np.testing.assert_allclose(run["p.T"], exact["p.T"], rtol=0, atol=1e-10)  # 2e-8 before


@pytest.mark.parametrize("settings", [{}, {"macro_step": 0.1}, {"threads": True}], ids=str)
def test_the_first_violation_of_a_condition_in_a_part_is_reported(settings):
    """x = cos t is below -0.5 from 2 pi / 3 on; a step beyond that is repeated."""
    system = cosim.couple({"plant": swing(), "b": follower()}, {"plant.u": "b.y", "b.u": "plant.x"})
    run = system.simulate(stop_time=3.0, **settings)
    assert run.stats["invalid"] == ["invalid from 2.0944 s: plant: not fulfilled: x is high"]
    assert run.validity[0] == pytest.approx(2 * np.pi / 3, abs=1e-6)
    assert "invalid" not in system.simulate(stop_time=2.0, **settings).stats


@pytest.mark.slow_rows("settings0")
@pytest.mark.parametrize("settings", [{}, {"macro_step": 0.01}])
def test_request_and_acknowledgement_at_one_instant_count_once(settings):
    """The request is 0, 1, 0 and the acknowledgement too; both sides count."""
    client, server = cosim.Model("client", stop_time=1.5), cosim.Model("server", stop_time=1.5)
    clock, request = client.state("c", "1", 0.0, "clock"), client.discrete("q", "1", 0.0, "request")
    done, answer = client.discrete("n", "1", 0.0, "count"), client.input("a", "1", 0.0, "answer")
    client.derivative(clock, 1.0)
    client.when(clock > 0.7, {request: 1}, name="ask")
    client.when(answer > 0.5, {request: 0, done: done + 1}, name="done")
    asked, served = server.input("q", "1", 0.0, "request"), server.discrete("k", "1", 0.0, "count")
    server.when(asked > 0.5, {served: served + 1}, name="serve")
    server.output("a", "1", ca.if_else(asked > 0.5, 1, 0), "answer")
    parts = {"c": client.freeze(), "s": server.freeze()}
    system = cosim.couple(parts, {"c.a": "s.a", "s.q": "c.q"})
    for run in (system.simulate(stop_time=1.5, **settings), cosim.simulate(system.dae)):
        final = [run.final[name] for name in ("c.q", "s.a", "c.n", "s.k")]
        assert final == [0, 0, 1, 1]


def test_the_interface_error_of_given_steps_tells_of_jumps_of_held_inputs(tmp_path):
    parts, wires = sampled()
    files = {n: str(cosim.export_fmu(p, tmp_path / f"{n}.fmu")) for n, p in parts.items()}
    system = cosim.couple(files, wires, abilities=dict.fromkeys(files, "no event mode"))
    run = system.simulate(stop_time=STOP, macro_step=0.01, method="iterated")
    jump = np.abs(np.diff(run["c.u"])).max()
    size = 2 * np.abs(run["c.u"]).max() + 1
    assert run.stats["interface_error"] > jump / size  # 1e-13 before


def test_a_sample_that_rounding_puts_beside_a_macro_step_ends_it():
    """The third one is at 0.3 s, and 3 times 0.1 s is 0.30000000000000004 s."""
    parts, wires = sampled()
    run = cosim.couple(parts, wires).simulate(macro_step=0.1, stop_time=0.4)
    assert run.stats["macro_steps"] == 4  # 5 before, one of 6e-17 s


def timer(name, level, rate):
    """A relay that charges and discharges: two events in a macro step of 0.5 s."""
    model = cosim.Model(name, stop_time=2.0, output_interval=0.1)
    u, x = model.input("u", "1", 0.0, "u"), model.state("x", "1", 0.0, "charge")
    q = model.discrete("q", "1", 1.0, "state")
    model.derivative(x, rate * q - x + 0.3 * ca.sin(u))
    model.when(x > level, {q: 0}, name="off")
    model.when(x < level / 2, {q: 1}, name="on")
    return model.freeze()


@pytest.mark.slow_rows("{'accuracy': 1e-06}")
@pytest.mark.parametrize("settings", [{"accuracy": 1e-6}, {"macro_step": 0.5}], ids=str)
def test_the_order_of_parts_with_events_changes_no_bit(settings):
    parts = {"a": timer("a", 0.8, 3.0), "b": timer("b", 0.5, 4.0), "c": timer("c", 0.6, 5.0)}
    wires = {"a.u": "c.x", "b.u": "a.x", "c.u": "b.x"}
    first, second = (
        cosim.couple(own, wires).simulate(**settings)
        for own in (parts, dict(reversed(parts.items())))
    )
    assert first.events == second.events
    for name in first.names:
        np.testing.assert_array_equal(first[name], second[name])


@pytest.mark.parametrize("method", ["jacobi", "gauss_seidel"])
def test_a_macro_step_holds_more_than_a_thousand_events(method):
    """'It failed at 0 s' before."""
    saw, lag = part("saw"), part("lag")
    x, u = saw.state("x", "1", 0.0, "x"), saw.input("u", "1", 0.0, "u")
    n = saw.discrete("n", "1", 0.0, "number of teeth")
    saw.derivative(x, 1 + 0 * u)
    saw.when(x > 0.001, {x: x - 0.001, n: n + 1}, name="tooth")
    w = lag.state("w", "1", 0.0, "w")
    lag.derivative(w, lag.input("u", "1", 0.0, "u") - w)
    system = cosim.couple({"a": saw.freeze(), "b": lag.freeze()}, {"b.u": "a.x", "a.u": "b.w"})
    run = system.simulate(macro_step=1.5, stop_time=3.0, output_interval=1.5, method=method)
    np.testing.assert_allclose(run["a.n"], [0, 1500, 3000], atol=1)


@pytest.mark.parametrize(("start", "accuracy"), [(1e5, 2e-6), (5e5, 1e-5), (-5e5, 1e-5)])
def test_an_event_that_a_part_tells_to_rounding_of_a_late_time_is_one_instant(start, accuracy):
    """Endless macro steps of 8 roundings of the time before."""
    system = cosim.couple(*ball())
    times = {"start_time": start, "stop_time": start + 1, "output_interval": 0.05}
    run = system.simulate(accuracy=accuracy, **times)
    early = system.simulate(accuracy=accuracy, stop_time=1.0, output_interval=0.05)
    assert len(run.events) == len(early.events) == 1
    np.testing.assert_allclose(run["ball.x"], early["ball.x"], rtol=0, atol=1e-8)
