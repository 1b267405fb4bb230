"""`Clock`: the time of a session, and the times that calls of `advance` reach."""

from dataclasses import dataclass
from math import nan

from cosim.errors import ParameterError, UsageError
from cosim.model.values import number


@dataclass(slots=True)
class Clock:
    """The present time, s; equal steps in succession end at first time + n * length.

    Attributes:
        now: The present time, s.
        first: Where equal steps have begun, s.
        length: Of the last step, s; NaN where it was none.
        count: Number of equal steps.
    """

    now: float
    first: float
    length: float = nan
    count: int = 0

    @property
    def facts(self) -> tuple[float, float, float, int]:
        """Its attributes in their order; `astuple` takes ten times as long."""
        return self.now, self.first, self.length, self.count

    @facts.setter
    def facts(self, facts: tuple[float, float, float, int]) -> None:
        self.now, self.first, self.length, self.count = facts

    def target(self, owner: str, step: float | None, to: float | None) -> float:
        """Return the time that a call of `advance` is to reach, s.

        Args:
            owner: Of the session, for errors.
            step, to: Arguments of `advance`, s.

        Raises:
            UsageError: None or both are given.
            ParameterError: The time is not finite or before the present one, or the step is too
                short.
        """
        now = self.now
        if (step is None) == (to is None):
            raise UsageError(f"{owner}: advance takes a step or a time to reach; give one")
        if step is None:
            target = number(owner, "to", to)
            if target < now:
                raise ParameterError(
                    f"{owner}: to = {target:.12g} s is before the present time {now:.12g} s; go "
                    "back with restore or reset"
                )
            return target
        is_equal = isinstance(step, float | int) and step == self.length
        length = self.length if is_equal else number(owner, "step", step)
        if length < 0:
            raise ParameterError(
                f"{owner}: step = {length:g} s goes backwards; go back with restore or reset"
            )
        target = self.first + (self.count + 1) * length if is_equal else now + length
        if length and target == now:
            raise ParameterError(
                f"{owner}: step = {length:g} s is too short at {now:.12g} s to change the time; "
                "give a longer one"
            )
        return target

    def reach(self, target: float, step: float | None) -> None:
        """Set the time that such a call has reached, s."""
        if step == self.length:
            self.count += 1
        else:
            self.first, self.count = self.now, 1
            self.length = nan if step is None else float(step)
        self.now = target


def is_beyond(now: float, target: float, stop: float) -> bool:
    """Tell whether a step ends after the stop time, but for rounding as in an FMU."""
    length = target - now
    return target - stop > min(1e-9 * max(abs(now), length), length / 2)
