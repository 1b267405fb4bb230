"""What a given macro step does to a run: inputs that grow, and parts that slide on each other.

One run does not show it, since an unstable plant grows, too. A shorter macro step does: the growth
by the parts stays about the same, that by the method vanishes or becomes far larger. Events of the
motion keep their times, those of sliding parts follow each other twice as fast.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from cosim.arrays import Vector
from cosim.coupling.failures import EndlessEvents
from cosim.errors import SolverError, UsageError
from cosim.trajectory import Trajectory

_CLOSE = 0.1  # difference of runs that agree in their course, of their size
_FASTER, _SEVERAL = 1.5, 3  # events that follow half the macro step: by this factor more; at least


@dataclass(frozen=True)
class Ranges:
    """The ranges of the inputs of a run.

    Attributes:
        lowest, highest: In its first half, and in all of it, (2, inputs).
        sizes: Nominal values of the inputs, (inputs,).
        mismatch: Largest difference of inputs and outputs, in the sizes of the inputs.
        repeats: How many events follow one of the same relation within a few macro steps, by part
            and relation.
    """

    lowest: Vector
    highest: Vector
    sizes: Vector
    mismatch: float
    repeats: Mapping[tuple[str, str], int] = field(default_factory=dict)

    @property
    def widths(self) -> Vector:
        """In the first half, and in all of the run, (2, inputs)."""
        return self.highest - self.lowest

    @property
    def grow(self) -> bool:
        """Whether an input moves far more in the second half of the run than in the first."""
        return self._any_far(self.widths[1], self.widths[0])

    @property
    def are_quiet(self) -> bool:
        """Whether nothing hints at an instability."""
        return self.mismatch < 1 and not self.grow

    def _any_far(self, more: Vector, less: Vector) -> bool:
        # an oscillation of a stable method about the solution is at most as large as this one
        return bool((more > 2 * less + self.sizes).any())

    def exceed(self, other: "Ranges") -> bool:
        """Whether an input moves far more than in the other run."""
        return self._any_far(self.widths[1], other.widths[1])

    def agree(self, other: "Ranges") -> bool:
        """Whether all inputs have the same course, as far as ranges show it."""
        allowed = _CLOSE * (self.sizes + np.minimum(self.widths, other.widths)[1])
        lower, upper = np.abs([self.lowest - other.lowest, self.highest - other.highest])
        return bool((np.maximum(lower, upper) <= allowed).all())

    def differing(self, other: "Ranges") -> int:
        """Return the input whose range differs most from that in the other run."""
        one, two = self.widths[1] + self.sizes, other.widths[1] + self.sizes
        return int(np.argmax(np.maximum(one, two) / np.minimum(one, two)))


def sliding_part(given: Ranges, again: Callable[[float], Ranges]) -> str | None:
    """Return a part of which a relation switches as often as macro steps allow.

    Args:
        given: With the given macro step.
        again: Simulates with so many times that step.
    """
    if given.are_quiet and max(given.repeats.values(), default=0) < _SEVERAL - 1:
        return None
    try:
        found = again(1 / 2).repeats
    except EndlessEvents as error:
        return error.part
    except (SolverError, UsageError):
        return None
    least = ((key, max(_SEVERAL, _FASTER * given.repeats.get(key, 0))) for key in found)
    return next((part for (part, event), n in least if found[part, event] >= n), None)


def reject_instability(
    run: Trajectory,
    ranges: Ranges,
    inputs: Sequence[str],
    again: Callable[[float], Ranges],
) -> None:
    """Raise an error if inputs of a run grow by the method.

    Args:
        run: With a given macro step.
        ranges: Of its inputs.
        inputs: Their names.
        again: Simulates with another macro step, s.

    Raises:
        SolverError: They do; `partial` is the run.
    """
    step, method = run.stats["macro_step"], run.stats["solver"].rpartition(" ")[2]
    found = None if ranges.are_quiet else _instability(ranges, lambda n: again(n * step))
    if found is None:
        return
    other, factor = found
    place = ranges.differing(other) if other else int(np.argmax(ranges.widths[1] / ranges.sizes))
    moves = f"by {other.widths[1, place]:.2g}" if other else "the run fails"
    shorter = "give a shorter macro_step"
    if factor > 1:
        shorter = "give a much shorter macro_step, if the parts allow it"
    elif other and _is_stable(other, lambda: again(factor * step / 2)):
        shorter = f"give at most {factor * step:g} s"
    why = (
        f"the macro step {step:g} s is too long for {method}: the input {inputs[place]} moves by "
        f"{ranges.widths[1, place]:.2g}, and with {factor * step:g} s {moves}; {shorter}, or "
        "accuracy with the method iterated"
    )
    raise SolverError(f"{run.model}: {why}", replace(run, status=f"stopped: {why}"))


def _is_stable(ranges: Ranges, shorter: Callable[[], Ranges]) -> bool:
    """Return whether inputs neither grow, nor move far more than with a shorter macro step."""
    try:
        return not ranges.grow and not ranges.exceed(shorter())
    except (SolverError, UsageError):
        return False


def _instability(
    given: Ranges, again: Callable[[float], Ranges]
) -> tuple[Ranges | None, float] | None:
    """Return the ranges with another macro step that show an instability, and its factor.

    The ranges are None if the run with that step fails. Without an instability, there are none.

    Args:
        given: With the given macro step.
        again: Simulates with so many times that step.
    """
    try:
        half = again(1 / 2)
        if given.exceed(half):
            return half, 1 / 2
        if given.agree(half):
            return None
        quarter = again(1 / 4)  # two unstable runs may be equally large
        differ = half.exceed(quarter) or quarter.exceed(half)
        if (half.exceed(given) or quarter.mismatch >= 1) and not half.agree(quarter):
            differ |= not _converge(given, half, quarter)
            if not differ:  # three may converge by chance
                differ = not _converge(half, quarter, again(1 / 8))
    except (SolverError, UsageError):  # as where a part has steps of one length
        return _with_twice(given, again) if given.grow else None
    return (quarter, 1 / 4) if differ else None


def _converge(given: Ranges, half: Ranges, quarter: Ranges) -> bool:
    """Whether inputs change less with each halving of the macro step, in the same direction."""
    widths = [each.widths[1] for each in (given, half, quarter)]
    first, then = np.diff(widths, axis=0)
    settled = np.abs(then) <= _CLOSE * (half.sizes + np.minimum(*widths[1:]))
    less = (np.sign(first) == np.sign(then)) & (np.abs(then) < np.abs(first))
    return bool((settled | less).all())


def _with_twice(
    given: Ranges, again: Callable[[float], Ranges]
) -> tuple[Ranges | None, float] | None:
    """Return what `_instability` does, where no shorter step is possible."""
    try:
        twice = again(2)
    except (SolverError, UsageError):
        return None, 2
    return (twice, 2) if twice.exceed(given) or given.exceed(twice) else None
