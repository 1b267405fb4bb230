"""Types of arrays, and arrays that nobody can change."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Integers = NDArray[np.int64]
Truths = NDArray[np.bool_]
Vector = NDArray[np.float64]  # of any number of dimensions; docstrings give the shape


def frozen(given: ArrayLike) -> Vector:
    """Return doubles that nobody can change any more; a copy only where somebody could."""
    if isinstance(given, np.ndarray) and _is_frozen(given):
        return given
    array = np.array(given, dtype=float)
    array.setflags(write=False)
    return array


def _is_frozen(array: object) -> bool:
    if not isinstance(array, np.ndarray) or array.dtype != np.float64 or array.flags.writeable:
        return False
    return array.base is None or isinstance(array.base, bytes) or _is_frozen(array.base)
