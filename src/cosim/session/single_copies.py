"""`SingleCopies`: copies of a model that are sessions of their own."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from cosim.arrays import Integers, Vector
from cosim.errors import CosimError, FmuError
from cosim.session.session import Session
from cosim.session.system_session import SystemSession
from cosim.trajectory import Event


class SingleCopies:
    """Copies that are advanced one after the other; see `Engine`.

    Args:
        sessions: Of the same model.
    """

    def __init__(self, sessions: Sequence[Session | SystemSession]) -> None:
        first = sessions[0]
        self._sessions = sessions
        self.name, self.inputs, self.outputs = first.name, first.inputs, first.outputs
        self.states = first.states
        self.reasons: dict[int, str] = {}
        self.invalid: dict[int, str] = {}
        self.owner = first.identity().hex()
        self._failed: set[int] = set()  # copies without values

    def begin(self, values: Mapping[str, Any], time: float, rows: Integers) -> None:
        """Begin copies again; see `Engine.begin`."""
        owns = [_of(values, place) for place in range(len(rows))]
        for number, own in zip(rows.tolist(), owns, strict=True):  # before any begins
            with _naming(number):
                self._sessions[number].checked(own)
        for number, own in zip(rows.tolist(), owns, strict=True):
            self.reasons.pop(number, None)
            self._failed.discard(number)
            try:
                self._sessions[number].reset(own, start_time=time)
            except FmuError as error:  # the others begin all the same
                self.reasons[number] = str(error)
                self._failed.add(number)
            self._note_validity(number)

    def advance(self, time: float, target: float) -> dict[int, tuple[Event, ...]]:
        """Integrate; see `Engine.advance`."""
        events = {}
        for number, session in enumerate(self._sessions):
            if number in self.reasons:
                continue
            try:
                found = session.advance(to=target)
            except FmuError as error:
                self.reasons[number] = str(error)
                self._failed.add(number)
                continue
            if session.stop is not None:
                self.reasons[number] = f"{session.stop} from {session.time:.12g} s on"
            if found:
                events[number] = found
            self._note_validity(number)
        return events

    def _note_validity(self, number: int) -> None:
        self.invalid.pop(number, None)
        if (found := self._sessions[number].invalid) is not None:
            self.invalid[number] = found

    def set(self, values: Mapping[str, Any]) -> None:
        """Set inputs and tunable parameters; see `Engine.set`."""
        before = dict[int, dict[str, Any]]()
        try:
            for number in np.setdiff1d(np.arange(len(self._sessions)), [*self.reasons]).tolist():
                with _naming(number):
                    own = _of(values, number)
                    present = self._sessions[number].present(own)
                    self._sessions[number].set(own)
                before[number] = present
        except CosimError:
            for number, present in before.items():
                self._sessions[number].set(present)
            raise

    def get(self, names: tuple[str, ...], time: float) -> Vector:
        """Return values; see `Engine.get`."""
        table = np.full((len(names), len(self._sessions)), np.nan)
        for number, session in enumerate(self._sessions):
            if number not in self._failed:
                with _naming(number):
                    table[:, number] = session.get(names)
        return table

    def save(self) -> dict[str, Vector]:
        """Return the state as arrays, without that of copies whose runs have ended."""
        saved = [
            b"" if number in self.reasons else session.save()
            for number, session in enumerate(self._sessions)
        ]
        lengths = np.array([len(content) for content in saved])
        return {"lengths": lengths, "content": np.frombuffer(b"".join(saved), dtype=np.uint8)}

    def fits(self, arrays: Mapping[str, Vector]) -> bool:
        """Tell whether arrays may be a saved state; see `Engine.fits`."""
        known = arrays.keys() == {"lengths", "content"}
        if not known or arrays["lengths"].shape != (len(self._sessions),):
            return False
        for number, state in self._states_in(arrays).items():  # before any is set
            with _naming(number):
                self._sessions[number].checked_state(state)
        return True

    def restore(self, arrays: Mapping[str, Vector]) -> dict[int, str]:
        """Set a saved state; see `Engine.restore`."""
        states, rejected = self._states_in(arrays), dict[int, str]()
        for number, state in states.items():
            try:
                self._sessions[number].restore(state)
            except CosimError as error:
                rejected[number] = str(error)
        self._failed = {*range(len(self._sessions))} - {*states} | {*rejected}
        return rejected

    def _states_in(self, arrays: Mapping[str, Vector]) -> dict[int, bytes]:
        """Return the saved states by number of the copy, of those that have one."""
        states = np.split(arrays["content"], np.cumsum(arrays["lengths"])[:-1])
        return {number: state.tobytes() for number, state in enumerate(states) if state.size}


def _of(values: Mapping[str, Any], place: int) -> dict[str, Any]:
    """Return the values of one copy."""
    return {name: v if np.ndim(v) == 0 else v[place].item() for name, v in values.items()}


@contextmanager
def _naming(number: int) -> Iterator[None]:
    """Name the copy in errors."""
    try:
        yield
    except CosimError as error:
        raise type(error)(f"copy {number}: {error}") from error
