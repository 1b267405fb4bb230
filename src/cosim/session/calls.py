"""`PreparedCalls`: the C functions of one FMU instance, with arguments that are converted once."""

import ctypes
import struct
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np

from cosim.arrays import Vector
from cosim.errors import FmuError
from cosim.fmi.run.arrays import Layout
from cosim.fmi.run.c_structures import c_type
from cosim.fmi.run.description import is_second
from cosim.fmi.run.instance import layouts_of

OK, WARNING, DISCARD, ERROR, FATAL = range(5)  # statuses of FMI 2 and 3
_LAST_SUCCESSFUL_TIME = 2  # kinds of FMI 2's status
_TERMINATED = 3
_SIZE = ctypes.c_size_t
_DOUBLE = ctypes.c_double
_POINTER = ctypes.c_void_p
_NUMBER = struct.Struct("<Q")


class Step(NamedTuple):
    """Result of a communication step: status, the time reached, s, and whether the run ends."""

    status: int
    reached: float
    ends: bool


class Group:
    """Variables of one C type, with the arguments of the functions that get and set them.

    Attributes:
        get, set: Functions without arguments that read the values into the buffer, and set them
            to it; they return the status.
        getter: Name of the C function behind `get`.
        buffer: The values, which both functions use: arrays of FMI 3 as a whole.
        places: Of the variables, in the buffer.
        is_plain: Whether the buffer has their values and no others, in their order.
        columns: Places of the variables in the list that the user gave.
    """

    def __init__(
        self, calls: "PreparedCalls", kind: str, layout: Layout, columns: list[int]
    ) -> None:
        second = calls.second
        references = (ctypes.c_uint32 * len(layout.references))(*layout.references)
        values = (c_type(kind, second) * layout.values)()
        self.buffer = np.frombuffer(values, dtype=np.dtype(values._type_))
        self.places = layout.places
        self.is_plain = layout.places == list(range(layout.values))
        arguments = [calls.instance, references, _SIZE(len(references)), values]
        arguments += [] if second else [_SIZE(layout.values)]
        self.getter = f"fmi{2 if second else 3}Get{kind}"
        self.get: Callable[[], int] = partial(calls.function(f"Get{kind}"), *arguments)
        self.set: Callable[[], int] = partial(calls.function(f"Set{kind}"), *arguments)
        self.columns = columns


class PreparedCalls:
    """Functions of an FMU instance for co-simulation.

    Args:
        instance: Of fmpy.
        description: Of fmpy.
    """

    def __init__(self, instance: Any, description: Any) -> None:
        self.second = is_second(description)
        self._dll = instance.dll
        self._description = description
        self.instance = _POINTER(instance.component)
        self._time = _DOUBLE()
        self._length = _DOUBLE()
        self._last = _DOUBLE()
        flags = (ctypes.c_bool(), ctypes.c_bool(), ctypes.c_bool())
        _, self._ends, self._early = flags
        arguments: tuple[Any, ...] = (self.instance, self._time, self._length)
        if self.second:
            arguments += (ctypes.c_int(0),)
        else:
            results = [ctypes.byref(flag) for flag in flags]
            arguments += (ctypes.c_bool(False), *results, ctypes.byref(self._last))
        self._arguments = arguments

    @cached_property
    def _do_step(self) -> Callable[..., int]:
        return self.function("DoStep")  # which files for model exchange do not have

    def function(self, name: str) -> Callable[..., int]:
        """Return a function of the library, by its name in the FMI without prefix.

        Raises:
            FmuError: The library has no such function.
        """
        full = f"fmi{2 if self.second else 3}{name}"
        try:
            found: Callable[..., int] = self._dll[full]
        except AttributeError:
            raise FmuError(f"its library has no function {full}") from None
        found.restype = ctypes.c_uint  # type: ignore[attr-defined] # -1 is no good status
        return found

    def groups(self, variables: Sequence[Any]) -> list[Group]:
        """Return variables by their C types, in the order of their first occurrence."""
        return [Group(self, *layout) for layout in layouts_of(variables, self._description)]

    def step(self, time: float, length: float) -> Step:
        """Take a communication step from a time, s."""
        self._time.value, self._length.value = time, length
        self._last.value = time + length
        status = self._do_step(*self._arguments)
        if not self.second:
            ended, early = self._ends.value, self._early.value
            self._ends.value = self._early.value = False  # some files only write what is true
            if early and not ended and status <= WARNING:
                raise FmuError("it returned early from fmi3DoStep, which was not allowed")
            return Step(status, self._last.value, ended)
        if status != DISCARD:
            return Step(status, time + length, False)
        ends = ctypes.c_int()
        last = _DOUBLE(time)
        self.function("GetBooleanStatus")(self.instance, _TERMINATED, ctypes.byref(ends))
        if not ends.value:
            return Step(status, time, False)
        self.function("GetRealStatus")(self.instance, _LAST_SUCCESSFUL_TIME, ctypes.byref(last))
        return Step(OK, last.value, True)


