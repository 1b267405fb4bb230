"""The solver of a part for model exchange: fmu/master/exchange_part.h for one instance."""

import ctypes
from typing import Any

import numpy as np

from cosim.codegen.c_fields import fields
from cosim.codegen.c_sources import master_source
from cosim.codegen.compiler import cached_library
from cosim.codegen.runge_kutta.stage_sums import dop853_coefficients
from cosim.fmi.run.c_structures import Calls, Functions, Run, addresses_of, exchange_run
from cosim.fmi.run.description import is_second
from cosim.memo import cached_per_thread


class _Model(ctypes.Structure):
    """`Model` in fmu/master/exchange_part.h."""

    _fields_ = fields("master/exchange_part.h", "Model", run=Run, steps=ctypes.POINTER(Functions))


class ExchangeSolver:
    """Steps an instance for model exchange, which is in event mode after its initialization.

    Args:
        instance, description, calls: Of fmpy, and its functions.
        inputs: Address of a C function that sets the inputs of a time; 0 if they are constant
            within a step.
        saves: Whether the FMU saves its state. Otherwise time and continuous states are its state.
        experiment: `startTime`, `stopTime` [s], and the relative `tolerance` of the solver.

    Attributes:
        functions: Those of the part; steps and states are the solver's.
    """

    def __init__(
        self,
        instance: Any,
        description: Any,
        calls: Calls,
        *,
        inputs: int,
        saves: bool,
        **experiment: float,
    ) -> None:
        start, stop, relative = (experiment[n] for n in ("startTime", "stopTime", "tolerance"))
        run, nominals = exchange_run(
            instance, description, calls, start=start, stop=stop, relative_tolerance=relative
        )
        self._held = nominals, calls
        self.functions = Functions()
        getter = "Real" if is_second(description) else "Float64"
        get_2, get_3 = addresses_of(instance, "Get", getter, is_second(description))
        self._model = _Model(
            run=run,
            inputs=inputs,
            get_2=get_2,
            get_3=get_3,
            saves=saves,
            steps=ctypes.pointer(self.functions),
        )
        self._library = _library(max(run.states, 1), max(run.indicators, 1))
        if self._library.open_model(ctypes.byref(self._model)):
            raise MemoryError

    def failed_function(self, field: bytes) -> bytes:
        """Return the field of `Functions` or the words for what has failed in a call."""
        own = getattr(self.functions, field.decode(), None)
        replaced = own and own != getattr(self._model.run.functions.contents, field.decode())
        return (self._model.run.function if replaced else None) or field

    def numbers(self) -> bytes:
        """Return what the solver's next step begins with, beside the state of the FMU."""
        found = np.empty(self._library.numbers_of_model(ctypes.byref(self.functions), None, 0))
        self._library.numbers_of_model(ctypes.byref(self.functions), found.ctypes.data, 0)
        return found.tobytes()

    def go_on_with(self, numbers: bytes) -> bool:
        """Set these; return whether the FMU accepts its time and its states."""
        own = np.frombuffer(numbers).copy()
        functions = ctypes.byref(self.functions)
        return int(self._library.numbers_of_model(functions, own.ctypes.data, 1)) == len(own)

    def close(self) -> None:
        """Free the solver."""
        self._library.close_model(ctypes.byref(self.functions))


@cached_per_thread(8)
def _library(states: int, indicators: int) -> ctypes.CDLL:
    sizes = f"#define NX {states}\n#define NZ {indicators}\n"
    coefficients = dop853_coefficients().replace('#include "dop853.h"\n', "")
    text = sizes + master_source("exchange_part.h") + coefficients
    library = ctypes.CDLL(str(cached_library(f"master {text}", lambda: text)))
    library.numbers_of_model.argtypes = [ctypes.POINTER(Functions), ctypes.c_void_p, ctypes.c_int]
    library.numbers_of_model.restype = ctypes.c_longlong
    return library
