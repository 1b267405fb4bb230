"""Sizes of equations that are solved together, so that none of them loses its digits."""

from collections.abc import Sequence

import casadi as ca
import numpy as np
from casadi import SX
from numpy.typing import NDArray

from casadi_models.dae.expressions import irregular_place
from casadi_models.dae.variables import Variable

LARGEST = 64  # unknowns; the sizes of more would take longer than the equations


def row_sizes(matrix: SX, p: SX, parameters: Sequence[Variable]) -> SX:
    """Return the sizes of linear equations, (n, 1): the sums of their coefficients.

    Each coefficient is multiplied by the size of its unknown, so that the sizes of forces beside
    accelerations do not depend on units: a mechanism of micrometers keeps as many digits as one of
    meters. Sizes of rows and columns whose product fits the coefficients best, in the logarithm,
    give those of the unknowns; where one of the coefficients vanishes, all have size 1.

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
    lasting = _lasting(terms, p, parameters)
    if len(lasting) > LARGEST:
        return sums
    fit = np.block([[np.diag(lasting.sum(1)), lasting], [lasting.T, np.diag(lasting.sum(0))]])
    weights = ca.sparsify(np.linalg.pinv(fit)[len(lasting) :], 1e-9)
    counted = terms * lasting + (1 - lasting)
    logs = ca.log(counted)
    unknowns = ca.exp(-weights @ ca.vertcat(ca.sum2(logs), ca.sum1(logs).T))
    return ca.if_else(ca.mmin(counted) > 0, terms @ unknowns, sums)


def _lasting(terms: SX, p: SX, parameters: Sequence[Variable]) -> NDArray[np.float64]:
    """Return 1 where coefficients vanish neither at parameters of 0 nor at equal ones, or 0."""
    usual = np.array([parameter.start or 0.0 for parameter in parameters])
    may_vanish = np.array([v.minimum <= 0 <= v.maximum for v in parameters], bool)
    moved = usual * np.array(irregular_place(usual.size)).ravel()
    values = ca.Function("terms", [p], [terms])
    places = (usual, np.where(may_vanish, 0.0, moved), np.ones(usual.size))
    found = [np.array(values(place)) for place in places]
    counts = [(a > 1e-12 * a.max()) & np.isfinite(a) for a in found]
    return np.array(np.logical_and.reduce(counts), float)
