"""`knots_of`: where the tables of a term have their samples."""

import re

import casadi as ca
import numpy as np

from casadi_models.dae.inner_terms import InnerTerm
from cosim.arrays import Vector

# the knots of a table of one variable in CasADi's C code
_GRID = r"(?:casadi_interpn|CASADI_PREFIX\(nd_boor_eval\))\([^;{]*?,\s*1,\s*(casadi_c\d+)"


def knots_of(term: InnerTerm) -> Vector:
    """Return the knots of the tables of a term in its variable; empty if they are unknown."""
    found = list[Vector]()
    for table, argument in term.tables:
        generator = ca.CodeGenerator("table")
        try:
            generator.add(table)
            code = generator.dump()
        except RuntimeError:  # of an external function, which may hold a table, too
            return np.empty(0)
        grids = re.findall(_GRID, code)
        if len(grids) != 1:
            return np.empty(0)
        (numbers,) = re.findall(rf"{grids[0]}\[\d+\] = *\n* *{{([^}}]*)}}", code)
        line = [argument, ca.jacobian(argument, term.symbol)]
        value, slope = ca.Function("line", [term.symbol], line)(0)
        knots = np.array([float(number) for number in numbers.split(",")])
        found.append((knots - float(value)) / float(slope))
    return np.unique(np.concatenate([np.empty(0), *found]))
