"""Numbers from CasADi expressions, for tests."""

import casadi as ca
import numpy as np
from casadi import SX
from numpy.typing import ArrayLike, NDArray


def value(expression: SX, *pairs: tuple[SX, ArrayLike]) -> NDArray[np.float64]:
    """Evaluate a matrix expression at (symbols, numbers) pairs."""
    function = ca.Function("f", [symbols for symbols, _ in pairs], [expression])
    return np.array(function.call([numbers for _, numbers in pairs])[0])
