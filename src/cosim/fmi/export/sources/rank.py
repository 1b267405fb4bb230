"""What an FMU watches the rank of its constraints by, and how it keeps to them near its loss."""

import casadi as ca
from casadi import SX

from casadi_models.dae import Dae
from cosim.codegen.functions import CALL
from cosim.codegen.initialization import knowns
from cosim.codegen.runge_kutta.projection import projection_step
from cosim.fmi.export.sources.sensitivities import argument_like
from cosim.memo import kept_per_thread
from cosim.model.rank import distance_from_loss, watches_rank

LARGEST_SHARE = 5.0  # times the operations of the equations, that it may take


@kept_per_thread(16)
def has_rank(dae: Dae) -> bool:
    """Tell whether the FMU of a model watches its constraints.

    It does where they are kept by multipliers, tell their condition, and are invariants of the
    motion; and where that condition is not out of proportion to the equations, as of many loops.
    """
    if not (dae.states and dae.invariants and watches_rank(dae)):
        return False
    return _distance(dae).n_instructions() <= LARGEST_SHARE * max(1, dae.operations())


def rank_functions(dae: Dae) -> list[ca.Function]:
    """Return what fmu/runtime/equations.h has where HAS_RANK is 1; nothing without a watch."""
    if not has_rank(dae):
        return []
    projection = projection_step(dae, dae.p.numel())
    known = [argument_like(symbol) for symbol in knowns(dae)]
    moved = ca.Function("model_project", known, projection.call(known))
    return [_distance(dae), _rate(dae), moved]


@kept_per_thread(16)
def _distance(dae: Dae) -> ca.Function:
    """Return `model_rank(t, x, z, u, p) -> distance`: one over the condition of the constraints."""
    return _of_rank(dae, "", distance_from_loss(dae))


def _rate(dae: Dae) -> ca.Function:
    """Return `model_rank_rate(t, x, z, u, p) -> rate` of the distance."""
    moving, along = ca.vertcat(dae.x, dae.t), ca.vertcat(dae.ode, 1)
    return _of_rank(dae, "_rate", ca.jtimes(distance_from_loss(dae), moving, along))


def _of_rank(dae: Dae, what: str, value: SX) -> ca.Function:
    return ca.Function(f"model_rank{what}", dae.arguments, [value], CALL, ["value"], {"cse": True})
