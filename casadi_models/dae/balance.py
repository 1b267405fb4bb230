"""Sizes of equations that are solved together, so that none of them loses its digits."""

from collections.abc import Sequence
from math import inf

import casadi as ca
from casadi import SX

from casadi_models.dae.expressions import irregular_place
from casadi_models.dae.variables import Variable

LARGEST = 64  # unknowns; the sizes of more would take longer than the equations
FAIR = 2.0**20  # sums of rows apart from their sizes that cost a solution six of its 16 digits


def row_sizes(matrix: SX, p: SX, parameters: Sequence[Variable]) -> SX:
    """Return the sizes of linear equations, (n, 1): the sums of their coefficients.

    Each coefficient is multiplied by the size of its unknown, so that units do not count where
    forces and accelerations share an equation: a mechanism of micrometers keeps as many digits as
    one of meters. Sizes of rows and columns whose product fits the coefficients best, in the
    logarithm, give those of the unknowns; where one of the coefficients vanishes, all have size 1.
    Sums that are fair at the usual parameters stay as they are there.

    Args:
        matrix: Coefficients, (n, n), expressions of the parameters alone.
        p: The parameters, (m, 1).
        parameters: Their start values and bounds.

    References:
        Curtis and Reid, On the automatic scaling of matrices for Gaussian elimination, IMA Journal
        of Applied Mathematics 10, 1972, doi:10.1093/imamat/10.1.118.
    """
    terms = ca.fabs(ca.densify(matrix))
    sums = ca.sum2(terms)
    if terms.size1() > LARGEST:
        return sums
    usual = ca.DM([parameter.start or 0.0 for parameter in parameters])
    lasting = _lasting(ca.Function("terms", [p], [terms]), usual, parameters)
    counted = terms * lasting + (1 - lasting)
    logs = ca.log(counted)
    # the sizes of the rows are eliminated from the normal equations of the fit
    means = ca.sparsify(ca.diag(1 / ca.fmax(ca.sum2(lasting), 1)) @ lasting)
    fit = ca.sparsify(ca.diag(ca.sum1(lasting)) - lasting.T @ means, 1e-9)
    right = means.T @ ca.sum2(logs) - ca.sum1(logs).T
    unknowns = ca.exp(ca.inv(fit + _together(fit)) @ right)
    sizes = ca.if_else(ca.mmin(counted) > 0, terms @ unknowns, sums)
    ratio = ca.Function("ratio", [p], [sums / sizes])(usual)
    fair = ca.mmax(ratio) <= FAIR * ca.mmin(ratio)
    return sizes * ratio if fair else sizes


def _together(fit: ca.DM) -> ca.DM:
    """Return 1 where the sizes of two unknowns depend on each other: one of these sizes is free."""
    count, order, ends = fit.sparsity().scc()
    together = ca.DM.zeros(*fit.shape)
    for k in range(count):
        block = order[ends[k] : ends[k + 1]]
        together[block, block] = 1
    return together


def _lasting(terms: ca.Function, usual: ca.DM, parameters: Sequence[Variable]) -> ca.DM:
    """Return 1 where coefficients vanish neither at parameters of 0 nor at equal ones, or 0.

    Args:
        terms: The coefficients as a function of the parameters.
        usual: Usual values of these.
        parameters: Their bounds.
    """
    never_0 = ca.DM([float(not v.minimum <= 0 <= v.maximum) for v in parameters])
    lowest = usual * irregular_place(usual.numel()) * never_0
    lasting = ca.DM.ones(*terms.size_out(0))
    for place in (usual, lowest, ca.DM.ones(usual.numel())):
        found = terms(place)
        lasting *= (found > 1e-12 * ca.mmax(found)) * (found < inf)
    return ca.densify(lasting)
