"""Users' values by name, checked against the model's variables and bounds."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf, isfinite, pi
from numbers import Real
from typing import Any
from warnings import warn

import casadi as ca
import numpy as np

from casadi_models.dae import Dae, Start, Variable
from casadi_models.units import represented
from cosim.arrays import Truths, Vector
from cosim.errors import InitialConditionError, ParameterError, UnknownName, UsageError
from cosim.memo import cached_per_thread
from cosim.model.start_outputs import reject_twice, solved_starts
from cosim.series.samples import NOT_GIVEN, ROUNDING_OF_OTHERS
from cosim.text import shortened, with_unit

_SMALL = 1e-3  # smaller initial values are their own nominal values
MOST_COUNT = 10_000_000  # of copies, runs, threads and so on
MOST_SEED = 2**63 - 1


@dataclass(frozen=True)
class Values:
    """Values of every state (initial guesses included), parameter and input, in the DAE's order."""

    x: Vector
    p: Vector
    u: Vector


def numbers_of(dae: Dae, values: Values) -> dict[str, float]:
    """Return the parameters and constant inputs of a run by name."""
    pairs = ((dae.parameters, values.p), (dae.inputs, values.u))
    return {v.name: float(n) for group, row in pairs for v, n in zip(group, row, strict=True)}


def number(owner: str, name: str, value: Any, *, positive: bool = False) -> float:
    """Return a finite real number; the error names the variable.

    Raises:
        ParameterError: The value is no finite real number, or not positive where it must be.
    """
    if isinstance(value, bool | np.bool_) or not isinstance(value, Real):
        raise ParameterError(
            f"{owner}: {name} = {represented(value)} is not a real number; give a float"
        )
    try:
        result = float(value)
    except OverflowError:
        result = inf
    if not isfinite(result):
        raise ParameterError(f"{owner}: {name} = {result} is not finite; give a finite number")
    if positive and result <= 0:
        raise ParameterError(f"{owner}: {name} = {value} is not positive; give a positive number")
    return result


def whole(owner: str, name: str, value: Any, least: int = 1, most: int = MOST_COUNT) -> int:
    """Return a whole number.

    Raises:
        ParameterError: The value is none, or out of its bounds.
    """
    positive = "positive " if least > 0 else ""
    which = f"a {positive}whole number, {least} or more"
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise ParameterError.of_type(f"{owner}: {name}", value, which)
    if not least <= value <= most:
        which = which if value < least else f"{most} or less"
        raise ParameterError(f"{owner}: {name} = {represented(value)}; give {which}")
    return int(value)


def position(owner: str, name: str, i: Any, count: int) -> int:
    """Return a position that may count from the end as one from the start; see `whole`."""
    return whole(owner, name, i, -count, count - 1) % count


def time_limit_from(owner: str, value: Any) -> float:
    """Return a time limit, s; infinite if there is none.

    Raises:
        ParameterError: The value is no positive number.
    """
    if value is None or (isinstance(value, float) and value == inf):
        return inf
    return number(owner, "timeout", value, positive=True)


def listed(call: str, names: Any) -> tuple[str, ...]:
    """Return names as a tuple.

    Raises:
        UsageError: They are a single text, no list of anything, or none.
    """
    try:
        found = () if isinstance(names, str) else tuple(map(str, names))
    except TypeError:
        found = ()
    if not found:
        raise UsageError.of_type(call, names, "a list of names")
    return found


def assign(dae: Dae, overrides: Mapping[str, float] | None = None) -> Values:
    """Replace the model's start values, parameters and inputs by a user's values.

    Raises:
        UnknownName: A name is no state, parameter or input of the model.
        ParameterError: A number is not finite or out of its bounds, or an inertia is not physical.
        InitialConditionError: A start value is given that follows from others.
        UsageError: These are no values by name.
    """
    UsageError.reject(dae.full_name, overrides, Mapping | None, "values by name, e.g. {'phi': 0.1}")
    usual, place = usual_numbers(dae)
    numbers, given = usual.copy(), dict(overrides or {})
    for name, value in given.items():
        if name not in place:
            settable_variable(dae, name)  # raises the error
        row, variable = place[name]
        given[name] = checked(dae, variable, value)
        if row is not None:
            numbers[row] = given[name]
    nx, np_ = len(dae.states), len(dae.parameters)
    x, p, u = numbers[:nx], numbers[nx : nx + np_], numbers[nx + np_ :]
    reject_twice(dae, given)
    _check_inertias(dae, p.tobytes())
    columns = {name: np.array([value]) for name, value in given.items()}
    starts, solved = solved_starts(dae, columns, x[None], p[None])
    if not solved.all():
        raise _no_such_start(dae, given)
    return Values(starts[0], p, u)


