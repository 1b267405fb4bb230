"""Calls of CasADi functions straight on numpy's memory: no copies, no lists of Python floats."""

from collections.abc import Sequence

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]


def call_on_arrays(
    function: ca.Function, arguments: Sequence[Vector], results: Sequence[Vector]
) -> bool:
    """Evaluate a function on arrays; tell whether it succeeded.

    Args:
        function: Dense in all arguments and results.
        arguments: One array per argument; CasADi's columns are the rows.
        results: One C-ordered array per result, likewise; overwritten.
    """
    buffer, evaluate = function.buffer()
    held = [np.ascontiguousarray(array, dtype=float) for array in arguments]  # the buffer does not
    for i, array in enumerate(held):
        if array.size:
            buffer.set_arg(i, array.data)  # type: ignore[call-arg]  # stub and binding differ
    for i, array in enumerate(results):
        if array.size:
            buffer.set_res(i, array.data)  # type: ignore[call-arg]
    evaluate()
    return not buffer.ret()
