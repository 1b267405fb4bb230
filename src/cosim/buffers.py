"""Calls of CasADi functions straight on numpy's memory: no copies, no lists of Python floats."""

from collections.abc import Callable, Sequence

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]


def on_arrays(
    function: ca.Function, arguments: Sequence[Vector], results: Sequence[Vector]
) -> Callable[[], bool]:
    """Return what evaluates a function on arrays and tells whether it succeeded.

    Args:
        function: Dense in all arguments and results.
        arguments: One array per argument; CasADi's columns are the rows.
        results: One C-ordered array per result, likewise; overwritten.
    """
    buffer, evaluate = function.buffer()
    held = [np.ascontiguousarray(array, dtype=float) for array in arguments]
    for i, array in enumerate(held):
        if array.size:
            buffer.set_arg(i, array.data)  # type: ignore[call-arg]  # stub and binding differ
    for i, array in enumerate(results):
        if array.size:
            buffer.set_res(i, array.data)  # type: ignore[call-arg]

    def run() -> bool:
        assert len(held) == len(arguments)  # CasADi's buffer does not hold them
        evaluate()
        return not buffer.ret()

    return run
