"""What depends on what, by the sparsity of the equations."""

from collections.abc import Set

import casadi as ca
import numpy as np
from casadi import SX
from numpy.typing import NDArray

from casadi_models.dae import Dae

Pattern = NDArray[np.bool_]


def pattern(expression: SX, *variables: SX) -> Pattern:
    """Return which elements of an expression depend on which variables, (rows, variables)."""
    sparsity = ca.jacobian_sparsity(expression, ca.vertcat(*variables))
    return np.array(ca.DM.ones(sparsity).full(), dtype=bool).reshape(sparsity.shape)


def matching(dae: Dae) -> NDArray[np.int_]:
    """Return for each algebraic unknown an equation of its own that depends on it."""
    equation = np.zeros(len(dae.algebraics), dtype=int)
    if dae.algebraics:
        _, rows, columns, *_ = ca.jacobian_sparsity(dae.alg, dae.z).btf()
        equation[list(columns)] = list(rows)
    return equation


def used(expression: SX, variables: SX) -> list[int]:
    """Return the positions of the variables on which anything of an expression depends."""
    return [int(i) for i in np.flatnonzero(pattern(expression, variables).any(axis=0))]


def closure(dae: Dae, wanted: Set[str], observed: SX) -> tuple[list[int], list[int], list[int]]:
    """Return the positions of the states, algebraic unknowns and equations that are needed."""
    equation = matching(dae)
    ode_x, ode_z = pattern(dae.ode, dae.x), pattern(dae.ode, dae.z)
    alg_x, alg_z = pattern(dae.alg, dae.x)[equation], pattern(dae.alg, dae.z)[equation]
    x = np.array([v.name in wanted for v in dae.states], dtype=bool)
    z = np.array([v.name in wanted for v in dae.algebraics], dtype=bool)
    x |= pattern(observed, dae.x).any(axis=0)
    z |= pattern(observed, dae.z).any(axis=0)
    while True:
        more_z = z | ode_z[x].any(axis=0) | alg_z[z].any(axis=0)
        more_x = x | ode_x[x].any(axis=0) | alg_x[z].any(axis=0)
        for rule in dae.start_rules:
            if more_x[list(rule.states)].any():
                more_x[list(rule.states)] = True
                more_x |= pattern(rule.expression, dae.x).any(axis=0)
        if (more_x == x).all() and (more_z == z).all():
            break
        x, z = more_x, more_z
    unknowns = [int(i) for i in np.flatnonzero(z)]
    return [int(i) for i in np.flatnonzero(x)], unknowns, sorted(int(equation[i]) for i in unknowns)
