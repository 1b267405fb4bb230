"""`FmuRequest`: what to compute with an FMU, checked against its model description."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from ctypes import POINTER, c_double
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from typing import Any, NamedTuple

import numpy as np

from cosim.arrays import Vector, frozen
from cosim.codegen.terms import pulse_times
from cosim.errors import ParameterError, UnknownName, UsageError
from cosim.fmi.run.arrays import Layout, elements_of, with_elements
from cosim.fmi.run.description import Interface, by_name, nominal_of, unit_of
from cosim.fmi.run.instance import access_to, may_be_set
from cosim.fmi.run.typed_values import (
    is_continuous,
    is_number,
    series_value,
    start_number,
    typed_value,
)
from cosim.fmi.units import display_of, is_relative, units_for
from cosim.model.driving import followed, with_held
from cosim.model.growth import Closer, Growth
from cosim.model.inputs import InputSeries
from cosim.model.times import one_time, reject_span, time_grid
from cosim.model.troughs import Trough
from cosim.model.values import listed, number
from cosim.trajectory import Column, Trajectory

DEFAULT_TOLERANCE = 1e-5  # of model exchange if neither user nor FMU gives one, as in fmpy
MOST_POINTS = 10_000_000  # output times of a run
TIME = "time"
WHY_NOT_TIME = "since each result has the time of the run by this name; couple the FMU as a part"


class MasterRun(NamedTuple):
    """Raw result of a run.

    Attributes:
        times: s, (n,).
        rows: Outputs, a row for each time.
        stats: Statistics.
        growth: A deviation in model exchange that grows, but was not followed.
    """

    times: Vector
    rows: Vector
    stats: dict[str, Any]
    growth: Growth | Trough | None = None


@dataclass(frozen=True, eq=False)
class FmuRequest:
    """What to compute with an FMU; knows nothing of the master that drives it.

    `of` makes one from the keywords of `simulate_fmu` and checks it; `dataclasses.replace` makes
    variants.

    Attributes:
        description: fmpy's model description.
        interface: Model exchange or co-simulation.
        values: Start values, parameters and constant inputs by name, in the FMU's units.
        start, stop, interval: Span of the run and distance of the output times, s.
        recorded: The variables to record, of the description.
        inputs: Inputs that follow a time series.
        tolerance: Relative tolerance; None if neither user nor FMU gives one.
        max_step: Longest step in model exchange, s.
        closer: Smaller tolerance for the first part of a run in model exchange.
    """

    description: Any
    interface: Interface
    values: Mapping[str, float]
    start: float
    stop: float
    interval: float
    recorded: tuple[Any, ...]
    inputs: InputSeries | None = None
    tolerance: float | None = None
    max_step: float | None = None
    closer: Closer | None = None

    @classmethod
    def of(
        cls,
        description: Any,
        interface: Interface,
        name: object,
        *,
        start_time: float | None = None,
        stop_time: float | None = None,
        output_interval: float | None = None,
        relative_tolerance: float | None = None,
        start_values: Mapping[str, float] | None = None,
        inputs: Any = None,
        outputs: Sequence[str] | None = None,
    ) -> "FmuRequest":
        """Check the keywords of `simulate_fmu`."""
        start, stop, interval = _times(name, description, start_time, stop_time, output_interval)
        tolerance = _tolerance(name, description, relative_tolerance)
        description, values = resized(
            name, description, {} if start_values is None else start_values
        )
        variables = by_name(description)
        recorded = tuple(variables[output] for output in output_names(name, variables, outputs))
        driven = {n: v for n, v in variables.items() if v.causality == "input"}
        series = None
        if inputs is not None:
            units = {n: (unit_of(v) or "1", units_for(v, description)) for n, v in driven.items()}
            held = {
                n: partial(series_value, str(name), v)
                for n, v in driven.items()
                if not is_continuous(v)
            }
            times = time_grid(start, stop, interval)
            own = with_held(str(name), inputs, times, held)
            series = followed(str(name), own, times, units, pulse_times)
        if series is not None:
            _check_series(name, driven, series, values)
        request = cls(
            description, interface, values, start, stop, interval, recorded, series, tolerance
        )
        last = float(request.points[-1])
        if not one_time(last, stop, start):
            raise ParameterError(
                f"{name}: the FMU takes steps of one size only, of which {interval:.12g} s lead "
                f"to {last:.12g} s and not to {stop:.12g} s; give stop_time or output_interval"
            )
        return request

    @property
    def grid(self) -> Vector:
        """The output times of native simulation, s, (n,)."""
        return time_grid(self.start, self.stop, self.interval)

    @cached_property
    def points(self) -> Vector:
        """The communication points, at which a run is recorded, s, (n,)."""
        abilities = self.description.coSimulation
        exchange = self.interface is Interface.MODEL_EXCHANGE
        any_step = exchange or abilities.canHandleVariableCommunicationStepSize
        return communication_points(self.start, self.stop, self.interval, any_step=any_step)

    @cached_property
    def initial_values(self) -> dict[str, float]:
        """The values to set before initialization ends, by name: inputs of a series as well."""
        series = self.inputs
        if series is None:
            return dict(self.values)
        at_start = series.at(np.array([self.start]))[:, 0].tolist()
        first = zip(self.followers, at_start, strict=True)
        return {**self.values, **{v.name: typed_value(v.name, v, value) for v, value in first}}

    @property
    def relative_tolerance(self) -> float:
        """The tolerance of model exchange; the absolute one is as large, in nominal values."""
        return DEFAULT_TOLERANCE if self.tolerance is None else self.tolerance

    @property
    def experiment(self) -> dict[str, float | None]:
        """What the FMU learns of a run: `startTime`, `stopTime` [s], `tolerance`."""
        facts: dict[str, float | None] = {"startTime": self.start, "stopTime": self.stop}
        if self.interface is Interface.CO_SIMULATION:
            facts["tolerance"] = self.tolerance
        return facts

    @property
    def followers(self) -> list[Any]:
        """The inputs that follow a series."""
        names = self.inputs.names if self.inputs else ()
        return [by_name(self.description)[name] for name in names]

    @property
    def input_references(self) -> list[int]:
        """The value references of the continuous inputs that follow a series."""
        return Layout.of([v for v in self.followers if is_continuous(v)]).references

    @property
    def columns(self) -> tuple[Column, ...]:
        """The recorded variables with their units."""
        return tuple(column_of(variable, self.description) for variable in self.recorded)

    @property
    def numbers(self) -> dict[str, float]:
        """The parameters and inputs of the run by name: start values given here, else the FMU's."""
        own, given = _own_numbers(self.description), self.initial_values
        kinds, variables = ("parameter", "input"), by_name(self.description)
        used = {n for n in given if variables[n].causality in kinds and is_number(variables[n])}
        return {**own, **{n: x for n, x in given.items() if n in used}}


