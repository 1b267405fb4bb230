"""`PartStates`: the states of the parts of a system, saved and restored as one."""

import ctypes
import struct
from collections.abc import Iterator, Mapping
from typing import Any

from cosim.coupling.opened_part import OpenedPart, explained
from cosim.errors import FmuError
from cosim.session.calls import WARNING, PreparedCalls, StateCalls, free_states

_SIZE = struct.Struct("<Q")
_CALL = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)


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
        self._system, self._parts = system, parts
        self.serializes = all(part.abilities.canSerializeFMUstate for part in parts.values())
        self._calls = [_calls(part) for part in parts.values()] if self.serializes else []
        self._kept: list[list[ctypes.c_void_p]] = []

    def write(self) -> bytes:
        """Return the states as bytes."""
        found = []
        for calls, part in zip(self._calls, self._parts.values(), strict=True):
            with explained(self._system, part):
                found += [part.solver.numbers() if part.solver else b"", calls.save()]
        return b"".join(_SIZE.pack(len(one)) + one for one in found)

    def read(self, content: bytes) -> None:
        """Set the states that bytes describe.

        Raises:
            FmuError: A part rejects its state.
        """
        pieces = _pieces(content)
        for calls, part in zip(self._calls, self._parts.values(), strict=True):
            numbers, state = next(pieces), next(pieces)
            with explained(self._system, part):
                if not calls.restore(state, len(state)) or (
                    part.solver and not part.solver.go_on_with(numbers)
                ):
                    raise FmuError("it rejects the saved state")

    def keep(self) -> int:
        """Save the states in this process; return their number."""
        states = [ctypes.c_void_p() for _ in self._parts]
        self._kept.append(states)  # so that all are freed, whichever part fails
        for part, state in zip(self._parts.values(), states, strict=True):
            self._call(part, "get_fmu_state", ctypes.byref(state))
        return len(self._kept) - 1

    def go_back(self, number: int) -> None:
        """Set the states of a number."""
        for part, state in zip(self._parts.values(), self._kept[number], strict=True):
            self._call(part, "set_fmu_state", state)

    def free(self) -> None:
        """Free the states before the instances."""
        if self.serializes:
            for calls, part in zip(self._calls, self._parts.values(), strict=True):
                free_states(part.instance, calls.free, calls.saved)
        for states in self._kept:
            for part, state in zip(self._parts.values(), states, strict=True):
                functions = part.functions
                if state.value and not part.instance.fatal.value:
                    _CALL(functions.free_fmu_state)(functions.stepper, ctypes.byref(state))

    def _call(self, part: OpenedPart, field: str, place: Any) -> None:
        functions = part.functions
        status = _CALL(getattr(functions, field))(functions.stepper, place)
        if status > WARNING:
            call = f"{part.function_name(field.encode())} returned {status}"
            raise FmuError(f"{self._system}: part '{part.name}': {part.explained(FmuError(call))}")


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
            raise FmuError(f"{function} returned {status}")

    return StateCalls(calls, check, is_own=part.is_own)
