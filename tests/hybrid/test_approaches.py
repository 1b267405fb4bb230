"""Arguments that only approach their boundary, or that an input keeps there."""

from functools import cache

import casadi as ca
import numpy as np
import pytest
from helpers.hybrid_engines import ENGINES, run_on

import cosim


@cache
def approaching():
    """Return x = level (1 - exp(-k t)), and how often and how long it is at its level, or above."""
    model = cosim.Model("approaching", stop_time=60.0, output_interval=0.6)
    k = model.parameter("k", "1/s", 1.0, "rate")
    level = model.parameter("level", "1", 1.0, "limit of x")
    x = model.state("x", "1", 0.0, "argument")
    model.derivative(x, k * (level - x))
    for name, law in {"above": x > level, "reached": x >= level}.items():
        times = model.discrete(name, "1", 0.0, "how often")
        model.when(law, {times: times + 1})
        model.derivative(model.state(f"{name}_for", "s", 0.0, "how long"), ca.if_else(law, 1, 0))
    return model.freeze()


def assert_only_approached(engine, rates, levels, laws):
    for k in rates:
        for level in levels:
            final = run_on(engine, approaching(), start_values={"k": k, "level": level}).final
            found = {n: final[n] for law in laws for n in (law, f"{law}_for")}
            assert not any(found.values()), (k, level, found)


def test_what_only_approaches_its_boundary_does_not_cross_it():
    assert_only_approached("dop853", (1.4, 2.3), (1.0,), ("above", "reached"))


def test_what_the_rounding_of_its_size_is_near_a_boundary_does_not_cross_it():
    """At output times, dop853 is as near as rounding of the nominal value, and falls."""
    for k, level in (
        (2.979945627733344, 0.031047085410296493),
        (9.915045291766724, 3.6682700766425477e-4),
    ):
        assert_only_approached("dop853", (k,), (level,), ("above",))


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["dop853", "rosenbrock"])
def test_what_approaches_at_random_rates_crosses_its_boundary_in_no_run(engine):
    random = np.random.default_rng(1)
    for _ in range(200):
        k, level = 10 ** random.uniform(-0.5, 1.3), 10 ** random.uniform(-4, 5)
        assert_only_approached(engine, (k,), (level,), ("above",))


EXCHANGED = [e for e in ENGINES if " me " in e]


@pytest.mark.parametrize("engine", EXCHANGED)
def test_what_approaches_does_not_cross_by_the_errors_of_an_importer(engine):
    """9 of 10 runs with fmpy were at their levels too early, or had events without end."""
    assert_only_approached(engine, (1.4, 7.3), (0.3, 2.9), ("above", "reached"))


@pytest.mark.parametrize("engine", ["dop853", *EXCHANGED])
def test_what_an_input_stops_on_its_boundary_is_there(engine):
    """The input is set where the argument reaches its boundary: the value counts."""
    model = cosim.Model("stopped", stop_time=2.0, output_interval=0.25)
    x, y = model.state("x", "1", 0.0, "argument"), model.state("y", "s", 0.0, "how long")
    model.derivative(x, model.input("u", "1/s", 1.0, "rate"))
    model.derivative(y, ca.if_else(x >= 1, 1, 0))
    run = run_on(engine, model.freeze(), inputs={"u": "where(t < 1, 1, 0)"})
    assert run.final["y"] == pytest.approx(1, abs=1e-9)


NATIVE = [e for e in ENGINES if not e.startswith("fmu") and e not in ("rk4", "ode8")]


@pytest.mark.slow
@pytest.mark.parametrize("engine", NATIVE)
def test_what_approaches_at_many_rates_crosses_in_no_native_run(engine):
    """Fixed steps are too long for most of these rates, and say so; rounding may reach a level."""
    assert_only_approached(engine, (0.6, 1.4, 2.8, 7.3), (1e-3, 1.0, 1e4), ("above",))


@cache
def overdamped():
    """Return a motion to its level without overshoot, and how often it is above, or below."""
    model = cosim.Model("overdamped", stop_time=40.0, output_interval=0.4)
    a, b = (model.parameter(name, "1/s", 1.0, "rate") for name in "ab")
    level = model.parameter("level", "1", 1.0, "limit of x")
    x, v = model.state("x", "1", 0.0, "place"), model.state("v", "1/s", 0.0, "speed")
    model.derivative(x, v)
    model.derivative(v, -(a + b) * v - a * b * (x - level))
    for name, law in {"above": x > level, "reached": x >= level, "below": x < level}.items():
        times = model.discrete(name, "1", 0.0, "how often")
        model.when(law, {times: times + 1})
    return model.freeze()


