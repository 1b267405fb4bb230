"""`affine_in_modes`: frozen laws whose modes of signs may lie between -1 and 1.

Source  Filippov, Differential Equations with Discontinuous Righthand Sides, Kluwer 1988.
"""

from collections.abc import Callable, Collection
from dataclasses import replace

import casadi as ca
from casadi import SX

from casadi_models.dae.expressions import applied, column, replayed
from casadi_models.dae.frozen import Dae

_LOGIC: dict[int, Callable[..., SX]] = {  # as polynomials of truth values between 0 and 1
    ca.OP_AND: lambda a, b: a * b,
    ca.OP_OR: lambda a, b: a + b - a * b,
    ca.OP_NOT: lambda a: 1 - a,
    ca.OP_IF_ELSE_ZERO: lambda a, b: a * b,
}


def affine_in_modes(dae: Dae, modes: Collection[int], *, taken: bool = False) -> Dae:
    """Return frozen laws that are affine in each of some modes, which may lie between -1 and 1.

    Args:
        dae: A frozen model.
        modes: Positions of the modes in `dae.u`.
        taken: Whether a branch that is not taken has no influence even where it has no value; the
            derivatives with respect to modes are then wrong.
    """
    chosen = {dae.u[i].element_hash(): dae.u[i] for i in sorted(modes)}

    def operation(code: int, operands: list[tuple[SX, bool]]) -> tuple[SX, bool]:
        """Return a value, and whether it is a truth value of modes."""
        terms, of_mode = [value for value, _ in operands], any(truth for _, truth in operands)
        if of_mode and code == ca.OP_LT:  # 0 < mode
            return (1 + terms[1]) / 2, True
        if of_mode and taken and code == ca.OP_IF_ELSE_ZERO:
            return terms[0] * SX.binary(code, *terms), False
        if of_mode and code in _LOGIC:
            return _LOGIC[code](*terms), code != ca.OP_IF_ELSE_ZERO
        return applied(code, terms), False

    laws = ca.cse(ca.vertcat(dae.ode, dae.alg, dae.outputs))
    found = replayed(laws, lambda leaf: (leaf, leaf.element_hash() in chosen), operation)
    nx, n = dae.ode.numel(), laws.numel()
    ends = [0, nx, nx + dae.alg.numel(), n]
    columns = ca.vertsplit(column(value for value, _ in found), ends)
    for mode in chosen.values():
        columns = [_affine(laws, mode, taken) for laws in columns]
    ode, alg, outputs = columns
    return replace(dae, ode=ode, alg=alg, outputs=outputs)


def _affine(laws: SX, mode: SX, taken: bool) -> SX:
    """Return laws that are affine in a mode: convex combinations of its two sides (Filippov).

    A mode of exactly 0 is that of rest, where the laws have their own value.

    Args: See `affine_in_modes`.
    """
    curved = ca.which_depends(laws, mode, 2, True) if ca.depends_on(laws, mode) else []
    for row in (i for i, bent in enumerate(curved) if bent):  # as where `fabs` has the same mode
        sides = [(ca.substitute(laws[row], mode, SX(s)), (1 + s * mode) / 2) for s in (1, -1)]
        rest = ca.substitute(laws[row], mode, SX(0))
        if taken:
            sides = [(SX.binary(ca.OP_IF_ELSE_ZERO, share, law), share) for law, share in sides]
        blend = sum(share * law for law, share in sides)
        laws[row] = ca.if_else(mode == 0, rest, blend) if taken else blend
    return laws