class StateCalls:
    """Functions of an instance that save and restore its state.

    A state is the bytes that the FMU writes, or else the number of one that this process holds.

    Args:
        calls: Of the instance.
        check: Raises the error of a status.
        is_own: Whether the FMU was exported here.
        serializes: Whether it writes its state as bytes.

    Attributes:
        saved: Pointers to the states to free before the instance.
        free: The C function for it.
    """

    def __init__(
        self,
        calls: PreparedCalls,
        check: Callable[[int, str], None],
        *,
        is_own: bool,
        serializes: bool,
    ) -> None:
        state = "FMUstate" if calls.second else "FMUState"
        self._check = check
        self._instance = calls.instance
        self._serializes = serializes
        names = (f"Get{state}", f"Set{state}", f"Free{state}")
        self._take, self._put, freed = ((calls.function(name), name) for name in names)
        self.free = freed[0]
        if serializes:
            names = (
                f"Serialized{state}Size",
                f"Serialize{state}",
                f"{'DeSerialize' if calls.second else 'Deserialize'}{state}",
            )
            self._size_of, self._write, self._read = (
                (calls.function(name), name) for name in names
            )
        self._state = _POINTER()
        self._size = _SIZE()
        self._length = _SIZE()
        self.saved = [self._state]
        self._read_state = _POINTER()
        self._room = ctypes.create_string_buffer(0)
        self._at_state = ctypes.byref(self._state)
        self._at_size = ctypes.byref(self._size)
        self._read_place = ctypes.byref(self._read_state)
        self._is_own = is_own
        self._is_block = False

    def _call(self, call: tuple[Callable[..., int], str], *arguments: Any) -> None:
        status = call[0](*arguments)
        if status > WARNING:
            self._check(status, call[1])

    def save(self) -> bytes:
        """Return the state."""
        if not self._serializes:
            self.saved.append(_POINTER())  # freed even if the call fails
            self._call(self._take, self._instance, ctypes.byref(self.saved[-1]))
            return _NUMBER.pack(len(self.saved) - 1)
        self._call(self._take, self._instance, self._at_state)
        if self._is_block:
            return self._room.raw
        self._call(self._size_of, self._instance, self._state, self._at_size)
        size = self._size.value
        if len(self._room) != size:
            self._room = ctypes.create_string_buffer(size)
        self._call(self._write, self._instance, self._state, self._room, self._size)
        if self._is_own:  # its state is its bytes, wherever they are; see fmu/runtime/snapshot.h
            self.free(self._instance, self._at_state)
            self._state.value = ctypes.addressof(self._room)
            self.saved.clear()
            self._is_block = True
        return self._room.raw

    def restore(self, content: bytes, size: int) -> bool:
        """Set a state; return whether an FMU exported here accepts it.

        Args:
            content: Begins with what `save` has returned.
            size: Length of it.
        """
        if not self._serializes:
            self._call(self._put, self._instance, self.saved[_NUMBER.unpack_from(content)[0]])
            return True
        if self._is_block:
            same_length = size == len(self._room)
            return same_length and self._put[0](self._instance, content) <= WARNING
        self._length.value = size
        status = self._read[0](self._instance, content, self._length, self._read_place)
        if status > WARNING and self._is_own:
            return False
        self._check(status, self._read[1])
        try:
            self._call(self._put, self._instance, self._read_state)
        finally:
            self.free(self._instance, self._read_place)
        return True

    def holds(self, content: bytes) -> bool:
        """Tell whether a state that `save` has returned is not freed."""
        return self._serializes or _NUMBER.unpack_from(content)[0] < len(self.saved)


def free_states(instance: Any, free: Callable[..., int], saved: Sequence[Any]) -> None:
    """Free saved states, unless nothing of the FMU may be called any more.

    Args:
        instance: Of fmpy.
        free: The C function.
        saved: Pointers to the states.
    """
    if instance.fatal.value:
        return
    for state in saved:
        if state.value:
            free(_POINTER(instance.component), ctypes.byref(state))


class Jacobians:
    """Directional derivatives of unknowns by knowns.

    Args:
        calls: Of the instance.
        unknowns, knowns: Variables.
    """

    def __init__(
        self, calls: PreparedCalls, unknowns: Sequence[Any], knowns: Sequence[Any]
    ) -> None:
        self._function = calls.function("GetDirectionalDerivative")
        self.values: Vector = np.empty((len(knowns), len(unknowns)))
        rows = (ctypes.c_uint32 * len(unknowns))(*(v.valueReference for v in unknowns))
        self._columns = list(self._arguments(calls, rows, knowns)) if unknowns else []

    def _arguments(
        self, calls: PreparedCalls, rows: Any, knowns: Sequence[Any]
    ) -> Iterator[tuple[Any, ...]]:
        n, one, seed = _SIZE(len(rows)), _SIZE(1), (_DOUBLE * 1)(1.0)
        for known, column in zip(knowns, self.values, strict=True):
            reference = (ctypes.c_uint32 * 1)(known.valueReference)
            result = column.ctypes.data_as(_POINTER)
            given = (calls.instance, rows, n, reference, one, seed)
            yield (*given, result) if calls.second else (*given, one, result, n)

    def evaluate(self) -> int:
        """Compute the values, (knowns, unknowns); return the worst status."""
        return max((self._function(*arguments) for arguments in self._columns), default=OK)
