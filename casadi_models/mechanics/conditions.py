"""Condition monitors: the distance of a formulation from singular configurations.

Numbers without unit that do not change when quantities are measured in other units. They are
monitors of a model: nothing computes them until they are named as outputs.

Source  Golub & Van Loan, Matrix Computations, 4th ed. 2013, section 2.6 (condition); van der Sluis,
        Numer. Math. 14, 1969 (no diagonal scaling is better than unit diagonals, or unit rows, by
        more than the factor m, or its root).
"""

from collections.abc import Callable
from typing import Any

import casadi as ca
from casadi import DM, SX

from casadi_models.dae import Model
from casadi_models.dae.invariants import CONSTRAINT_CONDITION


def watch_masses(model: Model, mass: SX) -> None:
    """Declare `mass_condition` of a mass matrix (n, n).

    C is the matrix scaled to a unit diagonal: its entries are the coupling of two speeds, as a
    correlation. The monitor is |C| |C^-1| / n in Frobenius norms, 1 where nothing is coupled.
    Speeds that never have inertia (a slender bar about its axis) are left out.
    """
    nonzero = [i for i, entry in enumerate(ca.vertsplit(ca.diag(mass))) if not entry.is_zero()]
    mass = mass[nonzero, nonzero]
    size = ca.sqrt(ca.diag(mass))
    coupling = ca.triu2symm(ca.triu(mass / (size @ size.T)))
    model.monitor(
        "mass_condition",
        _or_infinite(ca.norm_fro(coupling) * ca.norm_fro(_inverse(coupling)) / len(nonzero)),
        "condition of the mass matrix scaled to a unit diagonal; 1 where no speeds are coupled",
    )


def watch_elimination(model: Model, matrix: SX) -> None:
    """Declare `constraint_condition` of the square matrix that gives the dependent speeds.

    Its rows have one unit, its columns another one. The monitor is |A| |A^-1| / n in Frobenius
    norms: infinite where the dependent speeds do not exist.
    """
    # the adjugate over the determinant: no 0/0 where only the latter vanishes
    inverse = ca.norm_fro(ca.adj(matrix)) / ca.fabs(ca.det(matrix))
    model.monitor(
        CONSTRAINT_CONDITION,
        ca.norm_fro(matrix) * inverse / matrix.shape[0],
        "condition of the matrix that gives the dependent speeds",
    )


def watch_constraints(
    model: Model, jacobian: SX, mass: SX, at_start: Callable[[SX], DM] | None = None
) -> None:
    """Declare `constraint_condition` of constraints that are enforced by multipliers.

    Args:
        model: The formulation.
        jacobian: d(constraints)/d(speeds), (m, n).
        mass: Mass matrix, (n, n).
        at_start: Evaluates an expression at the initial position. A row may then vanish, as those
            of a loop along the axes do: its size is the root mean square of its length now and
            there. None: no row can vanish, and its size is its length.

    Column j is divided by the root of mass jj unless that is always zero, then every row by its
    size; A is the result. The monitor is |A| |A^+| / m in Frobenius norms, from the traces of
    A A^T and its inverse: 1 where no two constraints act on the same speeds and all rows have
    their sizes, infinite where the multipliers are not unique.
    """
    m = jacobian.shape[0]
    masses = [SX(1) if entry.is_zero() else entry for entry in ca.vertsplit(ca.diag(mass))]
    scaled = jacobian @ ca.diag(1 / ca.sqrt(ca.vertcat(*masses)))
    squares, trace = ca.sum2(scaled**2), SX(m)
    if at_start is not None:
        sizes = (squares + at_start(squares)) / 2
        squares, trace = sizes, ca.sum1(squares / sizes)
    scaled = ca.diag(1 / ca.sqrt(squares)) @ scaled
    gram = ca.triu2symm(ca.triu(scaled @ scaled.T))
    model.monitor(
        CONSTRAINT_CONDITION,
        _or_infinite(ca.sqrt(ca.trace(_inverse(gram)) * (trace / m) / m)),
        "condition of the constraints, speeds scaled by masses and rows to length 1",
    )


def watch_singularity(model: Model, *margins: Any) -> None:
    """Declare `singularity_distance`, the smallest of margins that vanish at a singularity."""
    nearest = SX(margins[0])
    for margin in margins[1:]:
        nearest = ca.fmin(nearest, margin)
    model.monitor(
        "singularity_distance",
        nearest,
        "distance from the nearest singularity of coordinates or elimination, 0 there",
    )


def equal_energies(mass: SX) -> SX:
    """Return speeds of equal kinetic energy: a projection in these sizes changes energy little."""
    return 1 / ca.sqrt(ca.diag(mass))


def _inverse(matrix: SX) -> SX:
    """Return the inverse of a symmetric positive definite matrix."""
    return ca.ldl_solve(SX.eye(matrix.shape[0]), *ca.ldl(matrix))


def _or_infinite(condition: SX) -> SX:
    """Return a condition number, infinite where a singular matrix has made it no number."""
    return 1 / ca.fmax(1 / condition, 0)  # C's fmax takes the other one for what is no number