@cached_per_thread(64)
def usual_numbers(dae: Dae) -> tuple[Vector, dict[str, tuple[int | None, Variable]]]:
    """Return the model's own numbers of states, parameters and inputs, and where each one is.

    Outputs by which starts may be given are nowhere.
    """
    own = (*dae.x_start, *(v.start for v in (*dae.parameters, *dae.inputs)))
    place = {
        name: (row if row < len(own) else None, variable)
        for row, (name, variable) in enumerate(settable(dae).items())
    }
    return np.array(own, dtype=float), place


def plain_values(dae: Dae, given: Mapping[str, float]) -> dict[str, float]:
    """Return values of states, parameters and inputs; outputs are replaced by start values.

    Raises:
        CosimError: See `assign`.
    """
    ways = {way.variable.name: way.state for way in dae.start_outputs if way.variable.name in given}
    x = assign(dae, given).x if ways else ()
    plain = {name: value for name, value in given.items() if name not in ways}
    return plain | {dae.states[row].name: float(x[row]) for row in ways.values()}


def checked(dae: Dae, variable: Variable, value: Any) -> float:
    """Return a number that a user gives to one of a model's variables.

    Raises:
        InitialConditionError: It is a start value that follows from others.
        ParameterError: It is no finite number, or out of its bounds.

    Warns:
        UserWarning: An angle is of a size that degrees have, and radians hardly ever.
    """
    through = any(way.variable.name == variable.name for way in dae.start_outputs)
    if variable.start_kind is Start.CALCULATED and not through:
        raise _calculated(dae, variable)
    result = number(dae.full_name, f"{variable.name} [{variable.unit}]", value)
    if not variable.minimum <= result <= variable.maximum:
        raise ParameterError(
            f"{dae.full_name}: {variable.name} = {with_unit(result, variable.unit)} is out of its "
            f"range {variable.minimum:g} ... {with_unit(variable.maximum, variable.unit)}; give a "
            "value within"
        )
    if variable.unit == "rad" and abs(result) > max(4 * pi, 10 * variable.nominal):
        warn(
            f"{dae.full_name}: {variable.name} = {result:g} rad is more than two turns; write "
            f"{result:g}deg if degrees are meant",
            stacklevel=2,
        )
    return result


def _calculated(dae: Dae, variable: Variable) -> InitialConditionError:
    """Name the variables from which a start value follows, to set instead."""
    row = dae.states.index(variable)
    rule = next(rule for rule in dae.start_rules if row in rule.states)
    used = {symbol.name() for symbol in ca.symvar(rule.expression)}
    free = (v.name for v in (*dae.states, *dae.parameters) if v.start_kind is Start.EXACT)
    causes = [name for name in free if name in used]
    shown = shortened(causes, 8)
    return InitialConditionError(
        f"{dae.full_name}: the start of {variable.name} is calculated ({rule.meaning}); "
        f"set some of {shown} instead"
    )


def _no_such_start(dae: Dae, given: Mapping[str, float]) -> InitialConditionError:
    ways = [way for way in dae.start_outputs if way.variable.name in given]
    states = ", ".join(dae.states[way.state].name for way in ways)
    through = ", ".join(
        f"{v.name} = {with_unit(given[v.name], v.unit)}" for v in (way.variable for way in ways)
    )
    return InitialConditionError(
        f"{dae.full_name}: no start of {states} was found that gives {through}; "
        f"set {states} directly"
    )


def settable_variable(dae: Dae, name: str) -> Variable:
    """Return a variable of `settable`.

    Raises:
        UnknownName: There is none of this name.
    """
    known = settable(dae)
    if name in known:
        return known[name]
    if any(v.name == name for v in dae.variables):
        raise UnknownName(
            f"{dae.full_name}: '{name}' is a result of the model and cannot be set; "
            "set a state's start, a parameter or an input"
        )
    raise UnknownName.of_model(dae.full_name, "state, parameter or input", name, known)


