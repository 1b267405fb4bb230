"""CasADi functions printed once more, for vectors of doubles: one system in each lane.

What is printed stands behind fmu/solvers/lanes.h. Every operation works on each lane by itself.
"""

import casadi as ca

from casadi_models.dae import Dae
from cosim.errors import UsageError
from cosim.memo import kept_per_thread

_LANE_FORMS = {
    ca.OP_ASSIGN: "{0}",
    ca.OP_ADD: "{0} + {1}",
    ca.OP_SUB: "{0} - {1}",
    ca.OP_MUL: "{0} * {1}",
    ca.OP_DIV: "{0} / {1}",
    ca.OP_NEG: "-{0}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "{0} + {0}",
    ca.OP_INV: "every(1) / {0}",
    ca.OP_SQRT: "root({0})",
    ca.OP_SIN: "vector_sin({0})",
    ca.OP_COS: "vector_cos({0})",
    ca.OP_FABS: "magnitude({0})",
    ca.OP_SIGN: "sign_of({0})",
    ca.OP_COPYSIGN: "with_sign({0}, {1})",
    ca.OP_FMIN: "smaller({0}, {1})",
    ca.OP_FMAX: "larger({0}, {1})",
    ca.OP_LT: "truth({0} < {1})",
    ca.OP_LE: "truth({0} <= {1})",
    ca.OP_EQ: "truth({0} == {1})",
    ca.OP_NE: "truth({0} != {1})",
    ca.OP_NOT: "truth({0} == every(0))",
    ca.OP_AND: "truth(({0} != every(0)) & ({1} != every(0)))",
    ca.OP_OR: "truth(({0} != every(0)) | ({1} != every(0)))",
    ca.OP_IF_ELSE_ZERO: "pick({0} != every(0), {1}, every(0))",
    ca.OP_LIFT: "{0}",
}
_PARTNER = {ca.OP_SIN: ca.OP_COS, ca.OP_COS: ca.OP_SIN}
_ONE_BY_ONE = (
    *("tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh"),
    *("exp", "expm1", "log", "log1p", "erf", "floor", "ceil"),
)
_TWO_BY_TWO = ("pow", "fmod", "remainder", "atan2", "hypot")
_LANE_FORMS |= {getattr(ca, f"OP_{name.upper()}"): f"each_{name}({{0}})" for name in _ONE_BY_ONE}
_LANE_FORMS |= {
    getattr(ca, f"OP_{name.upper()}"): f"each_{name}({{0}}, {{1}})" for name in _TWO_BY_TWO
}
_LANE_FORMS[ca.OP_CONSTPOW] = _LANE_FORMS[ca.OP_POW]


@kept_per_thread(16)
def fits_lanes(dae: Dae) -> bool:
    """Tell whether lanes have every operation of a model: calls of functions they do not."""
    laws = [dae.ode, dae.outputs, dae.margins]
    function = ca.Function("laws", dae.arguments, [ca.vertcat(*laws)])
    codes = {function.instruction_id(i) for i in range(function.n_instructions())}
    return codes <= {ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST, *_LANE_FORMS}


def vector_text(function: ca.Function, name: str) -> str:
    """Return `static void name(const V *const *in, V *const *out)` with a function's equations.

    Args:
        function: Of dense columns, made of `SX`.
        name: Of the C function.

    Raises:
        UsageError: It has an operation that lanes do not have.
    """
    held: dict[int, str] = {}  # what each place of CasADi's work space stands for now
    waiting: dict[tuple[int, str], tuple[int, int]] = {}  # angular ones: line, instruction
    lines: list[str] = []
    for i in range(function.n_instructions()):
        code = function.instruction_id(i)
        into, of = function.instruction_output(i), function.instruction_input(i)
        if code == ca.OP_OUTPUT:
            lines.append(f"    out[{into[0]}][{into[1]}] = {held[of[0]]};")
            continue
        if code == ca.OP_CONST:
            text = f"every({_literal(function.instruction_constant(i))})"
        elif code == ca.OP_INPUT:
            text = f"in[{of[0]}][{of[1]}]"
        elif code in _LANE_FORMS:
            text = _LANE_FORMS[code].format(*(held[place] for place in of))
        else:
            raise UsageError(f"{name}: lanes have no operation with CasADi's number {code}")
        if code in _PARTNER:
            angle = held[of[0]]
            if found := waiting.pop((_PARTNER[code], angle), None):
                line, other = found
                sine, cosine = (i, other) if code == ca.OP_SIN else (other, i)
                call = f"sine_and_cosine({angle}, &a{sine}, &a{cosine});"
                lines[line] = f"    V a{sine}, a{cosine};\n    {call}"
                held[into[0]] = f"a{i}"
                continue
            waiting[code, angle] = len(lines), i
        held[into[0]] = f"a{i}"
        lines.append(f"    const V a{i} = {text};")
    body = "\n".join(lines)
    return (
        f"static void {name}(const V *const *in, V *const *out) {{\n"
        f"    (void)in, (void)out;\n{body}\n}}"
    )


def _literal(value: float) -> str:
    if value != value:
        return "NAN"
    return {float("inf"): "INFINITY", float("-inf"): "-INFINITY"}.get(value, repr(float(value)))
