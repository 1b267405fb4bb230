"""Parts for model exchange only: the master integrates them, with every method and their events."""

import math
import re
import sys

import casadi as ca
import numpy as np
import pytest
from helpers.exchange_only import WITHOUT_STATE, exchange_only
from helpers.fmu_files import set_attributes, with_description
from helpers.foreign_part import foreign_part
from helpers.wrapped import wrapped
from scipy.linalg import expm

import cosim
from cosim.errors import SolverError, UsageError

TIMES = {"output_interval": 0.05}
STRAIGHT = [("jacobi", 9e-2), ("gauss_seidel", 3e-2), ("extrapolated", 5e-5), ("iterated", 2e-6)]


def oscillator():
    model = cosim.Model("oscillator")
    x, v = model.state("x", "m", 1.0, "place"), model.state("v", "m/s", 0.0, "speed")
    f = model.input("f", "N", 0.0, "force")
    model.derivative(x, v)
    model.derivative(v, -4 * x - 0.1 * v + f)
    model.output("y", "N", 3 * x, "three times x")
    return model.freeze()


def support():
    model = cosim.Model("support")
    z, u = model.state("z", "N", 0.0, "force"), model.input("u", "N", 0.0, "load")
    model.derivative(z, u - z)
    model.output("w", "N", 0.2 * u - z, "reaction, which feels the load at once")
    return model.freeze()


def exact(times):
    """x, v, z: w = 0.6 x - z acts on the oscillator."""
    matrix = np.array([[0, 1, 0], [-3.4, -0.1, -1], [3, 0, -1]])
    return np.array([expm(matrix * t)[:, 0] for t in times])


@pytest.fixture(scope="module", params=[2, 3], ids=["fmi2", "fmi3"])
def files(request, tmp_path_factory):
    """Return what exports a model for model exchange only, once."""
    folder, known = tmp_path_factory.mktemp("exchange"), {}

    def exported(build, attributes=()):
        key = build, tuple(attributes)
        if key not in known:
            path = folder / f"{build.__name__}.fmu"
            cosim.export_fmu(build(), path, fmi=request.param)
            known[key] = exchange_only(path, **dict(attributes))
        return known[key]

    return exported


def coupled(motor, load, **options):
    wires = {"load.u": "motor.y", "motor.f": "load.w"}
    return cosim.couple({"motor": motor, "load": load}, wires, stop_time=5, **TIMES, **options)


def error_of(run):
    x, _, z = exact(run.time).T
    return max(np.abs(run["motor.x"] - x).max(), np.abs(run["load.z"] - z).max())


STATES = {"motor.x", "load.z"}


@pytest.mark.quick_share(0.3)
@pytest.mark.slow_rows("fmi2-jacobi-0.09-state", "fmi3-jacobi-0.09-state")
@pytest.mark.parametrize("attributes", [{}, WITHOUT_STATE], ids=["state", "without"])
@pytest.mark.parametrize(("method", "bound"), STRAIGHT)
def test_every_method_steps_parts_for_model_exchange(method, bound, attributes, files):
    parts = files(oscillator, attributes.items()), files(support)
    step = 0.01 if method in ("jacobi", "gauss_seidel") else 0.05
    run = coupled(*parts).simulate(method=method, macro_step=step, outputs=sorted(STATES))
    assert error_of(run) < bound  # measured 8.3e-2, 2.5e-2, 4.3e-5, 1.6e-6


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("attributes", [{}, WITHOUT_STATE], ids=["state", "without"])
@pytest.mark.parametrize("accuracy", [1e-3, 1e-6, 1e-9])
def test_accuracy_is_kept_beside_a_model(accuracy, attributes, files):
    system = coupled(files(oscillator, attributes.items()), support())
    run = system.simulate(accuracy=accuracy, outputs=sorted(STATES))
    assert error_of(run) < accuracy  # measured 6.5e-8 for 1e-6, 6.5e-11 for 1e-9
    assert run.stats["order"]["motor"] == "cubic inputs, events end macro steps"


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize(
    ("words", "macro_steps"),
    [
        ("no rates", 600),
        ("no rollback", 600),
        pytest.param("no interpolation", 700, marks=pytest.mark.slow),
    ],
)
def test_abilities_of_the_master_s_solver_can_be_switched_off(words, macro_steps, files):
    system = coupled(files(oscillator), support(), abilities={"motor": words})
    run = system.simulate(accuracy=1e-6, outputs=sorted(STATES))
    assert error_of(run) < 1e-6  # measured 8.7e-9, 5.9e-8, 5.2e-9
    assert run.stats["macro_steps"] < macro_steps  # measured 367, 236, 450


