"""`PartStates`: the states of the parts of a system, saved and restored as one."""

import struct
from collections.abc import Iterator, Mapping

from cosim.coupling.opened_part import OpenedPart, explained
from cosim.errors import FmuError
from cosim.session.calls import WARNING, PreparedCalls, StateCalls, free_states

_SIZE = struct.Struct("<Q")


class PartStates:
    """The states of parts that are past their initialization.

    Args:
        system: Its name.
        parts: By name.

    Attributes:
        serializes: Whether all parts write their states as bytes.

    Raises:
        FmuError: A part cannot save its state.
    """

    def __init__(self, system: str, parts: Mapping[str, OpenedPart]) -> None:
        # one for model exchange may go back within a step, where nothing but its states changes
        if fixed := [name for name, part in parts.items() if not (part.saves and part.rolls_back)]:
            raise FmuError(
                f"{system} cannot save its state, as {', '.join(fixed)} cannot; begin again with "
                "reset"
            )
        self._system = system
        self._parts = [(part, _calls(part)) for part in parts.values()]
        self.serializes = all(part.abilities.canSerializeFMUstate for part in parts.values())

    def save(self) -> bytes:
        """Return the states."""
        found = []
        for part, calls in self._parts:
            with explained(self._system, part):
                found += [part.solver.numbers() if part.solver else b"", calls.save()]
        return b"".join(_SIZE.pack(len(one)) + one for one in found)

    def restore(self, content: bytes) -> None:
        """Set the states that `save` has returned.

        Raises:
            FmuError: A part rejects its state.
        """
        pieces = _pieces(content)
        for part, calls in self._parts:
            numbers, state = next(pieces), next(pieces)
            with explained(self._system, part):
                if not calls.restore(state, len(state)) or (
                    part.solver and not part.solver.go_on_with(numbers)
                ):
                    raise FmuError("it rejects the saved state")

    def free(self) -> None:
        """Free the states before the instances."""
        for part, calls in self._parts:
            free_states(part.instance, calls.free, calls.saved)


def _pieces(content: bytes) -> Iterator[bytes]:
    place = 0
    while place < len(content):
        (size,) = _SIZE.unpack_from(content, place)
        place += _SIZE.size + size
        yield content[place - size : place]


def _calls(part: OpenedPart) -> StateCalls:
    calls = PreparedCalls(part.instance, part.description)

    def check(status: int, function: str) -> None:
        if status > WARNING:
            raise FmuError(f"fmi{2 if calls.second else 3}{function} returned {status}")

    serializes = bool(part.abilities.canSerializeFMUstate)
    return StateCalls(calls, check, is_own=part.is_own, serializes=serializes)
