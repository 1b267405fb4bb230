"""Relations of quotients, which change their sign at poles, too, against the times of a motion."""

from functools import cache

import casadi as ca
import numpy as np
import pytest
from helpers.hybrid_engines import ENGINES, run_on

import cosim
from casadi_models.dae.expressions import symbols
from casadi_models.dae.quotients import without_poles

RELATIONS = {  # of x, which goes from 0 to 10 with x' = 1
    "above a pole": lambda x, place: 1 / (x - place) < 2,
    "at a pole alone": lambda x, place: 1 / (x - place) > 0,
    "at an output time": lambda x, place: 1 / (x - 3) < 0,
    "by power": lambda x, place: (x - place) ** -3 > 8,
    "by squares": lambda x, place: 1 / (x - place) ** 2 > 4,
    "of two lines": lambda x, place: (x - 1) / (x - place) > 0,
    "of a sum": lambda x, place: 2 / (x - place) - 0.5 / (x - place) + x / place < 1,
    "of a quotient": lambda x, place: (x - 7) / ((x - place) / (x - 5)) > 1,
    "of tangents": lambda x, place: ca.tan(x) > 1,
    "of an absolute value": lambda x, place: ca.fabs(1 / (x - place)) > 2,
    "of the least": lambda x, place: ca.fmin(1 / (x - place), 2) > 1,
}
PLACE = 3.1


@cache
def motion():
    """Return a motion that measures how long each relation holds."""
    model = cosim.Model("quotients", stop_time=10.0, output_interval=0.1)
    place = model.parameter("place", "1", PLACE, "place of a pole")
    x = model.state("x", "1", 0.0, "position")
    model.derivative(x, 1)
    for i, relation in enumerate(RELATIONS.values()):
        w = model.state(f"w{i}", "s", 0.0, "how long")
        model.derivative(w, ca.if_else(relation(x, place), 1, 0))
    return model.freeze()


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("engine", ENGINES)
def test_a_relation_of_a_quotient_switches_at_poles(engine):
    x = ca.SX.sym("x")
    truths = ca.Function("f", [x], [ca.vertcat(*(r(x, PLACE) for r in RELATIONS.values()))])
    times = np.linspace(5e-6, 10 - 5e-6, 1_000_000)
    right = np.array(truths.map(len(times))(times[None])).mean(axis=1) * 10
    final = run_on(engine, motion()).final
    for i, name in enumerate(RELATIONS):  # before: wrong by up to 10 in every engine
        assert final[f"w{i}"] == pytest.approx(right[i], abs=5e-5), name


@pytest.mark.parametrize("speed", [-1.0, 1.0])
def test_the_time_to_a_collision_changes_sign_at_rest(speed):
    """A gap of 10 m that closes ever slower: gap / speed is below 2 s where the speed is, too."""
    model = cosim.Model("cars", stop_time=8.0, output_interval=0.5)
    gap, v = model.state("gap", "m", 10.0, "gap"), model.state("v", "m/s", 3 * speed, "closing")
    late, n = model.state("late", "s", 0.0, "how long"), model.discrete("n", "1", 0, "how often")
    model.derivative(gap, -v)
    model.derivative(v, -speed)
    near = gap / v < 2
    model.derivative(late, ca.if_else(near, 1, 0))
    model.when(near, {n: n + 1}, name="near")
    t = np.linspace(4e-6, 8 - 4e-6, 1_000_000)
    speeds, gaps = speed * (3 - t), 10 - speed * (3 * t - t**2 / 2)
    for solver in ("dop853", "cvodes"):
        final = cosim.simulate(model.freeze(), solver=solver).final
        assert final["late"] == pytest.approx(8 * np.mean(gaps / speeds < 2), abs=2e-5)


def test_what_has_no_pole_stays_as_it_is():
    x, p = ca.SX.sym("x"), ca.SX.sym("p")
    for argument in (x / p - 1, x / (1 + x * x), x / ca.exp(x), x**2, ca.atan(1 / x), x):
        assert without_poles(argument, symbols(p)) is argument


def test_a_quotient_stays_whose_numerator_is_a_large_one():
    """Of 533 operations of the jumping bicycle became 2925, and 2 s of a run 34."""
    x = ca.SX.sym("x")
    for count, stays in ((5, False), (40, True)):
        argument = sum(1 / (x - i) for i in range(count)) - 1
        assert (without_poles(argument, {}) is argument) == stays


def test_a_common_denominator_is_one_factor():
    x, a = ca.SX.sym("x"), ca.SX.sym("a")
    place = x - a
    found = ca.Function("f", [x, a], [without_poles(1 / place + x / place - 3, {})])
    for at in (0.3, 1.7):
        assert float(found(at, 1.0)) == pytest.approx((1 + at - 3 * (at - 1)) * (at - 1))
