"""Relations of an angle that jumps by a turn, as atan2 does, against the times of a rotation."""

from functools import cache

import casadi as ca
import pytest
from helpers.hybrid_engines import ENGINES, run_on

import cosim


@cache
def rotation():
    """Return a rotation that counts how often its angle exceeds a place, and how long it does."""
    model = cosim.Model("rotation", stop_time=10.0, output_interval=0.5)
    speed = model.parameter("speed", "1/s", 1.0, "speed")
    place = model.parameter("place", "1", 0.5, "place")
    x, y = model.state("x", "1", 1.0, "cosine"), model.state("y", "1", 0.0, "sine")
    n, w = model.discrete("n", "1", 0.0, "how often"), model.state("w", "s", 0.0, "how long")
    model.derivative(x, -speed * y)
    model.derivative(y, speed * x)
    above = ca.atan2(y, x) > place
    model.derivative(w, ca.if_else(above, 1, 0))
    model.when(above, {n: n + 1}, name="above")
    return model.freeze()


PI = 3.141592653589793
RIGHT = {  # of speed and place: how long in 10 s
    (1.0, 0.5): 2 * (PI - 0.5),
    (1.0, 3.14): 2 * (PI - 3.14),
    (-1.0, 0.5): PI - 0.5 + (10 - 3 * PI),
    (-1.0, 3.14): 2 * (PI - 3.14),
}


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("engine", ENGINES)
def test_an_angle_that_jumps_the_other_way_is_an_event(engine):
    for (speed, place), right in RIGHT.items():
        values = {"speed": speed, "place": place}
        final = run_on(engine, rotation(), start_values=values).final
        assert final["n"] == 2, (speed, place)  # before, but for model exchange: 0 or 1
        error = 3e-3 if engine == "rk4" else 1e-5  # of steps of 0.5 s
        assert final["w"] == pytest.approx(right, abs=error), (speed, place)


def test_derivatives_at_a_jump_are_rejected():
    outputs = {"outputs": ["w"], "with_respect_to": ["place"], "stop_time": 10}
    with pytest.raises(cosim.CosimError, match=r"atan2 jumps by a turn in < of .* at 3.14159"):
        cosim.sensitivity(rotation(), **outputs)
    found = cosim.sensitivity(rotation(), **outputs | {"stop_time": 3})
    assert found["w", "place"][-1] == pytest.approx(-1, abs=1e-6)
