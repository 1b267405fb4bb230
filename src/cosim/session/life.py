"""`Life`: what sessions of models and of systems have in common."""

from collections.abc import Sequence
from contextlib import ExitStack
from enum import StrEnum
from typing import Any, NoReturn, Self

from cosim.arrays import Vector
from cosim.errors import FmuError
from cosim.session.clock import Clock
from cosim.session.saved import unpicklable
from cosim.trajectory import Event


class Phase(StrEnum):
    """What a session allows."""

    RUNNING = "running"
    ENDED = "ended"
    FAILED = "failed"
    CLOSED = "closed"


class Life:
    """A model that stays alive until it is closed.

    Attributes:
        name: Of the model.
    """

    name: str
    _clock: Clock
    _phase: Phase
    _reason: str  # why the run has ended
    _stack: ExitStack  # frees the model

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

    def get(self, names: Sequence[str] | None = None) -> Vector:
        """Return values, (n,)."""
        raise NotImplementedError

    def advance(self, step: float | None = None, *, to: float | None = None) -> tuple[Event, ...]:
        """Integrate with constant inputs; return the events."""
        raise NotImplementedError

    def save(self) -> bytes:
        """Return the state."""
        raise NotImplementedError

    def restore(self, saved: bytes) -> None:
        """Set a saved state."""
        raise NotImplementedError

    def copy(self) -> Self:
        """Return another session in the present state."""
        raise NotImplementedError

    def __copy__(self) -> Self:
        return self.copy()

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return self.copy()

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
