"""The C structures of fmu/master: the FMU, its recorded variables, the run and its result."""

import ctypes
from collections.abc import Sequence
from enum import IntEnum
from typing import Any

import numpy as np

from cosim.arrays import Vector
from cosim.codegen.c_fields import fields
from cosim.errors import FmuError
from cosim.fmi.run.arrays import Layout
from cosim.fmi.run.description import is_second
from cosim.fmi.run.instance import layouts_of
from cosim.fmi.run.request import nominals_of

# Kinds of variables, in the order of the enumeration in fmu/master/recording.h
KINDS: dict[str, Any] = {
    "Float64": ctypes.c_double, "Float32": ctypes.c_float, "Int8": ctypes.c_int8,
    "UInt8": ctypes.c_uint8, "Int16": ctypes.c_int16, "UInt16": ctypes.c_uint16,
    "Int32": ctypes.c_int32, "UInt32": ctypes.c_uint32, "Int64": ctypes.c_int64,
    "UInt64": ctypes.c_uint64, "Boolean": ctypes.c_bool, "String": ctypes.c_char_p,
}  # fmt: skip
_GETTERS_2 = {"Real": "Float64", "Integer": "Int32", "Boolean": "Int32", "String": "String"}

# Fields of `Functions` in fmu/master/fmu.h: their names in FMI 2 and 3
_FUNCTIONS = {
    "set_time": ("SetTime", "SetTime"),
    "get_states": ("GetContinuousStates", "GetContinuousStates"),
    "set_states": ("SetContinuousStates", "SetContinuousStates"),
    "get_derivatives": ("GetDerivatives", "GetContinuousStateDerivatives"),
    "get_indicators": ("GetEventIndicators", "GetEventIndicators"),
    "enter_event_mode": ("EnterEventMode", "EnterEventMode"),
    "enter_continuous_time_mode": ("EnterContinuousTimeMode", "EnterContinuousTimeMode"),
    "enter_step_mode": (None, "EnterStepMode"),
    "new_discrete_states": ("NewDiscreteStates", None),
    "update_discrete_states": (None, "UpdateDiscreteStates"),
    "completed_step_2": ("CompletedIntegratorStep", None),
    "completed_step_3": (None, "CompletedIntegratorStep"),
    "do_step_2": ("DoStep", None),
    "do_step_3": (None, "DoStep"),
    "get_boolean_status": ("GetBooleanStatus", None),
    "get_real_status": ("GetRealStatus", None),
    "set_input_derivatives": ("SetRealInputDerivatives", None),
    "output_derivatives_2": ("GetRealOutputDerivatives", None),
    "output_derivatives_3": (None, "GetOutputDerivatives"),
    "directional_2": ("GetDirectionalDerivative", None),
    "directional_3": (None, "GetDirectionalDerivative"),
    "get_fmu_state": ("GetFMUstate", "GetFMUState"),
    "set_fmu_state": ("SetFMUstate", "SetFMUState"),
    "free_fmu_state": ("FreeFMUstate", "FreeFMUState"),
}
_NO_COLUMN = -1  # of an element that is not recorded


def _kind(getter: str, second: bool) -> str:
    """Return the kind of variables that a getter is for, e.g. of fmi2GetReal."""
    return _GETTERS_2[getter] if second else getter


def c_type(getter: str, second: bool) -> Any:
    """Return the C type of the values of a getter, by the type in its name."""
    return KINDS[_kind(getter, second)]


class Functions(ctypes.Structure):
    """Addresses of an FMU's functions and of its instance."""

    _fields_ = fields("master/fmu.h", "Functions")

    def named(self, field: bytes) -> str:
        """Return the name in the FMI of the function of a field; another text as it is."""
        names = _FUNCTIONS.get(field.decode())
        return f"fmi{self.version}{names[self.version - 2]}" if names else field.decode()


class _Group(ctypes.Structure):
    """Variables of one kind."""

    _fields_ = fields("master/recording.h", "Group")


class Recording(ctypes.Structure):
    """The recorded variables, and the rows to write."""

    _fields_ = fields("master/recording.h", "Recording", group=ctypes.POINTER(_Group))


NOTE = ctypes.CFUNCTYPE(None, ctypes.c_double, ctypes.POINTER(ctypes.c_double), ctypes.c_bool)
_PARTS = {"functions": ctypes.POINTER(Functions), "recording": ctypes.POINTER(Recording)}


class Run(ctypes.Structure):
    """A whole run: the request, then the results."""

    _fields_ = fields("master/run.h", "Run", note=NOTE, **_PARTS)


class Ending(IntEnum):
    """The end of a run, as in fmu/master/run.h."""

    DONE, CALL_FAILED, ENDED_BY_FMU, STUCK, EARLY_RETURN = range(5)
    STEP_VANISHED, INTERRUPTED, NOT_A_NUMBER = range(5, 8)


