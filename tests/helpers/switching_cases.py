"""Hybrid cases of switches, samplers, relays and chains, in closed form."""

import math

import casadi as ca
from helpers.hybrid_cases import Case

import cosim


def integral(model, law, start=0.0, name="y"):
    """Return the integral of a law."""
    y = model.state(name, "1", start, "integral")
    model.derivative(y, law(y) if callable(law) else law)
    return y


def counter(model, name="n", start=0.0):
    """Return a discrete variable."""
    return model.discrete(name, "1", start, "count")


def series(*points):
    """Return an input u through points (time, value)."""
    time, values = zip(*points, strict=True)
    return cosim.InputSeries(("u",), time, [[float(value)] for value in values])


def times(name, period, stop, offset=0.0):
    """Return the samples of a period up to and with a stop time."""
    count = math.floor((stop - offset) / period * (1 + 1e-12)) + 1
    return tuple((offset + i * period, name) for i in range(count))


# Samplers


def every(period, offset=0.0):
    """Return what builds a counter of samples."""

    def build(model):
        n = counter(model)
        integral(model, n)
        model.every(period, {n: n + 1}, offset=offset, name="sample")

    return build


def two_samplers(model):
    """Two counters of the same variable, with periods of 0.2 s and 0.3 s."""
    n = counter(model)
    model.every(0.2, {n: n + 1}, name="fast")
    model.every(0.3, {n: n + 100}, name="slow")
    integral(model, 0)


def sampler_of_sampler(model):
    """The second takes the values before the instant at which both are due."""
    n, m = counter(model), counter(model, "m")
    model.every(1.0, {n: n + 1}, name="first")
    model.every(1.0, {m: n}, name="second")
    integral(model, m)


def controlled(model):
    u = counter(model, "u")
    x = integral(model, u, 1.0, "x")
    model.every(0.1, {u: -2 * x}, name="control")


def period_of_parameter(model):
    n, period = counter(model), model.parameter("T", "s", 1.0, "period")
    integral(model, n)
    model.every(period, {n: n + 1}, name="sample")


def sample_and_time(model):
    """A sample takes the value before an event at its instant."""
    a, b = counter(model, "a"), counter(model, "b")
    model.when(model.t >= 1, {a: 5}, name="step")
    model.every(1.0, {b: a}, name="sample")
    integral(model, b)


def sample_and_row(model):
    held, u = counter(model, "held"), model.input("u", "1", 0.0, "u")
    model.every(0.5, {held: u}, name="sample")
    integral(model, held)


def sample_at_rest(model):
    """A sample takes the sign of a speed that friction has brought to rest at its time."""
    v = integral(model, lambda v: -ca.sign(v), 2.0, "v")
    held = counter(model, "held")
    model.every(1.0, {held: ca.sign(v)}, name="sample")
    integral(model, held)


def event_and_row(model):
    held, u = counter(model, "held"), model.input("u", "1", 0.0, "u")
    model.when(model.t >= 1, {held: u}, name="event")
    integral(model, held)


def gate(condition):
    """Return what builds a counter of a condition of an input."""

    def build(model):
        n, u = counter(model), model.input("u", "1", 0.0, "u")
        model.when(condition(u), {n: n + 1}, name="event")
        integral(model, n)

    return build


# Relays


def relay(model):
    u = counter(model, "u", 1.0)
    x = integral(model, u, 0.0, "x")
    model.when(x > 1, {u: -1}, name="upper")
    model.when(x < -1, {u: 1}, name="lower")


def thermostat(model):
    u = counter(model, "u", 1.0)
    x = integral(model, lambda x: 2 * u - x, 1.0, "x")
    model.when(x > 1.5, {u: 0}, name="off")
    model.when(x < 0.5, {u: 1}, name="on")


_OFF, _DOWN, _UP = math.log(2), math.log(3), math.log(3)


def sliding(model):
    x = integral(model, lambda x: 0.5 - ca.sign(x), 1.0, "x")
    integral(model, ca.sign(x))


def sliding_released(model):
    x = integral(model, lambda x: model.t / 2 - ca.sign(x), 0.0, "x")
    integral(model, ca.sign(x))


def sliding_released_by_event(model):
    """What slides at 0 is released by an event that changes a discrete variable."""
    push = counter(model, "push")
    integral(model, lambda x: push - ca.sign(x), 1.0, "x")
    model.when(model.t >= 2, {push: 3}, name="push")


def sliding_on_both(model):
    integral(model, lambda x: -ca.sign(x), 1.0, "x")
    integral(model, lambda x: -ca.sign(x), 2.0)


def three_ways(model):
    """Leaves 0 in the direction of a push, against a relay; the other side is not touched."""
    integral(model, lambda x: 1.5 - ca.sign(x), 0.0, "x")
    integral(model, lambda x: -1.5 - ca.sign(x))


