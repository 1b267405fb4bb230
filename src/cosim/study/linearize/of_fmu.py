"""`linearized_fmu`: A, B, C, D of an FMU at its initial state."""

import os
from collections.abc import Mapping, Sequence
from ctypes import c_double
from typing import Any

import numpy as np

from cosim.arrays import Truths, Vector
from cosim.errors import FmuError
from cosim.fmi.archive import unpacked
from cosim.fmi.run.description import by_name, choose_interface, nominal_of, read_description
from cosim.fmi.run.instance import enter_continuous_time, initialize, instantiated
from cosim.fmi.run.request import checked_values, default_span, output_names
from cosim.fmi.run.typed_values import is_number
from cosim.study.linearize.linearization import Linearization
from cosim.study.linearize.local import JUMP, LEAST_JUMP, SAME, TRIALS, reject_no_number, rounding
from cosim.text import moment

POINT = "the initial state of an FMU"
BESIDE = 1e-9  # distance of states on both sides of another one, in their sizes
NEARER = 0.01  # share of it, at which a jump is as large
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
    with unpacked(path, to_run=True) as folder:
        description = read_description(folder, path)
        choose_interface(folder, description, "ModelExchange", path)
        if not description.modelExchange.providesDirectionalDerivative:
            raise FmuError(f"{path} has no directional derivatives; linearize the model itself")
        variables = by_name(description)
        values = checked_values(path, variables, start_values or {})
        start, _ = span = default_span(description)
        rates = [item.variable for item in description.derivatives]
        states = [rate.derivative for rate in rates]
        every = description.modelVariables
        inputs = [v for v in every if v.causality == "input" and is_number(v)]
        shown = [variables[name] for name in output_names(path, variables, outputs)]
        with instantiated(folder, description, "ModelExchange", path) as (instance, explained):
            try:
                initialize(instance, description, values, startTime=start)
                event = enter_continuous_time(instance)
                if np.isfinite(event):
                    raise FmuError(
                        f"{path} has an event at {moment(event, 6)} s, which its derivatives do "
                        "not contain; linearize the model itself"
                    )
                x, u, y, slopes = (
                    _values(instance, group) for group in (states, inputs, shown, rates)
                )
                unknowns, knowns = (*rates, *shown), (*states, *inputs)
                jacobian = _jacobian(instance, unknowns, knowns)
                noise = _noise(instance, rates, states, x, jacobian)
                square = jacobian[: len(rates), : len(states)]
                _reject_course(instance, description, span, square, noise, states, rates)
                if np.isfinite(jacobian).all():
                    instance.setTime(start)
                    groups, here = (states, inputs), np.concatenate((x, u))
                    _reject_corner(instance, description, here, jacobian, unknowns, groups)
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
        time=start,
        x=x,
        u=u,
        y=y,
        rates=slopes,
        nominal=_nominals(states),
        point=POINT,
    )


def _values(instance: Any, variables: Sequence[Any]) -> Vector:
    references = [v.valueReference for v in variables]
    return np.array(instance.getFloat64(references) if references else [], dtype=float)


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

    def at(place: Vector) -> Vector:
        instance.setContinuousStates((c_double * len(place))(*place), len(place))
        return _jacobian(instance, rates, states)

    return rounding(at, x, _nominals(states), jacobian[: len(rates), : len(states)])


def _reject_course(
    instance: Any,
    description: Any,
    span: tuple[float, float],
    here: Vector,
    noise: Vector,
    states: Sequence[Any],
    rates: Sequence[Any],
) -> None:
    """Raise FmuError if the rates depend otherwise on the states at later times.

    Args:
        instance, description: The FMU.
        span: Begin and end of its default experiment, s.
        here: Derivatives of the rates by the states at the start, (states, states).
        noise: What rounding leaves open in them.
        states, rates: fmpy's variables.
    """
    begin, end = span
    for share in LATER:
        time = begin + share * (end - begin or 1.0)
        instance.setTime(time)
        change = np.abs(_jacobian(instance, rates, states) - here)
        if (change > noise + SAME * np.abs(here).max(initial=0.0)).any():
            raise FmuError(
                f"{description.modelName}: the linear system at {moment(time, 6)} s is another one "
                "than at the start, so that no eigenvalues tell whether the motion is stable; "
                "linearize the model itself, which gives the multipliers of periodic motions"
            )


def _reject_corner(
    instance: Any,
    description: Any,
    x: Vector,
    here: Vector,
    unknowns: Sequence[Any],
    groups: tuple[Sequence[Any], Sequence[Any]],
) -> None:
    """Raise FmuError if a derivative is another one on some side of the state.

    An FMU takes a side of what switches in event mode.

    Args:
        instance, description: The FMU.
        x: States and inputs at the start.
        here: Derivatives there of the unknowns by states and inputs.
        unknowns: Rates and outputs, fmpy's variables.
        groups: States, and inputs.
    """
    states, inputs = groups
    knowns, n = (*states, *inputs), len(states)
    reals = [i for i, v in enumerate(knowns) if i >= n and v.type in ("Real", "Float64")]
    sizes = _nominals(knowns)
    shift = BESIDE * np.fmax(sizes, np.abs(x))
    scale = sizes / np.concatenate((sizes[:n], _nominals(unknowns[n:])))[:, None]
    least = np.fmax(JUMP * (np.abs(here) * scale).max(axis=1, initial=0.0), LEAST_JUMP)

    def move(place: Vector) -> None:
        instance.setContinuousStates((c_double * n)(*place[:n]), n)
        for i in reals:
            instance.setFloat64([knowns[i].valueReference], [place[i]])

    def change(place: Vector) -> Vector:
        move(place)
        instance.enterEventMode()
        enter_continuous_time(instance)
        move(place)  # an event may have changed it
        return np.abs(_jacobian(instance, unknowns, knowns) - here) * scale

    directions = np.random.default_rng(0).uniform(-1, 1, (TRIALS, len(x)))
    for way in (side * shift * d for d in directions for side in (1, -1)):
        far, near = (change(x + share * way) for share in (1.0, NEARER))
        jumps = ~(near <= np.fmax(least[:, None], far / 2))  # what is smooth becomes less
        for i, j in np.argwhere(jumps)[:1]:
            raise FmuError(
                f"{description.modelName}: {unknowns[i].name} has another derivative with respect "
                f"to {knowns[j].name} beside {POINT}, so that there is no linear system; choose "
                "another state"
            )


def _nominals(variables: Sequence[Any]) -> Vector:
    return np.array([nominal_of(v) or 1.0 for v in variables])


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