@lru_cache(8)
def communication_points(start: float, stop: float, interval: float, *, any_step: bool) -> Vector:
    """Return the times at which fmpy records, s, (n,), bit for bit from a start at 0."""
    times: Vector = start + interval * np.arange(int((stop - start) / interval) + 3, dtype=float)
    near = one_time(times, stop, start)
    last = int(np.argmax((times > stop) | near))
    times = times[: last + 1]
    if times[-1] > stop and not near[last]:
        times = np.append(times[:-1], [stop] if any_step else [])
    return frozen(times)


def default_span(description: Any) -> tuple[float, float]:
    """Return begin and end of an FMU's default experiment, s; 1 s later where it gives none."""
    begin, end = (
        getattr(description.defaultExperiment, name, None) for name in ("startTime", "stopTime")
    )
    start = float(begin or 0.0)
    return start, start + 1 if end is None else float(end)


def _times(
    name: object, description: Any, start: float | None, stop: float | None, interval: float | None
) -> tuple[float, float, float]:
    """Complete the times by the FMU's default experiment, with 500 intervals if it gives no step.

    fmpy has another default interval.
    """
    begin, end = default_span(description)
    start = number(str(name), "start_time", begin if start is None else start)
    stop = number(str(name), "stop_time", start + (end - begin) if stop is None else stop)
    reject_span(start, stop, f"{name}: ")
    if interval is None:
        step = getattr(description.defaultExperiment, "stepSize", None)
        interval = ((stop - start) / 500 if step is None else float(step)) or 1.0
    interval = number(str(name), "output_interval", interval, positive=True)
    if (stop - start) / interval > MOST_POINTS:
        raise ParameterError(
            f"{name}: output_interval = {interval:g} s makes {(stop - start) / interval:.3g} "
            "output times; give a larger one"
        )
    return start, stop, interval


