"""Where a run leaves what its model, or its fixed step, is good for."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from casadi_models.dae import Dae
from cosim.arrays import Vector

ON_INVALID = ("warn", "stop", "ignore")
STEP_DOUBT = 1e-2  # change by half the step, in nominal values, that a fixed step may not exceed


class Breach(NamedTuple):
    """The first output that is not valid, and why; sorts by it."""

    position: int
    text: str


def breaches(dae: Dae, time: Vector, left: Sequence[int]) -> list[Breach]:
    """Say where each limit of the model is left for the first time.

    Args:
        dae: The model.
        time: Output times, s, (n,).
        left: Position of that time for each limit; n or more where it is not left.
    """
    return [
        Breach(i, f"from {time[i]:g} s on it is no longer true that {meaning}")
        for i, (_, meaning) in zip(left, dae.limits, strict=True)
        if i < len(time)
    ]


def too_coarse(dae: Dae, time: Vector, states: Vector, finer: Vector, step: float) -> list[Breach]:
    """Return where a run of fixed steps departs from the same run with half the step.

    The difference estimates the error of the longer step, whose own formula has none.

    Args:
        dae: The model.
        time: Output times, s, (n,).
        states: With the longer step, (nx, n).
        finer: With half of it, (nx, up to n); shorter where that run failed.
        step: The longer step, s.
    """
    nominal = np.array([[variable.nominal] for variable in dae.states])
    change = np.full(states.shape, np.inf)
    change[:, : finer.shape[1]] = np.abs(states[:, : finer.shape[1]] - finer) / nominal
    outside = np.flatnonzero(~(change.max(axis=0) <= STEP_DOUBT))
    if not outside.size:
        return []
    i = int(outside[0])
    row = int(np.argmax(change[:, i]))
    return [
        Breach(
            i,
            f"from {time[i]:g} s on the step of {step:g} s is too long: half of it changes "
            f"{dae.states[row].name} by {change[row, i] * nominal[row, 0]:.2g}",
        )
    ]
