"""`linearized_fmu`: A, B, C, D of an FMU at its initial state."""

import os
from collections.abc import Mapping, Sequence
from ctypes import c_double
from typing import Any

import numpy as np

from cosim.arrays import Truths, Vector
from cosim.errors import FmuError
from cosim.fmi.archive import unpacked
from cosim.fmi.run.description import by_name, choose_interface, read_description
from cosim.fmi.run.instance import enter_continuous_time, initialize, instantiated
from cosim.fmi.run.request import checked_values, output_names
from cosim.fmi.run.typed_values import is_number
from cosim.study.linearize.linearization import Linearization
from cosim.study.linearize.local import SAME, reject_no_number, rounding

POINT = "the initial state of an FMU"
LATER = (0.0271828, 0.314159)  # times of a run, of its span, that fit to no period


def linearized_fmu(
    path: str | os.PathLike[str],
    start_values: Mapping[str, float] | None,
    outputs: Sequence[str] | None,
) -> Linearization:
    """Initialize an FMU for model exchange and evaluate its directional derivatives.

    Its binary runs in this process: only run FMUs you trust. Values are in the FMU's units.

    Raises:
        FmuError: It is no FMU for model exchange, or has no directional derivatives, or failed.
        UnknownName, UsageError: A variable does not exist or cannot be set.
    """
    with unpacked(path) as folder:
        description = read_description(folder, path)
        choose_interface(folder, description, "ModelExchange", path)
        if not description.modelExchange.providesDirectionalDerivative:
            raise FmuError(f"{path} has no directional derivatives; linearize the model itself")
        variables = by_name(description)
        values = checked_values(path, variables, start_values or {})
        rates = [item.variable for item in description.derivatives]
        states = [rate.derivative for rate in rates]
        every = description.modelVariables
        inputs = [v for v in every if v.causality == "input" and is_number(v)]
        shown = [variables[name] for name in output_names(path, variables, outputs)]
        with instantiated(folder, description, "ModelExchange", path) as (instance, explained):
            try:
                initialize(instance, description, values, startTime=0.0)
                event = enter_continuous_time(instance)
                if np.isfinite(event):
                    raise FmuError(
                        f"{path} has an event at {event:g} s, which its derivatives do not "
                        "contain; linearize the model itself"
                    )
                x, u, y, slopes = (
                    _values(instance, group) for group in (states, inputs, shown, rates)
                )
                unknowns, knowns = (*rates, *shown), (*states, *inputs)
                jacobian = _jacobian(instance, unknowns, knowns)
                noise = _noise(instance, rates, states, x, jacobian)
                square = jacobian[: len(rates), : len(states)]
                _reject_course(instance, description, square, noise, states, rates)
            except FmuError:
                raise
            except Exception as error:
                raise explained(error) from error
    rows, columns = ([v.name for v in group] for group in (unknowns, knowns))
    reject_no_number(description.modelName, jacobian, rows, columns, POINT)
    n = len(states)
    return Linearization.from_jacobian(
        jacobian,
        depends=_depends(description, states) & (jacobian[:n, :n] != 0),
        noise=noise,
        model=description.modelName,
        states=tuple(v.name for v in states),
        inputs=tuple(v.name for v in inputs),
        outputs=tuple(v.name for v in shown),
        time=0.0,
        x=x,
        u=u,
        y=y,
        rates=slopes,
        nominal=np.array([float(v.nominal or 1.0) for v in states]),
        point=POINT,
    )


def _values(instance: Any, variables: Sequence[Any]) -> Vector:
    references = [v.valueReference for v in variables]
    if not references:
        return np.empty(0)
    return np.array(instance.getFloat64(references), dtype=float)


def _jacobian(instance: Any, unknowns: Sequence[Any], knowns: Sequence[Any]) -> Vector:
    rows = [v.valueReference for v in unknowns]
    columns = [
        instance.getDirectionalDerivative(rows, [known.valueReference], [1.0]) for known in knowns
    ]
    return np.array(columns, dtype=float).reshape(len(knowns), len(unknowns)).T


def _noise(
    instance: Any, rates: Sequence[Any], states: Sequence[Any], x: Vector, jacobian: Vector
) -> Vector:
    """Return what rounding leaves open in the derivatives of the rates by the states."""
    nominal = np.array([float(v.nominal or 1.0) for v in states])

    def at(place: Vector) -> Vector:
        instance.setContinuousStates((c_double * len(place))(*place), len(place))
        return _jacobian(instance, rates, states)

    return rounding(at, x, nominal, jacobian[: len(rates), : len(states)])


def _reject_course(
    instance: Any,
    description: Any,
    here: Vector,
    noise: Vector,
    states: Sequence[Any],
    rates: Sequence[Any],
) -> None:
    """Raise FmuError if the rates depend otherwise on the states at later times.

    Args:
        instance, description: The FMU.
        here: Derivatives of the rates by the states at the start, (states, states).
        noise: What rounding leaves open in them.
        states, rates: fmpy's variables.
    """
    stop = getattr(description.defaultExperiment, "stopTime", None)
    for share in LATER:
        time = share * float(stop or 1.0)
        instance.setTime(time)
        change = np.abs(_jacobian(instance, rates, states) - here)
        if (change > noise + SAME * np.abs(here).max(initial=0.0)).any():
            raise FmuError(
                f"{description.modelName}: the linear system at {time:.6g} s is another one than "
                "at the start, so that no eigenvalues tell whether the motion is stable; linearize "
                "the model itself, which gives the multipliers of periodic motions"
            )


def _depends(description: Any, states: Sequence[Any]) -> Truths:
    """Return whether a derivative depends on a state, as the FMU declares it."""
    places = {v.name: i for i, v in enumerate(states)}
    found = np.ones((len(states), len(states)), dtype=bool)
    for row, unknown in enumerate(description.derivatives):
        if unknown.dependencies is not None:
            found[row] = False
            names = (v.name for v in unknown.dependencies)
            found[row, [places[name] for name in names if name in places]] = True
    return found