class Recorded:
    """The recorded variables as C structures, without the rows; owns the arrays."""

    def __init__(self, instance: Any, description: Any, variables: Sequence[Any]) -> None:
        second = is_second(description)
        self._held: list[Any] = []
        groups, columns = list[_Group](), list[Vector]()
        for getter, layout, places in layouts_of(variables, description):
            groups.append(self._group(instance, getter, layout, second))
            columns.append(np.full(layout.values, _NO_COLUMN))
            columns[-1][layout.places] = places
        self._groups = (_Group * len(groups))(*groups)
        self._columns = np.concatenate([[], *columns]).astype(np.int64)
        self.structure = Recording(
            len(groups), len(variables), self._groups, self._columns.ctypes.data
        )

    def _group(self, instance: Any, getter: str, layout: Layout, second: bool) -> _Group:
        kind = _kind(getter, second)
        names = [f"fmi{2 if second else 3}{verb}{getter}" for verb in ("Get", "Set")]
        functions = [
            a for verb in ("Get", "Set") for a in addresses_of(instance, verb, getter, second)
        ]
        addresses = (ctypes.c_uint32 * len(layout.references))(*layout.references)
        buffer = (KINDS[kind] * layout.values)()
        self._held += [addresses, buffer]
        return _Group(
            list(KINDS).index(kind),
            len(layout.references),
            layout.values,
            ctypes.addressof(addresses),
            *functions,
            *(name.encode() for name in names),
            ctypes.addressof(buffer),
        )


class Calls:
    """The functions of an instance of fmpy's, and what records its variables, looked up once."""

    def __init__(self, instance: Any, description: Any) -> None:
        self._instance, self._description = instance, description
        version = 2 if is_second(description) else 3
        found = {
            field: _address(instance, f"fmi{version}{name}")
            for field, names in _FUNCTIONS.items()
            if (name := names[version - 2]) is not None
        }
        own = instance.component
        fatal = ctypes.addressof(instance.fatal)
        self.functions = Functions(
            version=version, instance=own, stepper=own, is_fatal=fatal, **found
        )
        self._recorded: dict[tuple[Any, ...], Recorded] = {}

    def recording(self, variables: Sequence[Any], rows: Vector) -> Recording:
        """Return what records variables into rows, (times, variables)."""
        key = tuple(variables)
        if key not in self._recorded:
            self._recorded = {key: Recorded(self._instance, self._description, variables)}
        structure = self._recorded[key].structure
        structure.rows = rows.ctypes.data
        return structure


def exchange_run(
    instance: Any, description: Any, calls: Calls, shares: Vector | float = 1.0, **facts: Any
) -> tuple[Run, Vector]:
    """Return a run in model exchange, and the nominal values, which must live as long as it.

    Args:
        instance: Of fmpy, past its initialization.
        description: Of fmpy.
        calls: Of the instance.
        shares: Of the absolute tolerance of each state, (states,).
        facts: More fields of the run.
    """
    n = description.numberOfContinuousStates
    nominals = np.append(nominals_of(instance, n) * shares, 1.0)
    run = Run(
        functions=ctypes.pointer(calls.functions),
        states=n,
        indicators=description.numberOfEventIndicators,
        needs_completed_step=description.modelExchange.needsCompletedIntegratorStep,
        nominals=nominals.ctypes.data,
        **facts,
    )
    return run, nominals


def addresses_of(
    instance: Any, verb: str, getter: str, second: bool
) -> tuple[int | None, int | None]:
    """Return where the function of FMI 2 is that gets or sets a type, and where that of FMI 3."""
    address = _address(instance, f"fmi{2 if second else 3}{verb}{getter}")
    return (address, None) if second else (None, address)


def _address(instance: Any, name: str) -> int | None:
    """Return where a function of an FMU's library is; None where it has none of this name."""
    function = getattr(instance.dll, name, None)
    return None if function is None else ctypes.cast(function, ctypes.c_void_p).value


def reject_failure(run: Run, interrupts: Sequence[int], stop: float) -> None:
    """Raise the error of a run that failed, in fmpy's words if fmpy has this error."""
    from fmpy.fmi1 import FMICallException

    if interrupts or run.how == Ending.INTERRUPTED:
        raise KeyboardInterrupt
    if run.how == Ending.CALL_FAILED:
        name = run.functions.contents.named(run.function)
        if run.status < 0:
            raise FmuError(f"{name} returned {run.status}, which is no status of the FMI")
        raise FMICallException(function=name, status=run.status)
    if run.how == Ending.EARLY_RETURN:
        raise FmuError("FMU returned early from doStep() but Early Return is not allowed.")
    if run.how == Ending.STEP_VANISHED:
        raise FmuError(f"dop853: step size too small, or too many steps, at t = {run.time:g} s")
    if run.how != Ending.ENDED_BY_FMU and (run.how != Ending.DONE or run.rows < run.points):
        raise FmuError(f"the run ended at {run.time:g} s, before the stop time {stop:g} s")
