"""Jacobians of large equations: a loop over directional derivatives instead of their formulas.

The formulas of a dense Jacobian are as long as the equations times their unknowns: for a chain of
16 links 7 million operations. A directional derivative is about three times as long as the
equations, whatever their number. Columns that share no row share a direction, so that a banded
Jacobian takes as many directions as its band is wide.

Source  Curtis, Powell & Reid, IMA J. Appl. Math. 13, 1974, 117-119 (columns in groups);
        Gebremedhin, Manne & Pothen, SIAM Review 47, 2005, 629-705 (the colouring of CasADi).
"""

from collections.abc import Sequence

import casadi as ca
import numpy as np
from casadi import DM, MX, SX

MOST_OPERATIONS = 100_000  # of formulas; a compiler takes some 5 kB and 50 us for each of them


def has_long_jacobian(symbols: Sequence[SX], laws: SX, unknowns: SX) -> bool:
    """Tell whether the formulas of a Jacobian are too long to be written out.

    Args:
        symbols: What the laws depend on.
        laws: A column.
        unknowns: Column of the symbols with respect to which it is differentiated.
    """
    if not laws.numel() or not unknowns.numel():
        return False
    length = ca.Function("laws", list(symbols), [laws], {"cse": True}).n_instructions()
    return bool(length * _groups(ca.jacobian_sparsity(laws, unknowns)).size2() > MOST_OPERATIONS)


def derivative_along(name: str, symbols: Sequence[SX], laws: SX, unknowns: SX) -> ca.Function:
    """Return `name(point, seed)`: the derivative of laws along a seed of unknowns, dense.

    Args:
        name: Of the function.
        symbols: What the laws depend on; `point` is the column of all of them.
        laws, unknowns: Columns.
    """
    seed = SX.sym("seed", unknowns.numel())
    along = ca.densify(ca.jtimes(laws, unknowns, seed))
    return ca.Function(name, [ca.vertcat(*symbols), seed], [along], {"cse": True})


def jacobian_in_a_loop(name: str, along: ca.Function, pattern: ca.Sparsity) -> ca.Function:
    """Return `name(point) -> jacobian`, sparse; of which C code can be generated.

    Args:
        name: Of the function.
        along: See `derivative_along`.
        pattern: Of the Jacobian with respect to the unknowns that come first.
    """
    groups = _groups(pattern)
    members, of = (np.array(places, dtype=int) for places in groups.get_triplet())
    seeds = DM.zeros(along.numel_in(1), groups.size2())
    seeds[: groups.size1(), :] = DM(groups, 1)
    point = MX.sym("point", along.numel_in(0))
    every = along.map(f"{name}_every", "serial", groups.size2(), [0], [])(point, seeds)
    group = np.empty(pattern.size2(), dtype=int)
    group[members] = of
    rows, columns = (np.array(places, dtype=int) for places in pattern.get_triplet())
    # entry (i, j) of the Jacobian is entry i of the derivative along the group of column j
    entries = ca.vec(every)[(rows + pattern.size1() * group[columns]).tolist()]
    return ca.Function(name, [point], [MX(pattern, entries)])


def _groups(pattern: ca.Sparsity) -> ca.Sparsity:
    """Return groups of columns that share no row, (columns, groups)."""
    return pattern.uni_coloring(pattern.T)
