"""CVODE for model exchange: the solver class of fmpy, with errors that reach the caller.

ctypes prints and forgets an exception that is raised within a callback. Here the callback stops
CVODE, and `step` raises the exception.
"""

import ctypes
from collections.abc import Callable, Sequence
from typing import Any

from fmpy.fmi2 import fmi2Discard
from fmpy.sundials import CVodeSolver
from fmpy.sundials.cvode import CVodeSVtolerances
from fmpy.sundials.libraries import sundials_core, sundials_cvode
from fmpy.sundials.sundials_context import SUNContext_PushErrHandler

USUAL_STEPS = 500  # of fmpy and of CVODE, from one output time to the next
MOST_STEPS = 20_000  # a second of a small FMU
_STOP = -1  # a callback's result that CVODE takes as an error
_SHORTER = 1  # and one for which it takes a shorter step

_step_count = sundials_cvode.CVodeGetNumSteps
_step_count.argtypes = [ctypes.c_void_p, ctypes.POINTER(ctypes.c_long)]
_step_count.restype = ctypes.c_int
_most_warnings = sundials_cvode.CVodeSetMaxHnilWarns
_most_warnings.argtypes = [ctypes.c_void_p, ctypes.c_int]
_clear_error_handlers = sundials_core.SUNContext_ClearErrHandlers
_clear_error_handlers.argtypes = [ctypes.c_void_p]
_NONE = -1  # of the warnings that time does not change in a step: intervals of inputs may be short


class Cvode(CVodeSolver):  # type: ignore[misc]
    """CVODE with the settings of `fmpy.simulate_fmu`, but for the number of steps.

    Args:
        interrupts: A list that is no longer empty after Ctrl-C.
        settings: Of fmpy's `CVodeSolver`.

    Attributes:
        rhs_calls: Evaluations of the derivatives.
        many_steps: Begin and end of the first call with more than `USUAL_STEPS` steps, s.
    """

    def __init__(self, interrupts: Sequence[int], **settings: Any) -> None:
        self.rhs_calls = 0
        self.many_steps: tuple[float, float] | None = None
        self._interrupts = interrupts
        self._error: Exception | None = None
        self.cvode_mem = None  # fmpy frees it, even if the FMU fails before it is made
        super().__init__(maxNumSteps=MOST_STEPS, **settings)
        _most_warnings(self.cvode_mem, _NONE)
        _clear_error_handlers(self.sunctx)  # one of them prints what the exception says
        SUNContext_PushErrHandler(self.sunctx, self.ehfun_, None)

    def f(self, *arguments: Any) -> int:
        """Evaluate the derivatives; where the FMU discards that, a shorter step is taken."""
        self.rhs_calls += 1
        self._error = None
        result = self._guarded(super().f, arguments)
        return _SHORTER if getattr(self._error, "status", None) == fmi2Discard else result

    def g(self, *arguments: Any) -> int:
        """Evaluate the event indicators."""
        return self._guarded(super().g, arguments)

    def step(self, time: float, target: float) -> tuple[bool, Any, float]:
        """Integrate to a time or to the first state event before it.

        Args:
            time, target: s.

        Returns:
            Whether there is a state event, which indicators changed sign, and the time reached, s.

        Raises:
            Exception: CVODE failed, or a call of the FMU did.
            KeyboardInterrupt: The user pressed Ctrl-C.
        """
        before = self.steps
        try:
            found: tuple[bool, Any, float] = super().step(time, target)
        except Exception as error:
            if self._interrupts:
                raise KeyboardInterrupt from error
            raise self._error or error from None
        if self.many_steps is None and self.steps - before > USUAL_STEPS:
            self.many_steps = time, target
        return found

    def reset(self, time: float) -> None:
        """Start afresh with present nominal values, which fmpy reads but does not use."""
        super().reset(time)
        CVodeSVtolerances(self.cvode_mem, self.reltol, self.abstol)

    @property
    def steps(self) -> int:
        """Number of steps since the last event."""
        count = ctypes.c_long()
        _step_count(self.cvode_mem, ctypes.byref(count))
        return count.value

    def _guarded(self, function: Callable[..., int], arguments: tuple[Any, ...]) -> int:
        if self._interrupts:
            return _STOP
        try:
            return function(*arguments)
        except Exception as error:
            self._error = error
            return _STOP
