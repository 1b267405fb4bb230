"""Random motions that touch a threshold within a solver's error, and cross it at their next top.

A touch may count as two crossings or none; it never moves the threshold, nor the next crossing.
"""

from functools import cache
from math import acos, cos, pi, sin
from random import Random

import casadi as ca
import pytest
from helpers.hybrid_engines import ENGINES, run_on
from scipy.optimize import brentq

import cosim

STOP = 8.0  # s
QUICK = ("dop853", "cvodes", "fmu3 cs fmpy", "fmu2 me fmpy")
NEXT = ("up", "down")
SHORT = 4e-3  # s; an error e of a solver above the threshold lasts 2 sqrt(2 e / (size w^2))


@cache
def touching():
    """Return a = swing + climb t, seen by a sign, an event, a floor and a modulus at `top`."""
    model = cosim.Model("touching", stop_time=STOP, output_interval=STOP / 800)
    x, v = model.state("x", "1", 0.0, "swing"), model.state("v", "1/s", 0.0, "its rate")
    q = model.state("q", "s", 0.0, "time that has passed")
    w, climb = (
        model.parameter("w", "1/s", 1.0, "speed"),
        model.parameter("climb", "1/s", 0.1, "of a"),
    )
    top = model.parameter("top", "1", 1.0, "threshold")
    model.derivative(x, v)
    model.derivative(v, -(w**2) * x)
    model.derivative(q, 1.0)
    a = x + climb * q
    for name, law in {
        "side": ca.sign(a - top),
        "stairs": ca.floor(a / top),
        "kink": ca.fabs(a - top),
    }.items():
        model.derivative(model.state(name, "1", 0.0, "integral"), law)
    counts = model.discrete("counts", "1", 0.0, "crossings")
    model.when(a > top, {counts: counts + 1}, name="up")
    model.when(a < top, {counts: counts}, name="down")
    return model.freeze()


def draw(seed):
    """Return start values, the time of the touch, and when the threshold is crossed next."""
    random = Random(f"touch {seed}")
    while True:
        size, w, phase = random.uniform(0.5, 2), random.uniform(2, 6), random.uniform(0, 2 * pi)
        climb = size * w * random.uniform(0.01, 0.08)
        first = (acos(-climb / (size * w)) - phase) / w  # of the tops
        tops = [first + 2 * pi * k / w for k in range(-1, 9)]
        tops = [t for t in tops if 0.1 < t < STOP]

        def a(t, size=size, w=w, phase=phase, climb=climb, less=0.0):
            return size * sin(w * t + phase) + climb * t - less

        if len(tops) < 3 or a(0) > a(tops[0]) - 1e-3 * size:
            continue
        touch = random.randrange(len(tops) - 1)
        over = random.choice([0.0, 0.0, 1e-11, -1e-11, 1e-10, -1e-10, 1e-9, -1e-9])
        top = a(tops[touch]) + over * size
        if top < 0.2:
            continue
        later = tops[touch + 1]
        own = (size, w, phase, climb, top)
        up = brentq(a, later - pi / w, later, own, xtol=1e-14)
        below = min(later + pi / w, STOP)
        if a(below) > top - 1e-2 * size or (touch + 2 < len(tops) and below == STOP):
            continue
        down = brentq(a, later, below, own, xtol=1e-14)
        start = {"x": size * sin(phase), "v": size * w * cos(phase), "w": w, "climb": climb}
        return start | {"top": top}, tops[touch], (up, down)


def assert_touches(engine, seeds):
    """Assert that the crossings after a touch are where the closed form says."""
    near, wrong = (1e-4 if " me " in engine else 1e-5), []
    for seed in seeds:
        start, touch, right = draw(seed)
        stop = min(STOP, right[1] + 0.1 / start["w"])
        run = run_on(engine, touching(), start_values=start, stop_time=stop)
        own = [(event.name, event.time) for event in run.events if event.name in NEXT]
        around = [name for name, time in own if abs(time - touch) < 1e-3]
        after = [(name, time) for name, time in own if time > touch + 1e-3]
        early = [name for name, time in own if time < touch - 1e-3]
        late = max((abs(t - r) for (_, t), r in zip(after, right, strict=False)), default=1.0)
        above = right[1] - right[0]
        side = 2 * above - stop
        good = (
            [name for name, _ in after] == [*NEXT] and late < near and around in ([], [*NEXT])
            and not early and abs(run.final["side"] - side) < SHORT
            and run.final["counts"] == 1 + len(around) // 2
        )  # fmt: skip
        if not good:
            wrong.append((seed, early, around, after, right, run.final["side"] - side))
    assert not wrong, f"{len(wrong)} of {len(seeds)}: {wrong[:3]}"


@pytest.mark.slow_rows("dop853", "fmu2 me fmpy", "fmu3 cs fmpy")
@pytest.mark.parametrize("engine", QUICK)
def test_threshold_that_is_touched_stays_where_it_is(engine):
    assert_touches(engine, range(4))


@pytest.mark.slow
@pytest.mark.parametrize("engine", ENGINES)
def test_many_thresholds_that_are_touched(engine):
    assert_touches(engine, range(4, 64))


@pytest.mark.nightly
@pytest.mark.parametrize("engine", ENGINES)
def test_even_more_thresholds_that_are_touched(engine):
    assert_touches(engine, range(64, 304))
