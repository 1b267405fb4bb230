"""`Life`: what sessions of models and of systems have in common."""

from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from enum import StrEnum
from typing import Any, NoReturn, Self
from weakref import finalize

from cosim.arrays import Vector
from cosim.errors import FmuError, naming_arguments
from cosim.model.values import number
from cosim.session.clock import Clock
from cosim.session.saved import unpicklable


class Phase(StrEnum):
    """What a session allows."""

    RUNNING = "running"
    ENDED = "ended"
    FAILED = "failed"
    CLOSED = "closed"


RUNNING = Phase.RUNNING  # each use of a member by its class takes 60 ns


class Life:
    """A model that stays alive until it is closed.

    Args:
        name: Of the model.
        values: Start values by name, of all resets.
    """

    _clock: Clock
    _phase: Phase
    _reason: str  # why the run has ended

    def __init__(self, name: str, values: Mapping[str, Any]) -> None:
        self.name = name
        self._start_values = dict(values) if isinstance(values, Mapping) else values
        self._stack = ExitStack()  # frees the model
        finalize(self, self._stack.close)

    __iter__ = None  # it has names, and no order

    def __enter__(self) -> Self:
        self._reject_closed()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"session of {self.name} at {self._clock.now:.12g} s, {self._phase}"

    def __reduce__(self) -> NoReturn:
        raise unpicklable(self.name)

    def close(self) -> None:
        """Free the model; nothing but `close` may be called afterwards."""
        self._phase = Phase.CLOSED
        self._stack.close()

    @property
    def time(self) -> float:
        """The present time, s."""
        return self._clock.now

    @property
    def stop(self) -> str | None:
        """Why the model has ended the run; None if it has not."""
        return self._reason if self._phase is Phase.ENDED else None

    def __getitem__(self, name: str) -> float:
        value: float = self.get((name,))[0]
        return float(value)

    @naming_arguments
    def reset(
        self,
        start_values: Mapping[str, float | str] | None = None,
        *,
        start_time: float | None = None,
    ) -> None:
        """Begin again.

        Args:
            start_values: Values by name that replace those of `cosim.open` for this time.
            start_time: s; that of `cosim.open` when None.

        Raises:
            UnknownName, UsageError, ParameterError, InitialConditionError: A name or a value does
                not fit; the session stays as it was.
            FmuError: The initialization failed, or the session is closed.
        """
        self._reject_closed()
        given: Any = {} if start_values is None else start_values
        if isinstance(given, Mapping):  # those of `cosim.open` hold for all other names
            given = {**self._start_values, **given}
        start = None if start_time is None else number(self.name, "start_time", start_time)
        self._begin_at(given, start)

    def _begin_at(self, given: Mapping[str, Any], start: float | None = None) -> None:
        """Begin with values by name at a time, s; at that of `cosim.open` when None."""
        raise NotImplementedError

    def get(self, names: Sequence[str] | None = None) -> Vector:
        """Return values, (n,)."""
        raise NotImplementedError

    def copy(self) -> Self:
        """Return another session in the present state."""
        raise NotImplementedError

    def __copy__(self) -> Self:
        return self.copy()

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return self.copy()

    def _reject_copy(self, abilities: Iterable[Any], *, serializes: bool) -> None:
        """Reject a copy of a session that does not run, or whose FMUs do not allow it.

        Args:
            abilities: Of the FMUs for co-simulation.
            serializes: Whether all of them write their states as bytes.
        """
        self._require()
        if not serializes:
            raise FmuError(
                f"{self.name} cannot write its state as bytes; it cannot be copied, but go back "
                "with save and restore"
            )
        if any(one.canBeInstantiatedOnlyOncePerProcess for one in abilities):
            raise FmuError(f"{self.name} allows one instance in a process; it cannot be copied")

    def _require(self) -> None:
        """Reject a call that a running session alone answers."""
        self._reject_closed()
        if self._phase is Phase.FAILED:
            raise FmuError(f"{self.name}: the session has failed; go on with restore or reset")
        if self._phase is Phase.ENDED:
            raise FmuError(
                f"{self.name}: the run has ended at {self.time:.12g} s ({self._reason}); go on "
                "with restore or reset"
            )

    def _reject_closed(self) -> None:
        if self._phase is Phase.CLOSED:
            raise FmuError(f"{self.name}: the session is closed; open it again")