def settable(dae: Dae) -> dict[str, Variable]:
    """Return the variables whose values can be set, by name: states, parameters, inputs.

    And the outputs by which starts may be given.
    """
    through = (way.variable for way in dae.start_outputs)
    return {v.name: v for v in (*dae.states, *dae.parameters, *dae.inputs, *through)}


@cached_per_thread(16)
def _inertia_function(dae: Dae, variants: int) -> ca.Function:
    matrices = ca.horzcat(*(ca.vec(matrix) for _, matrix in dae.inertias))
    function = ca.Function("inertias", [dae.p], [ca.densify(matrices)])
    return function if variants == 1 else function.map(variants)


def inertias(dae: Dae, p: Vector) -> Vector:
    """Return the inertia of every body, (variants, bodies, 3, 3), for parameters (variants, np)."""
    blocks = np.array(_inertia_function(dae, len(p))(p.T))
    return blocks.T.reshape(len(p), len(dae.inertias), 3, 3)


def unphysical(matrices: Vector) -> Truths:
    """Return for each variant, (variants, bodies, 3, 3), whether one is impossible: (variants,).

    That is one whose moments are negative, or where one exceeds the sum of the others.
    """
    finite: Truths = np.logical_and.reduce(np.isfinite(matrices), axis=(2, 3))
    whole = np.where(finite[:, :, None, None], matrices, 0.0)
    moments = np.linalg.eigvalsh((whole + whole.swapaxes(2, 3)) / 2)
    slack = 1e-9 * np.abs(moments).max(axis=2)
    low, middle, high = np.moveaxis(moments, 2, 0)
    none = (low < -slack) | (high > low + middle + slack)
    result: Truths = (none | ~finite).any(axis=1)
    return result


def own_sizes(dae: Dae, x0: Vector) -> Vector:
    """Return the nominal values of states, (..., nx), from their initial values of that shape.

    They are those of the model; a small initial value is its own one where the model sets none,
    unless it is so small that it may be a rounding error of another one, or 1 / it overflows.
    """
    free, declared = _declared_sizes(dae)
    size = np.abs(x0)
    rounding = ROUNDING_OF_OTHERS * size.max(axis=-1, keepdims=True, initial=0.0)
    rounding = np.maximum(rounding, 1 / np.finfo(float).max)
    return np.where(free & (rounding < size) & (size < _SMALL), size, declared)


def error_sizes(dae: Dae, x0: Vector, absolute: float | None) -> Vector:
    """Return what errors of the states are measured by, (..., nx), from their initial values.

    A requested absolute tolerance is of the declared nominal values; without one, see `own_sizes`.
    """
    return own_sizes(dae, x0 if absolute is None else np.zeros_like(x0))


@cached_per_thread(16)
def _declared_sizes(dae: Dae) -> tuple[Truths, Vector]:
    """Return which states have no nominal value of their own, and the nominal values, (nx,)."""
    exact = (v.nominal == NOT_GIVEN and v.start_kind is Start.EXACT for v in dae.states)
    return np.fromiter(exact, dtype=bool), np.array([v.nominal for v in dae.states])


@cached_per_thread(64)
def _check_inertias(dae: Dae, numbers: bytes) -> None:
    """Reject impossible inertias: negative moments, or one above the sum of the others."""
    if not dae.inertias:
        return
    (matrices,) = inertias(dae, np.frombuffer(numbers)[None])
    for (body, _), matrix in zip(dae.inertias, matrices, strict=True):
        if not unphysical(matrix[None, None]).any():
            continue
        if not np.isfinite(matrix).all():
            raise ParameterError(
                f"{dae.full_name}: the inertia of {body} is not finite; give smaller parameters"
            )
        moments = np.linalg.eigvalsh((matrix + matrix.T) / 2)
        raise ParameterError(
            f"{dae.full_name}: the inertia of {body} has principal moments "
            f"{moments[0]:.6g}, {moments[1]:.6g}, {moments[2]:.6g} kg.m2, which no body has; "
            "none may be negative or exceed the sum of the other two"
        )
