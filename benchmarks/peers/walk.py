"""A CasADi graph as the text of a Python function: the same equations for every peer.

The text holds arithmetic and calls of `sin`, `cos`, `sqrt` ..., which the caller defines:
by `math` (for numba), by `jax.numpy`, or by heyoka's symbolic expressions.
"""

from collections.abc import Callable, Mapping
from typing import Any

import casadi as ca

INFIX = {ca.OP_ADD: "+", ca.OP_SUB: "-", ca.OP_MUL: "*", ca.OP_DIV: "/"}
PREFIX = {
    ca.OP_NEG: "-{0}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "2.0 * {0}",
    ca.OP_INV: "1.0 / {0}",
    ca.OP_SQRT: "sqrt({0})",
    ca.OP_SIN: "sin({0})",
    ca.OP_COS: "cos({0})",
    ca.OP_TAN: "tan({0})",
}
FUNCTIONS = ("sqrt", "sin", "cos", "tan")


def source(function: ca.Function, name: str) -> str:
    """Return the text of `name(t, x) -> tuple` of a `ca.Function` of SX, `(t, x) -> dense column`.

    Raises:
        NotImplementedError: The graph holds an operation that is not in the table above.
    """
    lines = [f"def {name}(t, x):"]
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        read, written = function.instruction_input(k), function.instruction_output(k)
        if operation == ca.OP_OUTPUT:
            lines.append(f"    y{written[1]} = w{read[0]}")
            continue
        if operation == ca.OP_INPUT:
            value = "t" if read[0] == 0 else f"x[{read[1]}]"
        elif operation == ca.OP_CONST:
            value = repr(function.instruction_constant(k))
        elif operation in INFIX:
            value = f"w{read[0]} {INFIX[operation]} w{read[1]}"
        elif operation in PREFIX:
            value = PREFIX[operation].format(f"w{read[0]}")
        else:
            raise NotImplementedError(f"operation {operation} of {function.name()}")
        lines.append(f"    w{written[0]} = {value}")
    results = "".join(f"y{i}, " for i in range(function.nnz_out(0)))
    lines.append(f"    return ({results})")
    return "\n".join(lines) + "\n"


def build(function: ca.Function, name: str, meaning: Mapping[str, Any]) -> Callable[..., Any]:
    """Return the function that the text defines; `meaning` defines each of `FUNCTIONS`."""
    namespace = dict(meaning)
    exec(compile(source(function, name), f"<{name}>", "exec"), namespace)
    made: Callable[..., Any] = namespace[name]
    return made
