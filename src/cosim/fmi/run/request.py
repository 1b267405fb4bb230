"""What is asked of a run of an FMU, checked against its description."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from cosim.arrays import Vector
from cosim.errors import ParameterError, UnknownName, UsageError
from cosim.fmi.run.instance import by_name, is_number, may_be_set
from cosim.model.inputs import InputSeries
from cosim.model.time_grid import time_grid
from cosim.model.values import listed, number
from cosim.trajectory import Column

_CONTINUOUS = ("Real", "Float64")
MOST_POINTS = 10_000_000  # output times; fmpy keeps them as Python objects


@dataclass(frozen=True)
class Span:
    """When a run begins, ends and is recorded, s."""

    start: float
    stop: float
    interval: float

    @property
    def times(self) -> Vector:
        """The output times, (n,)."""
        return time_grid(self.start, self.stop, self.interval)


def span_of(
    path: object,
    description: Any,
    start: float | None,
    stop: float | None,
    interval: float | None,
) -> Span:
    """Fill in the FMU's default experiment; fmpy itself has other ideas of the interval."""
    experiment = description.defaultExperiment

    def default(name: str, otherwise: float) -> float:
        value = getattr(experiment, name, None)
        return otherwise if value is None else float(value)

    start = number(str(path), "start_time", default("startTime", 0.0) if start is None else start)
    length = default("stopTime", default("startTime", 0.0) + 1) - default("startTime", 0.0)
    stop = number(str(path), "stop_time", start + length if stop is None else stop)
    if stop < start:
        raise ParameterError(
            f"{path}: stop_time = {stop:g} s lies before start_time = {start:g} s; "
            "give a later stop"
        )
    if interval is None:
        interval = default("stepSize", (stop - start) / 500) or 1.0
    interval = number(str(path), "output_interval", interval, positive=True)
    if (stop - start) / interval > MOST_POINTS:
        raise ParameterError(
            f"{path}: output_interval = {interval:g} s makes {(stop - start) / interval:.3g} "
            "output times; give a larger one"
        )
    return Span(start, stop, interval)


def tolerance_of(path: object, relative: float | None) -> float | None:
    """Return a tolerance, or refuse it."""
    if relative is None:
        return None
    if number(str(path), "relative_tolerance", relative, positive=True) > 0.1:
        raise ParameterError(f"{path}: relative_tolerance = {relative:g} is above 0.1")
    return float(relative)


def given_numbers(
    path: object, variables: Mapping[str, Any], start: Mapping[str, float]
) -> dict[str, float]:
    """Return start values by name, or refuse them."""
    if not isinstance(start, Mapping):
        raise UsageError.of_type(f"{path}: start", start, "values by name, e.g. {'phi': 0.1}")
    for name in start:
        if name not in variables:
            settable = [v.name for v in variables.values() if _is_settable(v)]
            raise UnknownName.among(str(path), "start value", name, settable)
        if not _is_settable(variables[name]):
            raise UsageError(f"{path}: {name} cannot be set; it is calculated, or not a number")
    return {variables[name].name: number(str(path), name, value) for name, value in start.items()}


def _is_settable(variable: Any) -> bool:
    return may_be_set(variable) and is_number(variable)


def recorded(
    path: object, variables: Mapping[str, Any], outputs: Sequence[str] | None
) -> list[str]:
    """Return the names to record, each once; the FMU's outputs when None."""
    if outputs is None:
        return [
            n
            for n, v in variables.items()
            if v.causality == "output" and is_number(v) and n == v.name
        ]
    wanted = listed(f"{path}: outputs", outputs)
    for name in wanted:
        if name not in variables:
            raise UnknownName.among(str(path), "output", name, variables)
        if not is_number(variables[name]):
            raise UsageError(f"{path}: {name} is not a single number and cannot be recorded")
    return list(dict.fromkeys(variables[name].name for name in wanted))


def input_variables(description: Any) -> dict[str, Any]:
    """Return the inputs by name."""
    return {n: v for n, v in by_name(description).items() if v.causality == "input"}


def refuse_series(
    path: object, description: Any, series: InputSeries | None, values: Mapping[str, float]
) -> None:
    """Refuse a series of what is no input, of no real number, or that has a constant value, too.

    Raises:
        UnknownName: There is no such input.
        UsageError: It cannot follow a series.
    """
    known = input_variables(description)
    for name in series.names if series else ():
        if name not in known:
            raise UnknownName.among(str(path), "input", name, known)
        if known[name].type not in _CONTINUOUS or known[name].dimensions:
            raise UsageError(f"{path}: {name} is no real number; give it a constant value")
        if name in values:
            raise UsageError(f"{path}: {name} is given a value and a series; give one of them")


def column_of(variable: Any) -> Column:
    """Return what is known of a variable."""
    declared = variable.declaredType
    return Column(
        variable.name,
        variable.unit or (declared.unit if declared else None) or "1",
        variable.displayUnit,
        float(variable.nominal or 1.0),
        variable.description or "",
    )


def own_numbers(variables: Mapping[str, Any]) -> dict[str, float]:
    """Return the parameters and inputs that an FMU has where nobody gives others, by name."""
    kinds = ("parameter", "input")
    found = {n: v.start for n, v in variables.items() if v.causality in kinds and is_number(v)}
    return {name: float(start) for name, start in found.items() if _is_float(start)}


def numbers_of_run(
    variables: Mapping[str, Any], own: Mapping[str, float], given: Mapping[str, float]
) -> dict[str, float]:
    """Return the parameters and inputs that an FMU is run with: what is given, else its own."""
    kinds = ("parameter", "input")
    return {**own, **{n: x for n, x in given.items() if variables[n].causality in kinds}}


def _is_float(text: Any) -> bool:
    try:
        float(text)
    except (TypeError, ValueError):  # there is none, it is an array, or true
        return False
    return True
