"""What a hybrid case is: a model, what it is run with, and what happens then, in closed form."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache

from helpers.hybrid_engines import COMPILED, FMUS, run_on

import cosim
from casadi_models.dae import Dae

FIXED = COMPILED[1:]
EXPLICIT = {"cvodes", "erk", "rk4", "ode8"}  # take no algebraic unknowns
RELATIVE = 1e-9  # tolerance of solvers that control their error
TIME, STATE = 1e-6, 2e-6  # of the span, of the largest value; measured 3e-7 and 7e-7, cvodes


@dataclass(frozen=True)
class Case:
    """A model and its course.

    Args:
        build: Gives the model its equations; called once.
        finals: Values at the end, by name.
        events: Times, s, and names of all declared events, in any order.
        never: Names of declared events that do not happen.
        stop_time: End of the run, s.
        end: Where a stop condition ends it, s, if not at the stop time.
        error: Pattern of the message that ends the run instead.
        inputs: As of `cosim.simulate`.
        start_values: As of `cosim.simulate`.
        algebraic: Whether it has algebraic unknowns, which not every solver takes.
        within: Tolerance of the final values; 2e-6 times the largest, and at least 2e-6, if None.
    """

    build: Callable[[cosim.Model], None]
    finals: Mapping[str, float] = field(default_factory=dict)
    events: tuple[tuple[float, str], ...] = ()
    never: tuple[str, ...] = ()
    stop_time: float = 4.0
    end: float | None = None
    error: str | None = None
    inputs: object = None
    start_values: Mapping[str, float] | None = None
    algebraic: bool = False
    within: float | None = None


@cache
def frozen(name: str, build: Callable[[cosim.Model], None], stop_time: float) -> Dae:
    """Return the model of a case, built once."""
    facts = {"stop_time": stop_time, "output_interval": stop_time / 400}
    model = cosim.Model(re.sub(r"\W", "_", name), **facts)
    build(model)
    return model.freeze()


def check(case: Case, name: str, engine: str) -> None:
    """Run a case on an engine.

    Raises:
        AssertionError: Something else happened than the case says.
        CosimError: The run failed, and should not.
    """
    dae = frozen(name, case.build, case.stop_time)
    options = {"inputs": case.inputs, "start_values": case.start_values}
    if engine not in FIXED:
        options["relative_tolerance"] = RELATIVE
    given = {key: value for key, value in options.items() if value is not None}
    if case.error is not None:
        _check_error(case, engine, dae, given)
        return
    run = run_on(engine, dae, **given)
    end = case.stop_time if case.end is None else case.end
    assert abs(run.time[-1] - end) <= TIME * case.stop_time, f"ends at {run.time[-1]}, right {end}"
    largest = max(map(abs, case.finals.values()), default=0)
    tolerance = STATE * max(1, largest) if case.within is None else case.within
    for variable, right in case.finals.items():
        found = run.final[variable]
        assert abs(found - right) <= tolerance, f"{variable} = {found:.9g}, right {right:.9g}"
    _check_events(case, run)


def _check_error(case, engine, dae, given):
    try:
        run = run_on(engine, dae, **given)
    except cosim.CosimError as error:
        said = str(error)
    else:
        said = f"{run.status} at {run.time[-1]} s"
    assert re.search(case.error, said), f"ends with {said}, right {case.error}"


def _check_events(case, run):
    names = {name for _, name in case.events} | set(case.never)
    near = TIME * case.stop_time
    right = _grouped(case.events, near)
    found = _grouped(
        [(event.time, event.name) for event in run.events if event.name in names], near
    )
    said = f"events {_listed(found)}, right {_listed(right)}"
    assert [name for _, name in found] == [name for _, name in right], said
    off = [abs(time - exact) for (time, _), (exact, _) in zip(found, right, strict=True)]
    assert max(off, default=0) <= near, said


def _grouped(events, near):
    """Return events by time; those of one instant by name."""
    instant, found = -1.0, []
    for time, name in sorted(events):
        if time - instant > near:
            instant = time
        found.append((instant, name))
    return sorted(found)


def _listed(events):
    return [f"{name} at {time:.9g}" for time, name in events[:12]]


def engines_of(case: Case, engines: tuple[str, ...]) -> list[str]:
    """Return those of some engines that can run a case."""
    without = set()
    if case.inputs is not None:
        without |= {engine for engine in FMUS if engine.endswith(" c")}
    if case.algebraic:
        without |= EXPLICIT
    return [engine for engine in engines if engine not in without]
