"""Jacobians of large equations: a loop over directional derivatives instead of their formulas.

The formulas of a dense Jacobian are as long as the equations times their unknowns: for a chain of
16 links 3 million operations. A directional derivative is about three times as long as the
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


def is_long(symbols: Sequence[SX], results: SX, unknowns: SX) -> bool:
    """Tell whether the formulas of a Jacobian are too long to be written out.

    Args:
        symbols: What the results depend on.
        results: A column.
        unknowns: Column of the symbols with respect to which it is differentiated.
    """
    if not results.numel() or not unknowns.numel():
        return False
    length = ca.Function("results", list(symbols), [results], {"cse": True}).n_instructions()
    pattern = ca.jacobian_sparsity(results, unknowns)
    return bool(length * _directions(pattern).size2() > MOST_OPERATIONS)


def directional_jacobian(
    name: str, symbols: Sequence[SX], results: SX, unknowns: SX
) -> ca.Function:
    """Return `name(symbols) -> jacobian`, sparse; of which C code can be generated.

    Args:
        name: Of the function; that of its inner one, which is generated once, ends with `_along`.
        symbols, results, unknowns: See `is_long`.
    """
    pattern = ca.jacobian_sparsity(results, unknowns)
    directions = _directions(pattern)
    seed = SX.sym("seed", unknowns.numel())
    along = ca.Function(
        f"{name}_along",
        [*symbols, seed],
        [ca.densify(ca.jtimes(results, unknowns, seed))],
        {"cse": True},
    )
    n = directions.size2()
    every = along.map(f"{name}_every", "serial", n, [*range(len(symbols))], [])
    arguments = [MX.sym(f"i{i}", symbol.sparsity()) for i, symbol in enumerate(symbols)]
    groups = every(*arguments, ca.densify(DM(directions, 1)))
    rows, columns = (np.array(places, dtype=int) for places in pattern.get_triplet())
    direction = np.empty(unknowns.numel(), dtype=int)
    members, of = directions.get_triplet()
    direction[members] = of
    # entry (i, j) of the Jacobian is entry i of the derivative along the direction of column j
    entries = ca.vec(groups)[(rows + results.numel() * direction[columns]).tolist()]
    return ca.Function(name, arguments, [MX(pattern, entries)])


def _directions(pattern: ca.Sparsity) -> ca.Sparsity:
    """Return groups of columns that share no row, (columns, groups)."""
    return pattern.uni_coloring(pattern.T)
