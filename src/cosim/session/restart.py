"""`Restart`: reset and initialization of an instance by prepared calls."""

import ctypes
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from cosim.session.calls import WARNING, PreparedCalls


class Experiment(NamedTuple):
    """What an FMU learns of a run: times in s and tolerance, by the names of fmpy."""

    startTime: float  # noqa: N815
    stopTime: float | None  # noqa: N815
    tolerance: float | None


class Restart:
    """The calls of `begin_initialization`, for start values of the same names.

    Args:
        calls: Of the instance.
        variables: Whose start values are set, all of them before initialization mode.
        bounds: Least and largest values by name.
    """

    def __init__(
        self,
        calls: PreparedCalls,
        variables: Sequence[Any],
        bounds: Mapping[str, tuple[float, float]],
    ) -> None:
        self._bounds = tuple(bounds.values())
        self._group = calls.groups(variables)[0] if variables else None
        self._instance = calls.instance
        self._second = calls.second
        names = ("Reset", "EnterInitializationMode", "ExitInitializationMode")
        self._reset, self._enter, self._leave = (calls.function(name) for name in names)
        self._setup = calls.function("SetupExperiment") if calls.second else None

    def accepts(self, values: Mapping[str, Any]) -> bool:
        """Tell whether all values are numbers within their bounds, so that no check rejects one."""
        pairs = zip(values.values(), self._bounds, strict=True)
        return all(type(value) is float and low <= value <= high for value, (low, high) in pairs)

    def run(self, values: Mapping[str, float], experiment: Experiment) -> tuple[int, str]:
        """Reset and initialize; return the worst status and the function that returned it."""
        worst = self._reset(self._instance), "Reset"
        if self._group is not None and worst[0] <= WARNING:
            self._group.buffer[:] = [*values.values()]
        for name, call, arguments in self._steps(experiment):
            if worst[0] > WARNING:
                break
            worst = max(worst, (call(*arguments), name))
        return worst

    def _steps(self, experiment: Experiment) -> list[tuple[str, Any, tuple[Any, ...]]]:
        start, stop, tolerance = experiment
        double = ctypes.c_double
        instance = self._instance
        span = (double(start), stop is not None, double(stop or 0.0))
        facts = (tolerance is not None, double(tolerance or 0.0), *span)
        found: list[tuple[str, Any, tuple[Any, ...]]] = []
        if self._setup is not None:
            found.append(("SetupExperiment", self._setup, (instance, *facts)))
        if self._group is not None:
            found.append(("Set", self._group.set, ()))
        enter = (instance,) if self._second else (instance, *facts)
        found.append(("EnterInitializationMode", self._enter, enter))
        found.append(("ExitInitializationMode", self._leave, (instance,)))
        return found
