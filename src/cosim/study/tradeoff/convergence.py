"""Observed order of the fixed-step methods: how the global error falls when steps are halved."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cosim.errors import CosimError
from cosim.integrate.simulate import simulate
from cosim.integrate.solvers import SOLVERS
from cosim.scene.scene import Scene
from cosim.study.tradeoff.measurement import at_times
from cosim.study.tradeoff.variants import span
from cosim.verify.comparison import compare
from cosim.verify.reference import Reference

WANTED = 4  # halvings that an order is fitted to, the smallest steps that rounding leaves alone
_MOST_HALVINGS = 14  # halvings that are tried
_MOST_STEPS = 200_000  # steps, as far as that
_LARGEST = 0.05  # error, in nominal values, from which on halving can be expected to help
_OUTPUTS = 10


@dataclass(frozen=True)
class Order:
    """Observed order of a fixed-step method.

    Attributes:
        model: `MODEL/FORMULATION`.
        solver: The method.
        expected: Its order of consistency.
        observed: Slope of log error over log step; None with fewer than two halvings.
        halvings: How many the slope is fitted to: fewer than 4 where no more of them lie between
            the loss of stability and rounding.
        steps: Of the fit, s, the largest first.
        errors: Largest global error of the states with each step, in nominal values.
    """

    model: str
    solver: str
    expected: int
    observed: float | None
    halvings: int
    steps: tuple[float, ...]
    errors: tuple[float, ...]

    def row(self) -> dict[str, Any]:
        """Return plain values, for tables."""
        ends = (0, -1) if self.steps else ()
        return {
            "model": self.model,
            "solver": self.solver,
            "order": self.expected,
            "observed": self.observed,
            "halvings": self.halvings,
            "steps": " ... ".join(f"{self.steps[i]:.3g}" for i in ends),
            "errors": " ... ".join(f"{self.errors[i]:.1e}" for i in ends),
        }


def observed_order(scene: Scene, truth: Reference, solver: str) -> Order:
    """Halve the step of a fixed-step method until rounding takes over, and fit the order.

    Args:
        scene: A model without algebraic unknowns.
        truth: Its reference.
        solver: Name of one with fixed steps.
    """
    dae, (begin, end) = scene.configured(), span(scene)
    names = [variable.name for variable in dae.states]
    intervals = round((end - begin) / dae.experiment.output_interval)
    outputs = next(n for n in range(_OUTPUTS, 0, -1) if intervals % n == 0)
    length = (end - begin) / outputs
    steps: list[float] = []
    errors: list[float] = []
    expected = SOLVERS[solver].order
    for halvings in range(_MOST_HALVINGS):
        step = length / 2**halvings
        if (end - begin) / step > _MOST_STEPS:
            break
        try:
            run = simulate(
                dae,
                start_time=begin,
                stop_time=end,
                output_interval=length,
                solver=solver,
                step_size=step,
                inputs=scene.inputs,
                outputs=names,
            )
        except CosimError:  # beyond the limit of stability
            continue
        error = compare(at_times(truth.run, run).select(names), run).worst.scaled
        if error > _LARGEST:
            steps, errors = [], []
            continue
        steps.append(step)
        errors.append(error)
        if error < 5 * truth.error(names) or _rounding(errors, expected):
            break
    return replace(
        _fit(steps[:-1], errors[:-1]), model=dae.full_name, solver=solver, expected=expected
    )


def _rounding(errors: Sequence[float], order: int) -> bool:
    """Tell whether the last halving gained far less than the order promises."""
    return len(errors) > 1 and errors[-2] < errors[-1] * 2 ** (0.75 * order) and errors[-1] < 1e-8


def _fit(steps: Sequence[float], errors: Sequence[float]) -> Order:
    chosen, found = tuple(steps[-WANTED - 1 :]), tuple(errors[-WANTED - 1 :])
    slope = None
    if len(chosen) > 2:
        slope = float(np.polyfit(np.log(chosen), np.log(found), 1)[0])
    return Order("", "", 0, slope, max(0, len(chosen) - 1), chosen, found)