# Resets, chains, conditions


def reset(model):
    x = integral(model, 1, 0.0, "x")
    model.when(x > 1, {x: 0}, name="reset")


def reset_beyond(model):
    """A reset that leaves its own condition true happens once."""
    x = integral(model, 1, 0.0, "x")
    model.when(x > 1, {x: x + 0.5}, name="jump")


def chain(model):
    a, b, c = (counter(model, name) for name in "abc")
    model.when(model.t >= 1, {a: 1}, name="first")
    model.when(a > 0.5, {b: 1}, name="second")
    model.when(b > 0.5, {c: 1}, name="third")
    integral(model, c)


def chain_of_state(model):
    """An event of a state, whose new value makes an event of another, and that one a stop."""
    x, y = integral(model, 1, 0.0, "x"), integral(model, 0)
    n = counter(model)
    model.when(x > 1, {y: 2}, name="first")
    model.when(y > 1, {n: n + 1, y: 0.5}, name="second")
    model.stop(n > 0.5, "done")


def taken_back(model):
    a, n = counter(model, "a"), counter(model)
    model.every(1.0, {a: 1}, name="set")
    model.when(a > 0.5, {a: 0, n: n + 1}, name="take back")
    integral(model, a)


def endless(model):
    a, b = counter(model, "a"), counter(model, "b")
    model.when(model.t >= 1, {a: 1}, name="start")
    model.when(a > 0.5, {a: 0, b: 1}, name="to")
    model.when(b > 0.5, {b: 0, a: 1}, name="fro")
    integral(model, a)


def together(first, second):
    """Return what builds two events at 1 s that assign one variable."""

    def build(model):
        n = counter(model, "n", 3.0)
        model.when(model.t >= 1, {n: first(n)}, name="first")
        model.when(model.t > 1, {n: second(n)}, name="second")
        integral(model, n)

    return build


def both(join):
    """Return what builds a counter of two conditions joined."""

    def build(model):
        x, n = integral(model, 1, 0.0, "x"), counter(model)
        model.when(join(x > 1, model.t > 2), {n: n + 1}, name="event")

    return build


def up_and_down(model):
    x, v = model.state("x", "1", 1, "x"), model.state("v", "1/s", 0, "v")
    model.derivative(x, v)
    model.derivative(v, -x)
    up, down = counter(model, "up"), counter(model, "down")
    model.when(x > 0, {up: up + 1}, name="upwards")
    model.when(x < 0, {down: down + 1}, name="downwards")


def gain(model):
    k = counter(model, "k", 1.0)
    integral(model, lambda x: -k * x, 1.0, "x")
    model.when(model.t >= 1, {k: 2}, name="change")


def algebraic(model):
    """A rate that an equation determines, and that a relation of the state switches."""
    x, n = model.state("x", "1", 0, "x"), counter(model)
    z = model.algebraic("z", "1/s", 1.0, "rate")
    model.derivative(x, z)
    model.equation(z + z**3 - ca.if_else(x < 1, 10, 2))  # z is 2, then 1
    model.when(x > 2, {n: n + 1}, name="event")


# Ends


def stop(condition):
    """Return what builds a motion at 1 m/s that a condition of it and of time ends."""

    def build(model):
        x = integral(model, 1, 0.0, "x")
        model.stop(condition(x, model.t), "done")

    return build


def stop_by_count(model):
    n = counter(model)
    integral(model, n)
    model.every(1.0, {n: n + 1}, name="sample")
    model.stop(n >= 3, "enough")


def stop_with_event(model):
    """An event and a stop at one instant: the event happens, and the run ends."""
    n = counter(model)
    integral(model, 1)
    model.when(model.t >= 1, {n: n + 1}, name="event")
    model.stop(model.t >= 1, "done")


def at(time):
    """Return what builds an event at a time."""

    def build(model):
        n = counter(model)
        integral(model, n)
        model.when(model.t >= time, {n: n + 1}, name="event")

    return build


# Scales of time


def electron(duration):
    """Return what builds x'' = 2 L/T^2, which reaches L at T."""

    def build(model):
        x = model.state("x", "m", 0.0, "place", nominal=1e-6)
        v = model.state("v", "m/s", 0.0, "speed", nominal=1e-6 / duration)
        model.derivative(x, v)
        model.derivative(v, 2e-6 / duration**2)
        model.stop(x > 1e-6, "hit")

    return build


def slow(model):
    """A motion of 1e-9 m/s that passes 0.35 m, and samples each 1e8 s."""
    n, m = counter(model), counter(model, "m")
    x = integral(model, 1e-9, 0.0, "x")
    model.every(1e8, {n: n + 1}, name="sample")
    model.when(x > 0.35, {m: n}, name="event")


