"""C code of CasADi functions for SIMD vectors: each lane evaluates another system.

The code needs fmu/solvers/lanes.h. Every operation treats each lane separately.
"""

import json
from pathlib import Path

import casadi as ca

from casadi_models.dae import Dae
from casadi_models.dae.expressions import operations
from cosim.errors import UsageError
from cosim.memo import cached_per_thread

_FORMS = json.loads(Path(__file__).with_name("lane_forms.json").read_text())
_LANE_FORMS: dict[int, str] = {getattr(ca, f"OP_{name}"): form for name, form in _FORMS.items()}
LANE_OPERATIONS = {ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST, *_LANE_FORMS}
_PARTNER = {ca.OP_SIN: ca.OP_COS, ca.OP_COS: ca.OP_SIN}


@cached_per_thread(16)
def fits_lanes(dae: Dae) -> bool:
    """Return whether every operation of a model has a vector form; function calls have none."""
    codes = operations(ca.vertcat(dae.ode, dae.outputs, dae.margins))
    return codes <= LANE_OPERATIONS


def vector_text(function: ca.Function, name: str) -> str:
    """Return `static void name(const V *const *in, V *const *out)` with a function's equations.

    Args:
        function: An `SX` function of dense columns.

    Raises:
        UsageError: An operation has no vector form.
    """
    current: dict[int, str] = {}  # C expression of each element of CasADi's work vector
    waiting: dict[tuple[int, str], tuple[int, int]] = {}  # sin or cos: line, instruction
    lines: list[str] = []
    for i in range(function.n_instructions()):
        code = function.instruction_id(i)
        into, of = function.instruction_output(i), function.instruction_input(i)
        if code == ca.OP_OUTPUT:
            lines.append(f"    out[{into[0]}][{into[1]}] = {current[of[0]]};")
            continue
        if code == ca.OP_CONST:
            text = f"every({_literal(function.instruction_constant(i))})"
        elif code == ca.OP_INPUT:
            text = f"in[{of[0]}][{of[1]}]"
        elif code in _LANE_FORMS:
            text = _LANE_FORMS[code].format(*(current[place] for place in of))
        else:
            raise UsageError(f"{name}: CasADi's operation {code} has no form for SIMD lanes")
        if code in _PARTNER:
            angle = current[of[0]]
            if found := waiting.pop((_PARTNER[code], angle), None):
                line, other = found
                sine, cosine = (i, other) if code == ca.OP_SIN else (other, i)
                call = f"sine_and_cosine({angle}, &a{sine}, &a{cosine});"
                lines[line] = f"    V a{sine}, a{cosine};\n    {call}"
                current[into[0]] = f"a{i}"
                continue
            waiting[code, angle] = len(lines), i
        current[into[0]] = f"a{i}"
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