def _tolerance(name: object, description: Any, relative: float | None) -> float | None:
    """Return the relative tolerance, by default the FMU's."""
    given = relative is not None
    if not given:
        own = getattr(description.defaultExperiment, "tolerance", None)
        if own is None:
            return None
        relative = float(own)
    what = "relative_tolerance" if given else "relative_tolerance of the file"
    relative = number(str(name), what, relative, positive=True)
    if given and relative > 0.1:
        raise ParameterError(
            f"{name}: relative_tolerance = {relative:g} is above 0.1; give a smaller one"
        )
    return relative


def resized(
    name: object, description: Any, values: Mapping[str, float]
) -> tuple[Any, dict[str, float]]:
    """Return a description with arrays as large as structural parameters make them, and the values.

    Raises: See `checked_values`.
    """
    variables = by_name(description)
    given = values if isinstance(values, Mapping) else {}
    structural = {n for n, v in variables.items() if v.causality == "structuralParameter"}
    sizes = checked_values(name, variables, {n: given[n] for n in structural & set(given)})
    description = with_elements(description, sizes)
    return description, checked_values(name, by_name(description), values)


def checked_values(
    name: object, variables: Mapping[str, Any], values: Mapping[str, float]
) -> dict[str, float]:
    """Return start values by the names of the description.

    Raises:
        UnknownName, UsageError, ParameterError: A variable does not exist, cannot be set, or gets
            no finite number.
    """
    UsageError.reject(f"{name}: start_values", values, Mapping, "values by name, e.g. {'phi': 1}")
    for variable in values:
        if variable not in variables:
            settable = [v.name for v in variables.values() if is_settable(v)]
            raise UnknownName.among(str(name), "start value", variable, settable)
        if not holds_value(variables[variable]):
            raise UsageError(
                f"{name}: {variable} is {_kind_of(variables[variable])}; only numbers, Booleans, "
                "items of enumerations and texts can be set"
            )
        if not is_settable(variables[variable]):
            raise UsageError(f"{name}: {variable} cannot be set; it is calculated")
    return {
        variables[key].name: typed_value(str(name), variables[key], value)
        for key, value in values.items()
    }


def _kind_of(variable: Any) -> str:
    """Return what a variable is that is not a single number, with what to do."""
    if not variable.dimensions:
        return f"of type {variable.type}"
    first = ",".join("1" * len(variable.dimensions))
    return f"an array; name its elements, such as {variable.name}[{first}]"


def is_settable(variable: Any) -> bool:
    """Tell whether a variable is one number or text whose start value can be set."""
    return may_be_set(variable) and holds_value(variable)


def holds_value(variable: Any) -> bool:
    """Tell whether a variable is one number or one text."""
    return is_number(variable) or (variable.type == "String" and not variable.dimensions)


def numeric_names(variables: Iterable[Any]) -> list[str]:
    """Return the names of those variables that are numbers."""
    return [variable.name for variable in variables if is_number(variable)]


