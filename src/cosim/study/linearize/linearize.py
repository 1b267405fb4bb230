"""`linearize`: the linear system at a state, or eigenvalues along a parameter."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypedDict, Unpack, overload

import numpy as np

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.errors import ParameterError, UnknownName, UsageError
from cosim.integrate.initial_values import input_values
from cosim.integrate.initial_values import start_values as consistent_start
from cosim.integrate.keywords import requested
from cosim.integrate.run import run
from cosim.model.catalogue import loaded
from cosim.model.inputs import InputSeries
from cosim.model.reduction import checked_outputs
from cosim.model.solver import Solver, Tolerance
from cosim.model.values import number
from cosim.study.linearize.along import EigenvalueSweep, eigenvalue_sweep
from cosim.study.linearize.equilibrium import equilibrium
from cosim.study.linearize.linearization import Linearization
from cosim.study.linearize.local import LocalSystem, local_system
from cosim.study.linearize.of_fmu import linearized_fmu
from cosim.study.linearize.period import period_of
from cosim.study.linearize.period_map import ACCURACY, PeriodMap

START, EQUILIBRIUM = "start", "equilibrium"


class PointKeywords(TypedDict, total=False):
    """Keywords of one linear system; see `linearize`."""

    at: str | float
    start_values: Mapping[str, float] | None
    outputs: Sequence[str] | None
    inputs: InputSeries | None
    start_time: float
    solver: str | Solver | Tolerance | None
    relative_tolerance: float | None


@overload
def linearize(
    model: Dae | str | os.PathLike[str], *, along: None = None, **options: Unpack[PointKeywords]
) -> Linearization: ...


@overload
def linearize(
    model: Dae | str, *, along: Mapping[str, Sequence[float]], **options: Unpack[PointKeywords]
) -> EigenvalueSweep: ...


def linearize(
    model: Dae | str | os.PathLike[str],
    *,
    along: Mapping[str, Sequence[float]] | None = None,
    **options: Unpack[PointKeywords],
) -> Linearization | EigenvalueSweep:
    """Return the linear system near a state: x' = A x + B u, y = C x + D u; or one per value.

    Along a parameter, groups of states that do not influence each other at any of its values are
    treated separately, so that the zero eigenvalues of states without a restoring force do not
    interfere.

    Args:
        model: A `Dae`, the name of a model, or the file of an FMU, whose directional derivatives
            give the matrices.
        along: One parameter, state (its initial value) or input by name with its values: two or
            more, increasing or decreasing, SI. None: one linear system.
        options: `at`: "start" (the default), the initial state; "equilibrium", which Newton's
            method finds from there, and in which states that influence nothing else may move on; or
            a time of a run, s. `start_values`: values by name that replace initial values,
            parameters or inputs, SI. `outputs`: names of y; all outputs of the model when None.
            `inputs`: time series of some inputs of a model, which have their values at that time.
            `start_time`: that of the run and of the initial state, s. `solver`,
            `relative_tolerance`: settings of the run up to a time; see `simulate`.

    Raises:
        UnknownName: A name does not exist.
        UsageError: An FMU can be linearized at its initial state only, and not along a parameter;
            or `along` does not name one variable, or one that `start_values` names, too.
        ParameterError: The values along a parameter do not increase or decrease; or the run ends
            before the time.
        InitialConditionError: The initial values contradict the constraints, or there is no
            equilibrium near them; or an eigenvalue crosses the imaginary axis at an unsteady state.
        CosimError: See `simulate` and `linearized_fmu`.

    Example:
        >>> linearize("bar_on_frame/reduced", outputs=["theta"]).A.shape
        (4, 4)
        >>> found = linearize("bar_on_frame/reduced", along={"b": [0.1, 0.2]}, outputs=["theta"])
        >>> len(found.values)
        2
    """
    if isinstance(model, str) and not model.lower().endswith(".fmu"):
        model = loaded(model)
    if along is None:
        return _linearized(model, _Options(**options))
    if not isinstance(along, Mapping) or len(along) != 1:
        raise UsageError.of_type("linearize: along", along, "one name with its values")
    ((name, values),) = along.items()
    if not isinstance(model, Dae):
        raise UsageError(f"{model}: an FMU is linearized at one state; leave along out")
    given, inputs = options.get("start_values") or {}, options.get("inputs")
    if name in given:
        raise UsageError(f"{model.full_name}: {name} is in start_values and in along; give it once")
    if inputs is not None and name in inputs.names:
        raise UsageError(
            f"{model.full_name}: {name} follows a time series; leave the series or along out"
        )

    def point(value: float) -> Linearization:
        at_value: PointKeywords = {**options, "start_values": {**given, name: value}}
        return _linearized(model, _Options(**at_value))

    return eigenvalue_sweep(model, name, values, point)


@dataclass(frozen=True, kw_only=True)
class _Options:
    """Keywords of one linear system; see `linearize`."""

    at: str | float = START
    start_values: Mapping[str, float] | None = None
    outputs: Sequence[str] | None = None
    inputs: InputSeries | None = None
    start_time: float = 0.0
    solver: str | Solver | Tolerance | None = None
    relative_tolerance: float | None = None


def _linearized(model: Dae | str | os.PathLike[str], options: _Options) -> Linearization:
    """Return the linear system near one state."""
    at, outputs = options.at, options.outputs
    if not isinstance(at, str):
        at = number("linearize", "at", at)
    elif at not in (START, EQUILIBRIUM):
        raise UnknownName.among("linearize", "point", at, (START, EQUILIBRIUM, "a time in s"))
    if not isinstance(model, Dae):
        _reject_of_models(model, at, options)
        return linearized_fmu(model, options.start_values, outputs)
    start = number("linearize", "start_time", options.start_time)
    dae, time, inputs = model, at if isinstance(at, float) else start, options.inputs
    values = requested(dae, start_values=options.start_values, inputs=inputs).numbers
    values = replace(values, u=input_values(dae, np.array([time]), values, inputs)[:, 0])
    every = tuple(v.name for v in dae.output_variables)
    names = every if outputs is None else checked_outputs(dae, outputs)
    period = period_of(dae, values)
    if isinstance(at, float):
        x, point = _state_of_run(dae, start, at, options), f"{at:g} s of a run"
    else:
        x, point = consistent_start(dae, time, values), "its initial state"
    first = isinstance(at, str)
    over = PeriodMap(dae, values, time, period, first, point) if period is not None else None
    if at == EQUILIBRIUM:
        x, point = equilibrium(dae, time, x, values, over)
    local = local_system(dae, names, time, x, values, point)
    if over is not None:
        local = _mapped(local, over, x)
    return Linearization.from_jacobian(
        local.jacobian,
        depends=local.influence,
        noise=local.noise,
        model=dae.full_name,
        states=tuple(v.name for v in dae.states),
        inputs=tuple(v.name for v in dae.inputs),
        outputs=names,
        time=time,
        x=x,
        u=values.u,
        y=local.outputs,
        rates=local.rates,
        nominal=np.array([v.nominal for v in dae.states]),
        point=point,
        period=over.period if over else None,
    )


def _reject_of_models(fmu: object, at: str | float, options: _Options) -> None:
    """Raise UsageError for options that FMUs do not have."""
    if options.inputs is not None:
        raise UsageError(f"{fmu}: the inputs of an FMU are constant here; leave inputs out")
    if options.start_time:
        raise UsageError(f"{fmu}: an FMU has its own start time; leave start_time out")
    if at != START:
        raise UsageError(
            f"{fmu}: an FMU can be linearized at its initial state only; set start_values, or "
            "linearize the model"
        )


def _state_of_run(dae: Dae, start: float, at: float, options: _Options) -> Vector:
    """Return the states, (nx,), at a time of a run from a start, s."""
    found = run(
        requested(
            dae,
            start_values=options.start_values,
            start_time=start,
            stop_time=at,
            output_interval=abs(at - start) or 1.0,
            solver=options.solver,
            relative_tolerance=options.relative_tolerance,
            outputs=[v.name for v in dae.states],
            inputs=options.inputs,
        )
    )
    if found.time[-1] < at:
        raise ParameterError(
            f"{dae.full_name}: at = {at:g} s is after the end of the run at "
            f"{found.time[-1]:g} s, where {found.stats['stop']}; choose an earlier time"
        )
    return np.asarray(found.values[-1])


def _mapped(local: LocalSystem, over: PeriodMap, x: Vector) -> LocalSystem:
    """Return a linear system whose states change as over a period from a state."""
    after, n = over(x), len(x)
    return local._replace(
        jacobian=np.vstack((np.hstack((after.by_x, after.by_u)), local.jacobian[n:])),
        influence=over.influence,
        noise=ACCURACY * np.abs(after.by_x),
        rates=(after.x - x) / over.period,
    )
