"""`estimated_error`: the error of a coupling, from what tighter tolerances change."""

_FALLS = 0.75  # power of the tolerance with which the error falls; less is on the safe side
_UNKNOWN = 0.5  # how much of the error is left if no order is known
OF_A_RUN = 10.0  # usual error of a part's run, in tolerances of its steps


def estimated_error(
    change: float, before: float, ratio: float, accuracy: float, of_parts: float, *, ordered: bool
) -> float:
    """Return the error of the second of two runs in succession, in nominal values.

    Args:
        change: Their largest difference, in nominal values.
        before: That of the two runs before; 0 if there were none.
        ratio: Of their tolerances, below 1.
        accuracy: The largest error that is allowed.
        of_parts: Tolerance of the parts' solvers, which no agreement of two runs shows.
        ordered: Whether the method has its order: without it, the error is as large as the change.
    """
    left = min(ratio, 0.8) ** _FALLS if ordered else _UNKNOWN
    if change > accuracy:  # the order counts if it has been observed
        observed = min(change / before, _UNKNOWN) if before else _UNKNOWN
        left = max(left, observed)
    return change * left / (1 - left) + OF_A_RUN * of_parts