def test_threads_give_the_same_bits(files):
    system = coupled(files(oscillator), files(support))
    runs = [system.simulate(accuracy=1e-6, threads=threads) for threads in (False, True)]
    assert runs[0].values.tobytes() == runs[1].values.tobytes()


def ball():
    model = cosim.Model("ball")
    h, v = model.state("h", "m", 1.0, "height"), model.state("v", "m/s", 0.0, "speed")
    model.derivative(h, v)
    model.derivative(v, -9.81 + model.input("u", "1", 0.0, "wind"))
    model.when(h < 0, {v: -0.7 * v}, name="impact")
    model.output("y", "1", h, "height")
    return model.freeze()


def thermostat():
    model = cosim.Model("thermostat")
    u, on = model.input("u", "1", 0.0, "temperature"), model.discrete("on", "1", 1, "heats")
    model.when(u > 0.6, {on: 0}, name="off")
    model.when(u < 0.4, {on: 1}, name="on")
    model.derivative(model.state("q", "1", 0.0, "heat"), on)
    model.output("y", "1", 1.0 * on, "power")
    return model.freeze()


def sampler():
    model = cosim.Model("sampler")
    u, held = model.input("u", "1", 0.0, "temperature"), model.discrete("held", "1", 0, "power")
    model.every(0.13, {held: 0.8 - u}, name="sample")
    model.derivative(model.state("q", "1", 0.0, "heat"), held)
    model.output("y", "1", 1.0 * held, "power")
    return model.freeze()


def room():
    model = cosim.Model("room")
    T, u = model.state("T", "1", 0.0, "temperature"), model.input("u", "1", 0.0, "power")
    model.derivative(T, u - 0.5 * T)
    model.output("y", "1", T, "temperature")
    return model.freeze()


EVENTS = [(ball, 0.8, 1), (thermostat, 5.0, 8), (sampler, 5.0, 39)]
WAYS = [
    {"accuracy": 1e-6},
    {"macro_step": 0.05},
    {"method": "extrapolated", "macro_step": 0.05},
]


@pytest.mark.quick_share(0.3)
@pytest.mark.slow_rows(
    "fmi2-ball---state-{'accuracy': 1e-06}",
    "fmi2-thermostat---state-{'accuracy': 1e-06}",
    "fmi3-ball---state-{'accuracy': 1e-06}",
    "fmi2-ball---state-{'macro_step': 0.05}",
    "fmi2-sampler---state-{'accuracy': 1e-06}",
    "fmi2-thermostat---state-{'macro_step': 0.05}",
    "fmi3-ball---state-{'macro_step': 0.05}",
    "fmi3-sampler---state-{'accuracy': 1e-06}",
)
@pytest.mark.parametrize("way", WAYS, ids=str)
@pytest.mark.parametrize("attributes", [{}, WITHOUT_STATE], ids=["state", "without"])
@pytest.mark.parametrize(
    ("build", "stop", "count"), EVENTS, ids=lambda v: getattr(v, "__name__", "")
)
def test_events_of_states_times_and_inputs_end_macro_steps(
    build, stop, count, attributes, way, files
):
    wires = {"room.u": "part.y", "part.u": "room.y"}
    whole = cosim.couple({"part": build(), "room": room()}, wires, stop_time=stop, **TIMES)
    wanted = cosim.simulate(whole.dae, relative_tolerance=1e-11, stop_time=stop, **TIMES)
    parts = {"part": files(build, attributes.items()), "room": files(room)}
    run = cosim.couple(parts, wires, stop_time=stop, **TIMES).simulate(**way)
    assert np.abs(run["room.T"] - wanted["room.T"]).max() < 1e-5  # measured 4e-6 at most
    assert len(run.events) == count


@pytest.mark.slow
@pytest.mark.parametrize("method", ["jacobi", "gauss_seidel"])
@pytest.mark.parametrize(
    ("build", "stop", "count"), EVENTS, ids=lambda v: getattr(v, "__name__", "")
)
def test_events_happen_within_the_steps_of_methods_of_order_1(build, stop, count, method, files):
    wires = {"room.u": "part.y", "part.u": "room.y"}
    whole = cosim.couple({"part": build(), "room": room()}, wires, stop_time=stop, **TIMES)
    wanted = cosim.simulate(whole.dae, stop_time=stop, **TIMES)
    parts = {"part": files(build), "room": files(room)}
    system = cosim.couple(parts, wires, stop_time=stop, **TIMES)
    run = system.simulate(method=method, macro_step=0.001)
    assert np.abs(run["room.T"] - wanted["room.T"]).max() < 0.03
    assert len(run.events) == pytest.approx(count, abs=1)


