"""The second opinion on derivatives: differences of runs at a tight tolerance."""

import warnings
from collections.abc import Callable, Sequence

import numpy as np

from cosim.arrays import Vector
from cosim.study.sensitivity.variational import SensitivityTarget

STEP = 1e-4  # of the target's size
# Derivative = sum of weight * run(value + shift * step) / step; each cancels the error h^2 (and
# h^3, h^4) of the plain quotient.
CENTRAL = {1: 2 / 3, -1: -2 / 3, 2: -1 / 12, -2: 1 / 12}
ASIDE = {0: -25 / 12, 1: 4.0, 2: -3.0, 3: 4 / 3, 4: -1 / 4}

Runs = Callable[[Sequence[tuple[str, float]]], Vector]


def differences(runs: Runs, targets: Sequence[SensitivityTarget], at: Sequence[float]) -> Vector:
    """Return derivatives of fourth order in the step, (n, ny, targets).

    Args:
        runs: Runs the model with one value replaced at a time: outputs (changes, n, ny).
        targets: What is differentiated by.
        at: Their values in this run.
    """
    changes: list[tuple[str, float]] = []
    rules = []
    for target, value in zip(targets, at, strict=True):
        step, weights = STEP * target.size, CENTRAL
        if value + 2 * step > target.variable.maximum:  # to the side where values are allowed
            step, weights = -step, ASIDE
        elif value - 2 * step < target.variable.minimum:
            weights = ASIDE
        rules.append((step, [*weights.values()]))
        changes += [(target.variable.name, value + shift * step) for shift in weights]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what is worth a warning was told with the run itself
        moved = iter(runs(changes))
    columns = [sum(w * next(moved) for w in weights) / step for step, weights in rules]
    return np.stack(columns, axis=-1)
