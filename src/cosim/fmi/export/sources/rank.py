"""What an FMU watches the rank of its constraints by, and how it keeps to them near its loss."""

import casadi as ca

from casadi_models.dae import Dae
from cosim.codegen.functions import CALL
from cosim.codegen.rank import constraint_condition, watches_rank
from cosim.codegen.runge_kutta.projection import projection_step
from cosim.memo import kept_per_thread

MOST = 5.0  # times the operations of the equations, that it may take


@kept_per_thread(16)
def has_rank(dae: Dae) -> bool:
    """Tell whether the FMU of a model watches its constraints.

    It does where they are kept by multipliers, tell their condition, and are invariants of the
    motion; and where that condition is not out of proportion to the equations, as of many loops.
    """
    if not (dae.states and dae.invariants and watches_rank(dae)):
        return False
    return _distance(dae).n_instructions() <= MOST * max(1, dae.operations())


def rank_functions(dae: Dae) -> list[ca.Function]:
    """Return what fmu/runtime/equations.h has where HAS_RANK is 1; nothing without a watch."""
    if not has_rank(dae):
        return []
    projection = projection_step(dae, dae.p.numel())
    x, p = ca.MX.sym("x", dae.x.numel()), ca.MX.sym("p", dae.p.numel())
    moved = ca.Function("model_project", [x, p], projection.call([x, p]))
    return [_distance(dae), _rate(dae), moved]


@kept_per_thread(16)
def _distance(dae: Dae) -> ca.Function:
    """Return `model_rank(t, x, z, u, p) -> distance`: one over the condition of the constraints."""
    condition = constraint_condition(dae)
    assert condition is not None
    names = [CALL, ["distance"]]
    return ca.Function("model_rank", dae.arguments, [1 / condition], *names, {"cse": True})


def _rate(dae: Dae) -> ca.Function:
    """Return `model_rank_rate(t, x, z, u, p) -> rate` of the distance."""
    distance = _distance(dae)(*dae.arguments)
    rate = ca.jtimes(distance, dae.x, dae.ode)
    return ca.Function("model_rank_rate", dae.arguments, [rate], CALL, ["rate"], {"cse": True})
