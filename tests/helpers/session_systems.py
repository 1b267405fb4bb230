"""Systems with FMUs as parts, of which sessions are opened; `files` is a fixture of sessions."""

import sys

import pytest

import cosim

LINUX = pytest.mark.skipif(sys.platform != "linux", reason="it compiles for linux64")
STEP = 0.01
LOOP = {"motor.u": "load.y", "load.u": "motor.y"}
WAYS = [
    {"macro_step": STEP},
    {"macro_step": STEP, "method": "jacobi"},
    {"macro_step": STEP, "method": "gauss_seidel"},
    {"macro_step": STEP, "method": "extrapolated"},
    {},
]
EVERY_WAY = pytest.mark.parametrize("way", WAYS, ids=lambda way: "-".join(map(str, way.values())))


def lags(files, motor="lag", load="lag", wires=LOOP):
    """Two lags, x' = u - x; in a loop from 1 and 0, motor.x(t) = (1 + exp(-2t))/2."""
    parts = {"motor": files[motor], "load": files[load]}
    return cosim.couple(parts, wires, start_values={"motor.x": 1.0}, stop_time=1.0)


def balls(files, ball):
    """A ball with impacts and samples and what follows it, with an input left."""
    wires = {"lag.u": "ball.h"}
    return cosim.couple({"ball": files[ball], "lag": files["lag"]}, wires, stop_time=1.0)