def lamp(folder):
    """Return a file whose discrete input is an error outside event mode."""
    model = cosim.Model("lamp")
    u, f = model.input("u", "1", 0.0, "switch"), model.input("f", "1", 0.0, "force")
    model.derivative(model.state("x", "1", 0.0, "state"), u + f)
    path = wrapped(
        folder,
        dae=model.freeze(),
        fmi2EnterContinuousTimeMode="limit = 1; return CALL;",
        fmi2EnterEventMode="limit = 0; return CALL;",
        fmi2SetFMUstate="limit = 1; return CALL;",
        fmi2SetReal="for (size_t i = 0; i < n; i++) if (limit && vr[i] == REF(u)) return fmi2Error;"
        " return CALL;",
    )
    edit = set_attributes("ModelVariables/*[@name='u']", variability="discrete")
    return exchange_only(with_description(path, folder / "lamp.fmu", edit))


def blinker():
    model = cosim.Model("blinker")
    d, t = model.discrete("d", "1", 0, "is on"), model.state("t", "1", 0.0, "time")
    model.derivative(t, 1)
    model.every(0.26, {d: 1 - d})
    model.output("y", "1", t, "time")
    return model.freeze()


@pytest.fixture(scope="module")
def lamps(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lamps")
    path = cosim.export_fmu(blinker(), folder / "blinker.fmu", fmi=2)
    return {"lamp": lamp(folder), "events": blinker(), "no event mode": path}


@pytest.mark.parametrize(
    "way",
    [
        {"accuracy": 1e-6},
        {"macro_step": 0.02},
        {"method": "extrapolated", "macro_step": 0.02},
        {"method": "gauss_seidel", "macro_step": 0.01},
        {"method": "jacobi", "macro_step": 0.01},
    ],
    ids=lambda way: "-".join(map(str, way.values())),
)
@pytest.mark.parametrize("source", ["events", "no event mode"])
def test_discrete_inputs_are_set_in_event_mode(source, way, lamps):
    parts = {"lamp": lamps["lamp"], "blinker": lamps[source]}
    wires = {"lamp.u": "blinker.d", "lamp.f": "blinker.y"}
    abilities = {"blinker": source} if source.startswith("no ") else {}
    run = cosim.couple(parts, wires, stop_time=1.0, abilities=abilities).simulate(**way)
    late = way["macro_step"] / 2 if way.get("method") in ("gauss_seidel", "jacobi") else 0.0
    lit = 0.26 + 0.26  # from 0 and from 0.52 s on
    assert run.final["lamp.x"] == pytest.approx(lit + 0.5 - late, rel=1e-9)


def test_discrete_inputs_wait_for_event_mode_after_a_run_that_ended_in_it(lamps):
    model = cosim.Model("clock")
    t = model.state("t", "1", 0.0, "time")
    model.derivative(t, 1)
    model.stop(t > 0.6, "it is late")
    parts = {"lamp": lamps["lamp"], "blinker": blinker(), "clock": model.freeze()}
    wires = {"lamp.u": "blinker.d", "lamp.f": "blinker.y"}
    with cosim.open(cosim.couple(parts, wires), macro_step=0.02) as session:
        session.advance(to=0.3)
        saved = session.save()
        session.advance(to=1.0)
        assert "it is late" in session.stop
        session.restore(saved)
        session.advance(to=0.5)
        assert session["lamp.x"] == pytest.approx(0.26 + 0.5**2 / 2, rel=1e-9)


@pytest.mark.parametrize("way", [{"accuracy": 1e-6}, {"macro_step": 0.02}], ids=str)
def test_table_drives_a_discrete_input_for_model_exchange(way, lamps, tmp_path):
    table = tmp_path / "u.csv"
    table.write_text("time,lamp.u\n0,0\n0.3,2\n0.7,0\n1,0\n")
    system = cosim.couple({"lamp": lamps["lamp"]}, {}, stop_time=1.0)
    run = system.simulate(inputs=cosim.read_inputs(table), **way)
    assert run.final["lamp.x"] == pytest.approx(2 * 0.4, rel=1e-9)


def test_event_mode_cannot_be_switched_off(files):
    system = coupled(files(oscillator), support(), abilities={"motor": "no event mode"})
    with pytest.raises(UsageError, match="part 'motor' is for model exchange, which always has"):
        system.simulate()


LAGS = {"motor.u": "load.y", "load.u": "motor.y"}
EVERY_WAY = [{"method": method, "macro_step": 0.01} for method, _ in STRAIGHT]
EVERY_WAY += [{"method": method, "accuracy": 1e-4} for method in ("extrapolated", "iterated")]
linux = pytest.mark.skipif(sys.platform != "linux", reason="it compiles for linux64")


@pytest.mark.quick_share(0.3)
@linux
@pytest.mark.parametrize("way", EVERY_WAY, ids=lambda way: "-".join(map(str, way.values())))
@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("return 2", "fmi2GetDerivatives returned 2 (discard)"),
        ("return 3", "fmi2GetDerivatives returned 3 (error)"),
        ("return 4", "fmi2GetDerivatives returned 4 (fatal)"),
        ("return -7", "fmi2GetDerivatives returned -7 (no status of the FMI)"),
        ("self->x = NAN", "the integration (step size too small, or too many steps) failed"),
    ],
)
def test_part_that_fails_is_named_with_what_it_did(fault, words, way, tmp_path):
    bad = foreign_part(tmp_path, "lag", interface="ModelExchange", fault=f"if (time > 0.4) {fault}")
    parts = {"motor": bad, "load": foreign_part(tmp_path, "lag")}
    system = cosim.couple(parts, LAGS, start_values={"motor.x": 1.0}, stop_time=1.0, **TIMES)
    with pytest.raises(
        SolverError, match=rf"part 'motor' failed after .*{re.escape(words)}"
    ) as caught:
        system.simulate(**way)
    assert np.isfinite(caught.value.partial.values).all()


