"""Where a right-hand side has a kink or a jump: what a solver that gave up may have met."""

import casadi as ca
import numpy as np
from casadi import SX

from casadi_models.dae import Dae
from cosim.arrays import Vector

_OF_ONE = {ca.OP_SIGN: "sign", ca.OP_FABS: "fabs", ca.OP_FLOOR: "floor", ca.OP_CEIL: "ceil"}
_OF_TWO = {ca.OP_LT: "<", ca.OP_LE: "<=", ca.OP_FMIN: "fmin", ca.OP_FMAX: "fmax"}
_LONGEST_EXPRESSION = 60  # expression that a message shows


def nearest_kink(dae: Dae, t: float, x: Vector, z: Vector, u: Vector, p: Vector) -> str:
    """Describe the expression of the equations that is nearest to where it switches.

    Args:
        dae: The model.
        t, x, z, u, p: Where, in the order of `Dae.arguments`.

    Returns:
        Empty where nothing switches.
    """
    found = _switches(dae)
    if not found:
        return ""
    values = np.array(
        ca.Function("at", dae.arguments, [ca.vertcat(*(e for e, _ in found))])(t, x, z, u, p)
    )
    nearest = int(np.argmin(np.abs(values.ravel())))
    expression, what = found[nearest]
    text = str(expression)
    shown = text if len(text) <= _LONGEST_EXPRESSION else f"{text[:_LONGEST_EXPRESSION]}..."
    return f"{what} switches where {shown} is 0, and it is {float(values[nearest, 0]):.2g} there"


def _switches(dae: Dae) -> list[tuple[SX, str]]:
    """Return what is 0 where an operation of the equations switches, and the operation's name."""
    function = ca.Function("equations", dae.arguments, [ca.vertcat(dae.ode, dae.alg)])
    work: dict[int, SX] = {}
    found: list[tuple[SX, str]] = []
    for i in range(function.n_instructions()):
        operation = function.instruction_id(i)
        given, results = function.instruction_input(i), function.instruction_output(i)
        if operation == ca.OP_INPUT:
            work[results[0]] = dae.arguments[given[0]][given[1]]
        elif operation == ca.OP_CONST:
            work[results[0]] = SX(function.instruction_constant(i))
        elif operation != ca.OP_OUTPUT:
            terms = [work[place] for place in given]
            if operation in _OF_ONE:
                found.append((terms[0], _OF_ONE[operation]))
            elif operation in _OF_TWO:
                found.append((terms[0] - terms[1], _OF_TWO[operation]))
            make = SX.unary if len(terms) == 1 else SX.binary
            work[results[0]] = make(operation, *terms)
    return found
