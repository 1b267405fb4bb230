"""`estimated_error`: the error of a coupling, from what tighter tolerances change."""

from collections.abc import Callable, Sequence
from contextlib import suppress

import numpy as np

from cosim.arrays import Truths, Vector
from cosim.coupling.stability import Ranges
from cosim.errors import SolverError, UsageError
from cosim.trajectory import Trajectory

_FALLS = 0.75  # power of the tolerance with which the error falls; less is on the safe side
UNKNOWN = 0.5  # how much of the error is left if no order is known
BY_CHANCE = 0.75  # the same for events that are found by steps with constant inputs
_ROUNDED = 1e-12  # of what is constant and passes through loops, of its size
_FEW_STEPS = (1, 4)  # the second shows what the start does not
_LONGEST = 0.097  # step that shows noise, of the span; no grid of a part fits it and its halves
_HALVINGS, _TOGETHER = 12, 3  # of its length; of those that are about the same
OF_A_RUN = 10.0  # usual error of a part's run, in tolerances of its steps


def estimated_error(
    change: float, before: float, ratio: float, accuracy: float, of_parts: float, *, least: float
) -> float:
    """Return the error of the second of two runs in succession, in nominal values.

    Args:
        change: Their largest difference, in nominal values.
        before: That of the two runs before; 0 if there were none.
        ratio: Of their tolerances, below 1.
        accuracy: The largest error that is allowed.
        of_parts: Tolerance of the parts' solvers, which no agreement of two runs shows.
        least: How much of the error is left at least; 0 if the method has its order.
    """
    left: float = max(min(ratio, 0.8) ** _FALLS, least)
    if least == BY_CHANCE:  # no agreement shows more than the order of such events
        change = max(change, before * ratio**0.5)
    if change > accuracy:  # the order counts if it has been observed
        observed = min(change / before, UNKNOWN) if before else UNKNOWN
        left = max(left, observed)
    return change * left / (1 - left) + OF_A_RUN * of_parts


def changes(run: Trajectory, last: Trajectory, left_out: Truths) -> Vector:
    """Return the largest difference of two runs in each variable, SI.

    Args:
        run, last: The last row counts only if no part ends the run, whose times may differ.
        left_out: Which rows lie at jumps, (times,).
    """
    n = max(1, min(len(run), len(last)) - ("stop" in run.stats))
    change = np.abs(run.values[:n] - last.values[:n])
    change[left_out[:n]] = 0
    largest: Vector = change.max(axis=0)
    return largest


def unreached(run: Trajectory, accuracy: float, why: str) -> SolverError:
    """Return the error of a run that does not reach an accuracy."""
    return SolverError(
        f"{run.model}: the coupling does not reach the accuracy {accuracy:g}: {why}; allow a "
        "larger error, or give macro_step",
        partial=run,
    )


def reject_noise(
    run: Trajectory,
    parts: Sequence[str],
    accuracy: float,
    before: float,
    change: float,
    of: str,
    noise: float,
) -> None:
    """Raise an error if a run differs from that before by more than that from its own before.

    Args:
        run: With the smaller tolerance.
        parts: Those that cannot restore a state.
        accuracy: The largest error that is allowed.
        before, change: The two differences, in nominal values; 0 if there is none.
        of: The variable that has the second one.
        noise: Error by rounding and noise, which no difference shows, in nominal values.

    Raises:
        SolverError: The differences grow, or the noise is too large.
    """
    if noise > accuracy:
        why = (
            f"the noise of {', '.join(parts)}, which cannot restore a state, adds up to {noise:.1g}"
        )
        raise unreached(run, accuracy, f"{why} in {run.stats['macro_steps']} macro steps")
    if parts and accuracy < change > 2 * before > 0:
        why = f"runs differ by {before:.2g}, and with a smaller tolerance by {change:.2g} ({of})"
        which = f"{', '.join(parts)}, which cannot restore a state, may round results"
        raise unreached(run, accuracy, f"{why}: {which}")


def noise_by_restarts(in_steps: Callable[[float, int], Ranges], span: float, may: Truths) -> float:
    """Return by how much a short step from the start differs from two halves, in sizes of inputs.

    This is the noise of parts that cannot restore a state. What they exchange between the halves
    falls with the square of the length, and is none.

    Args:
        in_steps: Simulates a time, s, in a number of steps with constant inputs.
        span: Length of the run, s.
        may: Whether each input is driven by a continuous output of a part that may round.
    """
    if not may.any():
        return 0.0
    apart = _apart_from_halves(in_steps, _LONGEST * span, may)
    longer = apart.reshape(-1, _TOGETHER).max(axis=1)
    shorter = np.append(longer[1:], 0.0)
    stays = (longer > _ROUNDED) & (shorter > longer / 5)
    return float(np.where(stays, longer, 0.0).max())


def _apart_from_halves(
    in_steps: Callable[[float, int], Ranges], length: float, may: Truths
) -> Vector:
    """Return by how much a step differs from two halves, for a length, s, its half, and so on."""
    apart, one_step = np.zeros(_HALVINGS), None
    for n in range(_HALVINGS):
        whole, one_step = one_step, None
        with suppress(SolverError, UsageError):
            if whole is None:
                whole = in_steps(length / 2**n, 1).widths[1]
            halves = in_steps(length / 2**n, 2)
            apart[n] = (np.abs(whole - halves.widths[1]) / halves.sizes)[may].max()
            one_step = halves.widths[0]  # of the next length
    return apart


def frozen_motion(
    run: Trajectory,
    sources: Sequence[tuple[str, str]],
    ranges: Ranges,
    may: Truths,
    in_few_steps: Callable[[int], Ranges],
    allowed: float,
) -> float:
    """Return by how much an output moves in a few long steps that is constant in short ones.

    A part that rounds its results loses all motion in short steps, whatever the tolerance. The
    result is in nominal values; 0 if there is no such output.

    Args:
        run: With the smallest tolerance.
        sources: Part and output that drive each input.
        ranges: Of the inputs of the run.
        may: Whether each input is driven by a continuous output of a part that may round.
        in_few_steps: Simulates with a number of steps and constant inputs.
        allowed: The largest motion.

    Raises:
        SolverError: The motion is larger.
    """
    stays = may & (ranges.widths[1] <= _ROUNDED * ranges.sizes)
    moves = np.zeros(len(stays))
    for steps in _FEW_STEPS if stays.any() else ():
        with suppress(SolverError, UsageError):
            found = in_few_steps(steps)
            moves = np.maximum(moves, np.where(stays, found.widths[1] / found.sizes, 0))
    most = float(moves.max(initial=0.0))
    if most > allowed:
        name = ".".join(sources[int(moves.argmax())])
        raise SolverError(
            f"{run.model}: the coupling does not reach the accuracy: {name} is constant in "
            f"{run.stats['macro_steps']} macro steps, and moves by {most:.2g} of its size in a few "
            "long ones: its part may round results; give macro_step",
            partial=run,
        )
    return most


def rounding_of(run: Trajectory, sizes: Vector, accuracy: float) -> float:
    """Return the largest rounding of a run, in nominal values.

    Raises:
        SolverError: It is above the accuracy.
    """
    moves = np.ptp(run.values, axis=0) > 0
    every = np.finfo(float).eps * np.where(moves, np.abs(run.values).max(axis=0), 0) / sizes
    rounding = float(every.max(initial=0.0))
    if rounding > accuracy:
        name = run.columns[int(every.argmax())].name
        why = f"double precision carries {name} to {rounding:.1g} nominal values only"
        raise unreached(run, accuracy, why)
    return rounding
