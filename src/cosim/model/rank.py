"""How far constraints are from losing rank, where branches of motion meet; for both roads."""

import casadi as ca
from casadi import SX

from casadi_models.dae import Dae

MONITOR = "constraint_condition"  # which a model declares
LOST = 1e3  # condition, somewhere between two outputs or steps, that counts as loss of rank


def constraint_condition(dae: Dae) -> SX | None:
    """Return the condition of a model's constraints; None where it does not tell."""
    known = [*dae.monitors]
    known += zip(dae.output_variables, ca.vertsplit(dae.outputs), strict=True)
    return next((expression for v, expression in known if v.name == MONITOR), None)


def distance_from_loss(dae: Dae) -> SX:
    """Return one over the condition of a model that tells it: 1 at best, 0 where rank is lost."""
    condition = constraint_condition(dae)
    assert condition is not None
    return 1 / condition


def watches_rank(dae: Dae) -> bool:
    """Tell whether a model keeps constraints by multipliers and tells their condition."""
    return bool(dae.algebraics) and constraint_condition(dae) is not None
