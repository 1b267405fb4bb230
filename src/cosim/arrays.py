"""Array types, and read-only arrays."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Integers = NDArray[np.int64]
Truths = NDArray[np.bool_]
Vector = NDArray[np.float64]  # of any number of dimensions; docstrings give the shape


def reals(given: ArrayLike) -> Vector:
    """Return a new array of doubles.

    Raises:
        TypeError, ValueError, OverflowError: They are no real numbers. NumPy takes the real parts
            of complex arrays.
    """
    if np.asarray(given).dtype.kind == "c":
        raise TypeError("complex numbers are no real ones")
    return np.array(given, dtype=float)


def frozen(given: ArrayLike) -> Vector:
    """Return a read-only array of doubles; a copy unless the argument is read-only already."""
    if isinstance(given, np.ndarray) and _is_frozen(given):
        return given
    array = reals(given)
    array.setflags(write=False)
    return array


def _is_frozen(array: object) -> bool:
    if not isinstance(array, np.ndarray) or array.dtype != np.float64 or array.flags.writeable:
        return False
    return array.base is None or isinstance(array.base, bytes) or _is_frozen(array.base)