def pulse(start, width):
    """Return what builds the momentum of a pulse of 1 N s."""

    def build(model):
        pushed = ca.logic_and(model.t >= start, model.t < start + width)
        integral(model, ca.if_else(pushed, 1 / ((start + width) - start), 0))

    return build


def square_wave(model):
    integral(model, ca.if_else(ca.fmod(model.t, 0.75) < 0.25, 1, -1))


def of_sine(law):
    """Return what builds the integral of a law of sin t, which two states give."""

    def build(model):
        x, v = model.state("x", "1", 0, "x"), model.state("v", "1/s", 1, "v")
        model.derivative(x, v)
        model.derivative(v, -x)
        integral(model, law(x))

    return build


def of_ramp(law):
    """Return what builds the integral of a law of a state that is the time."""

    def build(model):
        integral(model, law(integral(model, 1, 0.0, "x")))

    return build


def draining(model):
    integral(model, lambda x: -1 - ca.sqrt(ca.fmax(x, 0)), 1.0, "x")


_UP_AND_DOWN = (
    (math.pi / 2, "downwards"), (3 * math.pi / 2, "upwards"),
    (5 * math.pi / 2, "downwards"), (7 * math.pi / 2, "upwards"),
)  # fmt: skip
_STEP = series((0, 0), (1, 0), (1, 1), (4, 1))
_SIGNAL = series((0, 0), (1, 0), (1, 1), (2, 1), (2, 0), (3, 0), (3, 1), (4, 1))
_PRESSED = series((0, 0), (1, 1), (4, 1))
_TWICE = ((1.0, "first"), (1.0, "second"))
SWITCHING = {
    "samples": Case(every(0.5), {"n": 9, "y": 18}, times("sample", 0.5, 4)),
    "samples with offset": Case(every(0.5, 0.25), {"n": 8, "y": 16}, times("sample", 0.5, 4, 0.25)),
    "samples of tenths": Case(every(0.1), {"n": 41}, times("sample", 0.1, 4)),
    "samples of thirds": Case(every(1 / 3), {"n": 13}, times("sample", 1 / 3, 4)),
    "samples of sevenths": Case(every(1 / 7), {"n": 29}, times("sample", 1 / 7, 4)),
    "two samplers": Case(
        two_samplers, {"n": 16 + 1100}, times("fast", 0.2, 3) + times("slow", 0.3, 3), stop_time=3.0
    ),
    "sampler of a sampler": Case(
        sampler_of_sampler, {"n": 5, "m": 4, "y": 6}, times("first", 1, 4) + times("second", 1, 4)
    ),
    "sampled control": Case(controlled, {"x": 0.8**40}, times("control", 0.1, 4)),
    "period of a parameter": Case(
        period_of_parameter, {"n": 6, "y": 4 * 5 - 0.8 * 10}, times("sample", 0.8, 4),
        start_values={"T": 0.8},
    ),
    "sample and event": Case(sample_and_time, {"a": 5, "b": 5, "y": 10},
                             ((1.0, "step"), *times("sample", 1, 4))),
    "sample at rest": Case(
        sample_at_rest, {"v": 0, "held": 0, "y": 2}, times("sample", 1, 4)
    ),
    "sample and row": Case(sample_and_row, {"y": 3}, times("sample", 0.5, 4), inputs=_STEP),
    "event and row": Case(event_and_row, {"held": 1, "y": 3}, ((1.0, "event"),), inputs=_STEP),
    "event of a signal": Case(
        gate(lambda u: u > 0), {"n": 2, "y": 4}, ((1.0, "event"), (3.0, "event")), inputs=_SIGNAL
    ),
    "event of a pressed pedal": Case(
        gate(lambda u: u >= 1), {"n": 1, "y": 3}, ((1.0, "event"),), inputs=_PRESSED
    ),
    "no event of a pressed pedal": Case(
        gate(lambda u: u > 1), {"n": 0}, never=("event",), inputs=_PRESSED
    ),
    "event of a released pedal": Case(
        gate(lambda u: u <= 0), {"n": 1}, ((2.0, "event"),),
        inputs=series((0, 1), (2, 0), (4, 0)),
    ),
    "no event of a formula that touches": Case(
        gate(lambda u: u > 1), {"n": 0}, never=("event",), inputs={"u": "1 - (t - 2)**2"}
    ),
    "relay": Case(
        relay, {"x": 0, "u": 1}, ((1.0, "upper"), (3.0, "lower"), (5.0, "upper"), (7.0, "lower")),
        stop_time=8.0,
    ),
    "thermostat": Case(
        thermostat, {"u": 0}, ((_OFF, "off"), (_OFF + _DOWN, "on"), (_OFF + _DOWN + _UP, "off")),
        stop_time=3.5,
    ),
    "sliding": Case(sliding, {"x": 0, "y": 3}),
    "sliding released": Case(sliding_released, {"x": 1, "y": 3}),
    "sliding released by an event": Case(
        sliding_released_by_event, {"x": 4}, ((2.0, "push"),)
    ),
    "sliding on two switches": Case(sliding_on_both, {"x": 0, "y": 0}),
    "leaving a switch": Case(three_ways, {"x": 2, "y": -2}),
    "reset": Case(
        reset, {"x": 0.5}, ((1.0, "reset"), (2.0, "reset"), (3.0, "reset")), stop_time=3.5
    ),
    "reset beyond": Case(reset_beyond, {"x": 4.5}, ((1.0, "jump"),)),
    "chain": Case(chain, {"a": 1, "b": 1, "c": 1, "y": 3}, (*_TWICE, (1.0, "third"))),
    "chain of states": Case(chain_of_state, {"n": 1, "y": 0.5}, _TWICE, end=1.0),
    "taken back": Case(
        taken_back, {"a": 0, "n": 5, "y": 0}, times("set", 1, 4) + times("take back", 1, 4)
    ),
    "endless": Case(endless, error="100|rounds"),
    "two sums": Case(together(lambda n: n + 1, lambda n: n + 10), {"n": 14, "y": 45}, _TWICE),
    "difference and sum": Case(together(lambda n: n - 1, lambda n: 10 + n), {"n": 12}, _TWICE),
    "equal assignments": Case(together(lambda n: 2 * n, lambda n: 6), {"n": 6}, _TWICE),
    "unequal assignments": Case(together(lambda n: 7, lambda n: 6), error="first.*second"),
    "sum and assignment": Case(together(lambda n: n + 1, lambda n: 6), error="first.*second"),
    "both conditions": Case(both(ca.logic_and), {"n": 1}, ((2.0, "event"),)),
    "either condition": Case(both(ca.logic_or), {"n": 1}, ((1.0, "event"),)),
    "up and down": Case(up_and_down, {"up": 2, "down": 2}, _UP_AND_DOWN, stop_time=12.0),
    "gain": Case(gain, {"x": math.exp(-7)}, ((1.0, "change"),)),
    "algebraic unknown": Case(algebraic, {"x": 4.5, "n": 1}, ((1.5, "event"),), algebraic=True),
    "stop at a threshold": Case(stop(lambda x, t: x > 0.777), {"x": 0.777}, end=0.777),
    "stop at a whole threshold": Case(stop(lambda x, t: x >= 1), {"x": 1}, end=1.0),
    "stop at a time": Case(stop(lambda x, t: t >= 1.53), {"x": 1.53}, end=1.53),
    "stop beyond the end": Case(stop(lambda x, t: x > 4.5), {"x": 4}),
    "stop by a count": Case(stop_by_count, {"n": 3, "y": 3}, times("sample", 1, 2), end=2.0),
    "stop with an event": Case(stop_with_event, {"n": 1, "y": 1}, ((1.0, "event"),), end=1.0),
    "event at the end": Case(at(4.0), {"n": 1, "y": 0}, ((4.0, "event"),)),
    "event beyond the end": Case(at(4.0000001), {"n": 0}, never=("event",)),
    "condition that holds at the start": Case(at(0.0), {"n": 0}, never=("event",)),
    "event just after the start": Case(at(1e-9), {"n": 1, "y": 4}, ((1e-9, "event"),)),
    "picosecond": Case(electron(1e-12), {"x": 1e-6}, stop_time=1.51e-12, end=1e-12, within=1e-12),
    "nanosecond": Case(electron(1e-9), {"x": 1e-6}, stop_time=1.51e-9, end=1e-9, within=1e-12),
    "thirty years": Case(
        slow, {"x": 1, "n": 11, "m": 4}, ((3.5e8, "event"), *times("sample", 1e8, 1e9)),
        stop_time=1e9,
    ),
    "pulse": Case(pulse(1.0, 1e-3), {"y": 1}),
    "pulse of a nanosecond": Case(pulse(1.0, 1e-9), {"y": 1}),
    "square wave": Case(square_wave, {"y": -1.0}),
    "fabs": Case(of_sine(ca.fabs), {"y": 4}, stop_time=2 * math.pi),
    "fmax": Case(of_sine(lambda x: ca.fmax(0, x)), {"y": 4}, stop_time=4 * math.pi),
    "fmin": Case(of_ramp(lambda x: ca.fmin(x, 2 - x)), {"y": -1}),
    "floor": Case(of_ramp(ca.floor), {"y": 6}),
    "fmod": Case(of_ramp(lambda x: ca.fmod(x, 0.75)), {"y": 5 * 0.28125 + 0.03125}),
    # sqrt(x) has no derivative at the end of its range: rk4 is 6e-6 off there
    "draining": Case(draining, {"x": -2 + 2 * (1 - math.log(2))}, stop_time=2.0, within=1e-5),
}  # fmt: skip
