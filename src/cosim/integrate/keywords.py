"""`requested`: build a `RunRequest` from the keywords of `cosim.simulate`."""

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, TypedDict, Unpack

from numpy.typing import ArrayLike

from casadi_models.dae import Dae
from cosim.errors import UsageError, naming_arguments
from cosim.integrate.outputs import all_columns
from cosim.integrate.solvers import requested_solver
from cosim.model.catalogue import model_of
from cosim.model.driving import driven
from cosim.model.quantities import quantity
from cosim.model.request import RunRequest
from cosim.model.solver import LIMITS, Goal, Solver, Tolerance
from cosim.model.times import Times
from cosim.model.values import assign


class SpanKeywords(TypedDict, total=False):
    """Keywords of equidistant output times; see `cosim.simulate`."""

    start_time: float | None
    stop_time: float | None
    output_interval: float | None


class TimeKeywords(SpanKeywords, total=False):
    """Keywords of the output times; see `cosim.simulate`."""

    output_times: ArrayLike | None


class RareKeywords(TypedDict, total=False):
    """Rarely needed keywords; see `cosim.simulate`."""

    relative_tolerance: float | None
    absolute_tolerance: float | None
    step_size: float | None
    max_step: float | None
    compiled: bool | None
    on_invalid: str | None
    drift_control: str | None
    output_times: ArrayLike | None
    stop_when: str | None
    record_events: bool


class SharedKeywords(RareKeywords, TimeKeywords, total=False):
    """Keywords that runs of many variants share; see `cosim.simulate`."""

    inputs: Any
    outputs: Sequence[str] | None
    solver: str | Solver | Tolerance | None
    accuracy: float | str | None
    budget: float | None


class Keywords(SharedKeywords, total=False):
    """Keywords of one run; see `cosim.simulate`."""

    start_values: Mapping[str, float | str] | None


_SOLVER = ("solver", "step_size", *LIMITS)
_GOAL = ("accuracy", "budget")
_TIMES = ("start_time", "stop_time", "output_interval", "output_times")
_POLICY = ("compiled", "on_invalid", "drift_control", "stop_when", "record_events")


@naming_arguments
def requested(subject: Dae | str | RunRequest, **keywords: Unpack[Keywords]) -> RunRequest:
    """Return the request of a model and keywords; a keyword that is None is ignored.

    Args:
        subject: The model, its name, or a request whose fields are the defaults.
        keywords: See `cosim.simulate`.

    Raises:
        TypeError: A keyword does not exist.
        UnknownName, ParameterError, UsageError, InitialConditionError: See `RunRequest`; or two
            keywords contradict each other.

    Example:
        >>> requested("crank_shaft", start_values={"omega": "60rpm"}, stop_time=2.0).times.stop
        2.0
    """
    given: dict[str, Any] = {k: v for k, v in keywords.items() if v is not None}
    request = subject if isinstance(subject, RunRequest) else RunRequest(model_of("a run", subject))
    times = _times(request.times, {name: given[name] for name in _TIMES if name in given})
    settled = driven(
        request.dae, given.get("inputs", request.inputs), lambda: times.grid(request.dae)
    )
    dae = settled.dae
    outputs = given.get("outputs", request.outputs)
    if isinstance(given.get("accuracy"), str):
        given["accuracy"] = _accuracy(dae, given["accuracy"], outputs)
    values = {**request.values, **_plain(dae, given.get("start_values")), **settled.constants}
    starts = given.get("start_values")
    reject_driven(dae.full_name, given.get("inputs"), starts, settled.constants)
    policy = {name: given[name] for name in _POLICY if name in given}
    found = RunRequest(
        dae,
        values,
        times,
        outputs,
        settled.series,
        _solver(request, given),
        replace(request.policy, **policy),
    )
    for name in ("stop_when", "record_events"):
        if isinstance(found.solver, Goal) and getattr(found.policy, name):
            raise UsageError(
                f"{dae.full_name}: {name} needs a solver; leave accuracy or budget out"
            )
    if isinstance(found.solver, Goal) and found.policy.drift_control is not None:
        raise _overruled(next(name for name in _GOAL if name in given), "drift_control")
    return found.without_series(starts or ())


def reject_driven(owner: str, inputs: Any, starts: Any, constants: Iterable[str] = ()) -> None:
    """Reject start values of what the inputs of the same call set: one of both would be lost."""
    driven = {*getattr(inputs, "names", inputs or ()), *constants}
    if isinstance(starts, Mapping) and (twice := driven & starts.keys()):
        raise UsageError(f"{owner}: {min(twice)} is given twice; give it once")


def _times(times: Times, given: dict[str, Any]) -> Times:
    names = {"start_time": "start", "stop_time": "stop", "output_interval": "interval"}
    own = given.pop("output_times", None)
    if own is None and times.own:
        if not given.keys() & {"stop_time", "output_interval"}:
            return Times.at(times.requested, given.get("start_time", times.start), times.stop)
        stop = float(times.requested[-1]) if times.stop is None else times.stop
        times = Times(times.start, stop)  # a new span replaces them
    if own is None:
        return replace(times, **{names[name]: value for name, value in given.items()})
    for name in ("stop_time", "output_interval"):
        if name in given:
            raise UsageError(f"output_times already sets all output times; leave {name} out")
    return Times.at(own, given.get("start_time", times.start))


def _plain(dae: Dae, values: Any) -> dict[str, float]:
    """Return values by name as numbers in SI units."""
    if not isinstance(values, Mapping | None):
        assign(dae, values)  # raises the error
        return {}
    units = {v.name: v.unit for v in dae.variables}
    return {
        name: quantity(name, value, units[name])
        if isinstance(value, str) and name in units
        else value
        for name, value in (values or {}).items()
    }


def _accuracy(dae: Dae, text: str, outputs: Sequence[str] | None) -> float:
    """Return the accuracy in nominal values at which the error of no output exceeds a quantity."""
    with suppress(ValueError):
        return float(text)
    columns = [c for c in all_columns(dae) if outputs is None or c.name in outputs]
    sizes = (
        quantity(f"accuracy of {c.name}", text, c.unit, difference=True) / c.nominal
        for c in columns
    )
    return min(sizes, default=1.0)  # unknown outputs are rejected later


def _solver(request: RunRequest, given: dict[str, Any]) -> Solver | Tolerance | Goal | None:
    """Return the solver, tolerance or goal of the keywords, else that of the request."""
    goals = {name: given[name] for name in _GOAL if name in given}
    numbers = {name: given[name] for name in _SOLVER if name in given}
    if goals:
        goal = Goal(**goals)
        if numbers:
            raise _overruled(next(iter(goals)), next(iter(numbers)))
        return goal
    if not numbers:
        return request.solver
    solver = numbers.get("solver")
    if isinstance(solver, Tolerance):
        return solver
    if "solver" not in numbers and isinstance(request.solver, Solver):
        own = {n: value for n, value in request.solver.numbers.items() if n in _SOLVER}
        return requested_solver(request.dae, request.solver.name, **(own | numbers))
    if "step_size" not in numbers and isinstance(request.solver, Tolerance):
        numbers = request.solver.numbers | numbers
    return requested_solver(request.dae, **numbers)


def _overruled(goal: str, name: str) -> UsageError:
    return UsageError(
        f"{goal} chooses solver and tolerance, but {name} is given as well; leave one of them out"
    )
