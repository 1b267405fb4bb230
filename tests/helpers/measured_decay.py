"""A decaying variable, and records of it."""

import casadi as ca
import numpy as np

import cosim
from cosim.series.samples import Column
from cosim.trajectory import Trajectory

TIMES = np.linspace(0, 2, 41)


def decay():
    model = cosim.Model("decay", stop_time=2.0)
    x = model.state("x", "m", 1.0, "x")
    k = model.parameter("k", "1/s", 1.0, "rate")
    scale = model.parameter("scale", "1", 1.0, "scale")
    share = model.parameter("share", "1", 1.0, "share")
    idle = model.parameter("idle", "1", 1.0, "no influence")
    model.derivative(x, -k * x + 0 * idle * ca.sin(x))
    model.output("y", "m", scale * share * x, "y")
    return model.freeze()


DECAY = decay()


def record(columns, times=TIMES, name="record"):
    """A measured record of columns by name."""
    own = tuple(Column(n, "m") for n in columns)
    return Trajectory(name, times, own, np.column_stack([*columns.values()]))


def noisy(seed, k=2.0, start=3.0, size=0.05):
    noise = np.random.default_rng(seed).normal(0, size, len(TIMES))
    return record({"x": start * np.exp(-k * TIMES) + noise})