@pytest.mark.parametrize(
    ("engine", "a", "ratio", "level"),
    [
        ("rosenbrock", 6.5256767860084235, 2.0, 368.8918138916971),
        ("fmu2 cs c", 9.442477103566679, 1.1, -71.47159701482497),
    ],
)
def test_noise_that_decays_before_it_is_beyond_rounding_does_not_cross(engine, a, ratio, level):
    values = {"a": a, "b": a * ratio, "level": level}
    final = run_on(engine, overdamped(), start_values=values).final
    assert not any(final[name] for name in ("above", "reached", "below"))


@cache
def approaching_beside_a_line():
    """Return x = level (1 - exp(-k t)) and y = level t / due, and how often both are above it."""
    model = cosim.Model("beside", stop_time=60.0, output_interval=0.6)
    k, due = model.parameter("k", "1/s", 1.0, "rate"), model.parameter("due", "s", 45.0, "time")
    level = model.parameter("level", "1", 1.0, "limit of x")
    x, y = model.state("x", "1", 0.0, "argument"), model.state("y", "1", 0.0, "line")
    model.derivative(x, k * (level - x))
    model.derivative(y, level / due)
    laws = {"x_above": x > level, "x_reached": x >= level, "y_above": y > level, "first": y > x}
    for name, law in laws.items():
        times = model.discrete(name, "1", 0.0, "how often")
        model.when(law, {times: times + 1}, name=name)
    return model.freeze()


@pytest.mark.parametrize(
    ("engine", "k", "due", "level"),
    [
        ("dop853", 1.0, 45.0, 1.0),
        ("cvodes", 1.0, 45.0, 100.0),
    ],
)
def test_what_is_approached_does_not_cross_where_another_relation_does(engine, k, due, level):
    values = {"k": k, "due": due, "level": level}
    run = run_on(engine, approaching_beside_a_line(), start_values=values)
    assert run.final["x_above"] == run.final["x_reached"] == 0
    (time,) = (event.time for event in run.events if event.name == "y_above")
    assert time == pytest.approx(due, abs=1e-6)


@pytest.mark.slow
def test_a_run_in_which_noise_leaves_a_boundary_again_and_again_ends():
    """The fast one of two decays turns the slow one back at once: no event, and no endless loop."""
    model = cosim.Model("overdamped", stop_time=25.0, output_interval=0.6)
    x, v = model.state("x", "m", 0.0, "place"), model.state("v", "m/s", 0.0, "speed")
    model.derivative(x, v)
    model.derivative(v, -8 * 15 * v - 15**2 * (x - 1e-3))
    y = model.state("y", "s", 0.0, "time above")
    model.derivative(y, ca.if_else(x > 1e-3, 1, 0))
    run = cosim.simulate(model.freeze(), solver="dop853")
    assert run.final["x"] == pytest.approx(1e-3, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("fmi", [2, 3])
def test_an_input_that_moves_along_with_a_state_is_rejected_in_model_exchange(fmi):
    model = cosim.Model("along", stop_time=1.0, output_interval=0.1)
    u = model.input("u", "1", 0.0, "input")
    x, y = model.state("x", "1", 0.0, "time"), model.state("y", "1", 0.0, "time of u >= x")
    model.derivative(x, 1)
    model.derivative(y, ca.if_else(u >= x, 1, 0))
    dae = model.freeze()
    assert run_on(f"fmu{fmi} cs fmpy", dae, inputs={"u": "t"}).final["y"] == pytest.approx(1)
    for formula, right in {"0": 0, "t/2": 0, "2*t": 1}.items():
        run = run_on(f"fmu{fmi} me fmpy", dae, inputs={"u": formula})
        assert run.final["y"] == pytest.approx(right, abs=1e-9)
    with pytest.raises(cosim.CosimError, match="use co-simulation, or compute it in the model"):
        run_on(f"fmu{fmi} me fmpy", dae, inputs={"u": "t"})
