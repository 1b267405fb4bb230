"""The linear system of a bare FMU: its directional derivatives at the start of a run."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cosim.arrays import Vector
from cosim.errors import FmuError
from cosim.fmi.archive import unpacked
from cosim.fmi.run.initialization import enter_continuous_time, initialize
from cosim.fmi.run.instance import (
    by_name,
    choose_interface,
    instantiated,
    is_number,
    read_description,
)
from cosim.fmi.run.request import given_numbers, recorded


@dataclass(frozen=True, eq=False)
class FmuLinear:
    """Names, values and partial derivatives of an FMU at its start.

    Attributes:
        model: The name inside.
        states, inputs, outputs: Names.
        nominal: Of the states.
        x, u, y, rates: Values.
        jacobian: d(rates, outputs) / d(states, inputs).
    """

    model: str
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    nominal: tuple[float, ...]
    x: Vector
    u: Vector
    y: Vector
    rates: Vector
    jacobian: Vector


def fmu_linear(
    path: str | os.PathLike[str],
    *,
    time: float = 0.0,
    start_values: Mapping[str, float] | None = None,
    outputs: Sequence[str] | None = None,
) -> FmuLinear:
    """Initialize an FMU for model exchange and ask for its directional derivatives.

    Args:
        path: The FMU. Its binary runs in this process: only run FMUs you trust.
        time: s.
        start_values: Start values, parameters and inputs by name, in the FMU's units.
        outputs: Names; the FMU's outputs when None.

    Raises:
        FmuError: It is no FMU for model exchange, or has no directional derivatives, or failed.
        UnknownName, UsageError: A variable does not exist or cannot be set.
    """
    with unpacked(path) as folder:
        description = read_description(folder, path)
        choose_interface(folder, description, "ModelExchange", path)
        abilities = description.modelExchange
        second = description.fmiVersion.startswith("2")  # fmpy does not read the flag of FMI 3
        if second and not abilities.providesDirectionalDerivative:
            raise FmuError(f"{path} has no directional derivatives; linearize the model itself")
        variables = by_name(description)
        values = given_numbers(path, variables, start_values or {})
        rates = [item.variable for item in description.derivatives]
        states = [rate.derivative for rate in rates]
        every = description.modelVariables
        inputs = [v for v in every if v.causality == "input" and is_number(v)]
        shown = [variables[name] for name in recorded(path, variables, outputs)]
        with instantiated(folder, description, "ModelExchange", path) as (instance, explained):
            try:
                initialize(instance, description, values, startTime=time)
                enter_continuous_time(instance, description)
                x, u, y, slopes = (
                    _get(instance, [v.valueReference for v in group])
                    for group in (states, inputs, shown, rates)
                )
                jacobian = _jacobian(instance, (*rates, *shown), (*states, *inputs))
            except FmuError:
                raise
            except Exception as error:
                raise explained(error) from error
    return FmuLinear(
        description.modelName,
        _names(states),
        _names(inputs),
        _names(shown),
        tuple(float(v.nominal or 1.0) for v in states),
        x,
        u,
        y,
        slopes,
        jacobian,
    )


def _names(variables: Sequence[Any]) -> tuple[str, ...]:
    return tuple(variable.name for variable in variables)


def _get(instance: Any, references: Sequence[int]) -> Vector:
    if not references:
        return np.empty(0)
    getter = instance.getReal if hasattr(instance, "getReal") else instance.getFloat64
    return np.array(getter(references), dtype=float)


def _jacobian(instance: Any, unknowns: Sequence[Any], knowns: Sequence[Any]) -> Vector:
    rows = [v.valueReference for v in unknowns]
    columns = [
        instance.getDirectionalDerivative(rows, [known.valueReference], [1.0]) for known in knowns
    ]
    return np.array(columns, dtype=float).reshape(len(knowns), len(unknowns)).T