def output_names(
    name: object, variables: Mapping[str, Any], outputs: Sequence[str] | None
) -> list[str]:
    """Return the names of the variables to record, each once; by default the FMU's outputs.

    The name of an array stands for its elements. "time" means the time, which each result has.

    Raises:
        UnknownName, UsageError: A variable does not exist, is not one number, or is called "time".
    """
    if outputs is None:
        own = [n for n, v in variables.items() if v.causality == "output" and n == v.name != TIME]
        found = numeric_names(variables[n] for n in own)
        if own and not found:
            raise UsageError(
                f"{name}: none of its outputs ({', '.join(own)}) is a number, so nothing "
                "can be recorded; name other variables with outputs"
            )
        return found
    found = []
    for output in listed(f"{name}: outputs", outputs):
        UnknownName.reject(str(name), "output", variables, output)
        one = variables[output]
        if output == TIME and one.causality == "independent":
            continue
        if output == TIME:
            raise UsageError(f"{name}: the variable 'time' cannot be recorded, {WHY_NOT_TIME}")
        numbers = elements_of(one, variables.values()) if one.dimensions else [one]
        if not numbers or not is_number(numbers[0]):
            raise UsageError(f"{name}: {output} is not a single number and cannot be recorded")
        found += (number.name for number in numbers)
    return list(dict.fromkeys(found))


def _check_series(
    name: object, known: Mapping[str, Any], series: InputSeries, values: Mapping[str, float]
) -> None:
    """Reject a series for a variable that is no known input or has a constant value as well."""
    for variable in series.names:
        UnknownName.reject(str(name), "input", known, variable)
        if not is_number(known[variable]):
            raise UsageError(
                f"{name}: {variable} is {_kind_of(known[variable])}; only numbers follow a series"
            )
        if variable in values:
            raise UsageError(f"{name}: {variable} is given a value and a series; give one of them")


def rounding(variables: Sequence[Any], run: Trajectory) -> str:
    """Return which integers of a run are too large for its numbers; the empty text if none are.

    Args:
        variables: fmpy's, of the columns.
        run: The run.
    """
    large = np.abs(run.values).max(axis=0, initial=0.0) >= 2.0**53
    names = [n for n, v, is_large in zip(run.names, variables, large, strict=True)
             if is_large and v.type in ("Int64", "UInt64")]  # fmt: skip
    return f"{', '.join(names)}: integers from 2^53 on may be rounded in results" if names else ""


@lru_cache(1024)
def column_of(variable: Any, description: Any) -> Column:
    """Return a variable of fmpy's as a column of a result."""
    display, factor, offset = display_of(variable, description)
    return Column(
        variable.name,
        unit_of(variable) or "1",
        display,
        nominal_of(variable) or 1.0,
        variable.description or "",
        factor,
        offset,
        variable.name in _states(description),
        is_relative(variable),
    )


def state_names(description: Any) -> list[str]:
    """Return the names of the states in their order; an array stands for its elements."""
    states = [item.variable.derivative for item in description.derivatives]
    every = description.modelVariables
    numbers = [elements_of(state, every) if state.dimensions else [state] for state in states]
    return [number.name for some in numbers for number in some]


@lru_cache(8)
def _states(description: Any) -> frozenset[str]:
    """Return the names of the states that the equations of an FMU have."""
    rates = (variable.derivative for variable in description.modelVariables)
    return frozenset(state.name for state in rates if state is not None)


def nominals_of(instance: Any, count: int) -> Vector:
    """Return the nominal values of states, (count,): 1 where an FMU gives no positive number."""
    found = np.ones(count)
    if count:
        instance.getNominalsOfContinuousStates(found.ctypes.data_as(POINTER(c_double)), count)
    return np.where(np.isfinite(found) & (found > 0), found, 1.0)


def lost_state(instance: Any, description: Any) -> Callable[[], str]:
    """Return what names a state that is not finite now; or "" if none is or can be read."""
    from fmpy.fmi1 import FMICallException

    states = [by_name(description)[name] for name in sorted(_states(description))]
    states = [variable for variable in states if is_number(variable)]  # of arrays the elements
    access = access_to(states, instance, description)

    def lost() -> str:
        try:
            finite = np.isfinite(np.array(access.get(), dtype=float))
        except FMICallException:
            return ""
        return "" if finite.all() else str(states[int(np.argmin(finite))].name)

    return lost


@lru_cache(8)
def _own_numbers(description: Any) -> Mapping[str, float]:
    """Return the start values of the parameters and inputs by name."""
    found: dict[str, float] = {}
    for variable in description.modelVariables:
        own = variable.causality in ("parameter", "input") and is_number(variable)
        if own and variable.start:  # one that the file tells
            found[variable.name] = start_number(variable)
    return found
