"""Parameter values far from those of the measured Pareto front, and the exact solution there."""

import numpy as np
from helpers.oscillators import K

OTHER = {"k": 3.1 * K, "x": -0.7, "v": 1.9}  # far from the values of the measured front


def closed_form(time, values):
    """Return x of x'' = -k x + sin(t) from x, v at t = 0."""
    k, x, v = (values[name] for name in ("k", "x", "v"))
    w, drive = np.sqrt(k), 1 / (k - 1)
    return drive * np.sin(time) + x * np.cos(w * time) + (v - drive) / w * np.sin(w * time)


def error(run, values=OTHER):
    return np.abs(run["x"] - closed_form(run.time, values)).max()
