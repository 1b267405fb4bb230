"""How much one call of co-simulation may compute, so that the longest ends within a second.

Counted in operations of the model's equations, not in time: the same call gives the same result on
every machine. What needs more ends with Discard where it has come to; the importer may go on there.
"""

import casadi as ca

from casadi_models.dae import Dae
from cosim.memo import kept_per_thread

# Operations of one call. With subnormal numbers one takes 10 ns, in generated solvers, where
# most of them are of the linear algebra, 1 ns.
_OF_DOP853, _OF_GENERATED = 1e8, 5e8
_DEAR = 10  # times as much for sin, exp, pow and the like
_CHEAP = (
    *(ca.OP_CONST, ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_PARAMETER, ca.OP_ASSIGN),
    *(ca.OP_ADD, ca.OP_SUB, ca.OP_MUL, ca.OP_NEG, ca.OP_SQ, ca.OP_TWICE, ca.OP_FABS),
    *(ca.OP_DIV, ca.OP_INV, ca.OP_SQRT, ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_NOT),
    *(ca.OP_AND, ca.OP_OR, ca.OP_IF_ELSE_ZERO, ca.OP_FMIN, ca.OP_FMAX, ca.OP_SIGN),
)
FAILED_ATTEMPTS = 6  # of integration_step.c, each with all of its steps


@kept_per_thread(16)
def most_trials(dae: Dae) -> int:
    """Return how many steps of dop853.h a call may try, each of up to 16 right-hand sides."""
    return _within(_OF_DOP853 / (16 * _right_hand_side(dae)), 500, 20_000)


def most_steps(dae: Dae, plugin: str) -> int:
    """Return how many steps CasADi's `erk` or `rosenbrock` may take in an attempt."""
    if plugin == "erk":
        return _within(_OF_GENERATED / (FAILED_ATTEMPTS * 7 * _right_hand_side(dae)), 500, 10_000)
    unknowns = dae.x.numel() + dae.z.numel()
    cost = 12 * _operations(dae, dae.ode, dae.alg) + unknowns**3 / 3
    return _within(_OF_GENERATED / (FAILED_ATTEMPTS * cost), 500, 4000)


def _right_hand_side(dae: Dae) -> float:
    """Count the operations of dx/dt; the algebraic unknowns take two iterations of Newton's."""
    solved = 2 * _operations(dae, dae.alg) + dae.z.numel() ** 3 / 3
    return max(1.0, _operations(dae, dae.ode) + solved)


def _operations(dae: Dae, *expressions: ca.SX) -> float:
    function = ca.Function("counted", dae.arguments, [*expressions], {"cse": True})
    kinds = (function.instruction_id(k) for k in range(function.n_instructions()))
    return float(sum(1 if kind in _CHEAP else _DEAR for kind in kinds))


def _within(wanted: float, least: int, most: int) -> int:
    return int(min(most, max(least, wanted)))