@linux
@pytest.mark.parametrize("state", ["true", "false"])
def test_foreign_part_steps_once_if_nothing_takes_it_back(state, tmp_path):
    """Without states that are saved, a part that wants to know each step cannot go back."""
    part = foreign_part(tmp_path, "lag", interface="ModelExchange", canGetAndSetFMUstate=state)
    parts = {"motor": part, "load": foreign_part(tmp_path, "lag")}
    system = cosim.couple(parts, LAGS, start_values={"motor.x": 1.0}, stop_time=1.0, **TIMES)
    run = system.simulate(accuracy=1e-4)
    assert run.final["motor.y"] == pytest.approx((1 + math.exp(-2)) / 2, abs=1e-6)
    assert ("motor cannot restore a state" in run.stats.get("note", "")) == (state == "false")


def driven_lag(folder, law, output, time=1.0):
    """Return a part for model exchange with x' = law(x), and a lag of its output(x, t)."""
    source, lag = (cosim.Model(name, stop_time=time, output_interval=time / 10) for name in "ab")
    x, _ = source.state("x", "1", 0.0, "state"), source.input("u", "1", 0.0, "input")
    source.derivative(x, law(x))
    source.output("y", "1", output(x, source.t), "output")
    w, u = lag.state("w", "1", 0.0, "state"), lag.input("u", "1", 0.0, "input")
    lag.derivative(w, (u - w) / time)
    file = exchange_only(cosim.export_fmu(source.freeze(), folder / "a.fmu", fmi=2))
    return cosim.couple({"a": file, "b": lag.freeze()}, {"b.u": "a.y"})


@pytest.mark.parametrize("start", [0.0, 1e-14, 1e-10, 1e-8, 0.1])
def test_rates_of_outputs_are_those_of_states_near_zero_too(start, tmp_path):
    """From 1e-14, differences over 1e-16 s gave no rate of 300 + x: 7.8e-4 off."""
    system = driven_lag(tmp_path, lambda x: 1 + 0 * x, lambda x, t: 300 + x)
    lag = {"a.x": start, "b.w": 300}
    run = system.simulate(macro_step=0.1, start_values=lag)
    t, x = run.time, start
    exact = 300 + x * (1 - np.exp(-t)) + t - 1 + np.exp(-t)
    np.testing.assert_allclose(run["b.w"], exact, rtol=0, atol=1e-8)  # measured 7e-10


def test_rates_of_outputs_do_not_round_late_times(tmp_path):
    """Rates of sin(t) were 5e-5 off, so that 286 macro steps were needed."""
    late = 1e6
    system = driven_lag(tmp_path, lambda x: -x, lambda x, t: ca.sin(3 * (t - late)))
    run = system.simulate(start_time=late, stop_time=late + 1, accuracy=1e-6)
    t = run.time - late
    exact = (np.sin(3 * t) - 3 * np.cos(3 * t) + 3 * np.exp(-t)) / 10
    assert np.abs(run["b.w"] - exact).max() <= run.stats["error_estimate"]
    assert run.stats["macro_steps"] < 80  # measured 58


@pytest.mark.parametrize("scale", [1.0, 1e9, 1e12])
def test_rates_of_outputs_follow_the_time_scale_of_a_part(scale, tmp_path):
    """At 1e12 s, states moved by 1e-17 in a difference: 2.9e-5 off."""
    system = driven_lag(tmp_path, lambda x: (1 - x) / scale, lambda x, t: 1 + x, scale)
    run = system.simulate(macro_step=scale / 50)
    s = run.time / scale
    exact = 2 - (2 + s) * np.exp(-s)
    np.testing.assert_allclose(run["b.w"], exact, rtol=0, atol=1e-8)
