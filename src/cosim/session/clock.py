"""`target_of`: the time that a call of `advance` reaches."""

from cosim.errors import ParameterError, UsageError
from cosim.model.values import number


def target_of(owner: str, now: float, step: float | None, to: float | None) -> float:
    """Return the time to reach, s.

    Args:
        owner: Of the session, for errors.
        now: The present time, s.
        step, to: Arguments of `advance`, s.

    Raises:
        UsageError: None or both are given.
        ParameterError: The time is not finite or before the present one, or the step is too short.
    """
    if (step is None) == (to is None):
        raise UsageError(f"{owner}: advance takes a step or a time to reach; give one")
    if to is not None:
        target = number(owner, "to", to)
        if target < now:
            raise ParameterError(
                f"{owner}: to = {target:.12g} s is before the present time {now:.12g} s; go back "
                "with restore or reset"
            )
        return target
    length = number(owner, "step", step)
    if length < 0:
        raise ParameterError(
            f"{owner}: step = {length:g} s goes backwards; go back with restore or reset"
        )
    target = now + length
    if length > 0 and target == now:
        raise ParameterError(
            f"{owner}: step = {length:g} s is too short at {now:.12g} s to change the time; give a "
            "longer one"
        )
    return target
