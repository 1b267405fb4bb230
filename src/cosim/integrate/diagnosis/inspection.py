"""What a model says of itself at its start: condition monitors and margins of its limits."""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_models.dae import Dae
from cosim.errors import InitialConditionError
from cosim.integrate.initial_values import algebraic_values, start_values
from cosim.model.values import assign


@dataclass(frozen=True)
class Inspection:
    """Numbers at the start, in the order of `Dae.monitors` and `Dae.limits`; None without a start.

    Attributes:
        monitors: Conditions, distances and drift; infinite at a singularity.
        margins: The model holds while each one is positive; in the unit of what is limited.
    """

    monitors: tuple[float | None, ...]
    margins: tuple[float | None, ...]


def inspect_start(dae: Dae) -> Inspection:
    """Evaluate monitors and limits at a model's own start values."""
    n = len(dae.monitors)
    expressions = [e for _, e in dae.monitors] + [margin for margin, _ in dae.limits]
    values = assign(dae)
    try:
        x = start_values(dae, 0.0, values)
        z = algebraic_values(dae, 0.0, x, values)
    except InitialConditionError:  # `simulate` says why
        return Inspection((None,) * n, (None,) * len(dae.limits))
    column = ca.vertcat(ca.SX(0, 1), *expressions)
    function = ca.Function("inspect", dae.arguments, [column])
    found = np.array(function(0.0, x, z, values.u, values.p)).ravel().tolist()
    return Inspection(tuple(found[:n]), tuple(found[n:]))
