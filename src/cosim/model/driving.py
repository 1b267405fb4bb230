"""Inputs of a run from numbers, texts with units, samples, functions or formulas of time."""

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import count, pairwise
from numbers import Real
from typing import Any

import casadi as ca
import numpy as np
from casadi import SX

from casadi_models.dae import Dae, Model, Variable
from casadi_models.dae.starts import reject_disorder
from casadi_models.dae.variables import is_name
from casadi_models.units import Unit, parse_unit
from cosim.arrays import Vector, reals
from cosim.errors import ParameterError, UnknownName, UsageError
from cosim.memo import cached_per_thread
from cosim.model.dimensions import mixed_units
from cosim.model.formula import expression, quoted
from cosim.model.inputs import FollowedInputs, InputSeries
from cosim.model.quantities import quantity
from cosim.model.switching import switch_times
from cosim.model.values import number
from cosim.series.curves import graded

_STEEP = 0.02  # share of a function's range within a sampling interval that may be a jump
_LOOKS = 7  # at a function between two output times
_PEAK = 0.1  # departure from the line between two samples that matters, as a share of the range
_IN_PULSE = 4  # parts between two of the times that show a pulse of a formula
_TRIALS = 5  # bisections after which only a jump is still half as high
Law = str | Callable[[Any], Any]
Pulses = Callable[[Dae, Vector, float, float], Vector]  # of a model with parameters, in a span, s


@dataclass(frozen=True)
class Driven:
    """A model and the values of its inputs.

    Attributes:
        dae: The model; formulas replace the inputs that they define.
        constants: Constant values of other inputs, and of the constants of formulas, by name, SI.
        series: Samples of the remaining inputs.
    """

    dae: Dae
    constants: Mapping[str, float]
    series: InputSeries | None


def driven(dae: Dae, inputs: Any, times: Callable[[], Vector]) -> Driven:
    """Convert the inputs of a run into equations, constants and samples.

    A formula, or a function that CasADi can evaluate symbolically, becomes part of the equations,
    so that solvers compute it as accurately as the states. A function that needs numbers (with
    `if`, a table) is sampled at the output times.

    Args:
        inputs: An `InputSeries`; or by name a number, a text with a unit, a formula of time,
            states and parameters, such a formula with constants of its own, ("k*phi", {"k": 2.0}),
            which become parameters of the model, a function of time, samples at the output times
            (n,), or an `InputSeries` with that input.
        times: Returns the output times, s, (n,).

    Raises:
        UnknownName: The model has no such input, or a formula uses an unknown name.
        ParameterError, UsageError: A value has none of these types.
    """
    if inputs is None or isinstance(inputs, InputSeries):
        return Driven(dae, {}, inputs)
    known = {variable.name: variable for variable in dae.inputs}
    constants, laws, pieces = dict[str, float](), list[tuple[str, Law]](), list[InputSeries]()
    own = set[str]()
    for name, value, numbers in _by_name(dae.full_name, inputs):
        UnknownName.reject(dae.full_name, "input", known, name)
        own |= numbers.keys()
        if twice := {n for n, v in numbers.items() if constants.setdefault(n, v) != v}:
            raise UsageError(f"{dae.full_name}: {min(twice)} has two values; give it one")
        if (constant := constant_of(name, value, known[name].unit)) is not None:
            constants[name] = constant
        elif isinstance(value, Real):
            constants[name] = number(dae.full_name, name, value)
        elif isinstance(value, InputSeries):
            pieces.append(_column(name, value))
        elif isinstance(value, str) or (callable(value) and _is_symbolic(dae.t, value, times())):
            laws.append((name, value))
        else:
            pieces.append(_samples(dae.full_name, name, value, times()))
    if laws:
        dae = with_laws(dae, tuple(laws), tuple(sorted(own)))
    return Driven(dae, constants, _joined_series(pieces))


def _by_name(owner: str, inputs: Any) -> Iterator[tuple[str, Any, Mapping[str, float]]]:
    """Yield the name and the value of each input, and the constants of a formula."""
    if not isinstance(inputs, Mapping):
        expected = "what cosim.read_inputs returns, or values by name, e.g. {'u': 'sin(t)'}"
        raise UsageError.of_type(f"{owner}: inputs", inputs, expected)
    for name, given in inputs.items():
        if isinstance(given, tuple) and [*map(type, given)] == [str, dict]:
            yield str(name), *given
        else:
            yield str(name), given, {}


def with_held(
    owner: str, inputs: Any, times: Vector, held: Mapping[str, Callable[[Any], float]]
) -> Any:
    """Return the inputs of a run, of which some keep the value of a sample until the next one.

    Args:
        owner, inputs, times: See `followed`.
        held: By the names of these inputs, what turns a value into a number, or rejects it.

    Raises:
        ParameterError: An input cannot have a value.
        UsageError: An input follows a formula or a function.
    """
    if isinstance(inputs, InputSeries):
        inputs = dict.fromkeys(inputs.names, inputs) if held.keys() & {*inputs.names} else inputs
    if not isinstance(inputs, Mapping):
        return inputs
    found = dict(inputs)
    for name in held.keys() & inputs.keys():
        value = inputs[name]
        if isinstance(value, str | Real):
            found[name] = held[name](value)
        elif callable(value) or isinstance(value, tuple):
            raise UsageError(
                f"{owner}: {name} changes at events only and follows no formula; give a value, "
                "or samples"
            )
        else:
            is_series = isinstance(value, InputSeries)
            series = _column(name, value) if is_series else _samples(owner, name, value, times)
            for one in np.unique(series.values):
                held[name](float(one))
            found[name] = series.held()
    return found


def followed(
    owner: str,
    inputs: Any,
    times: Vector,
    units: Mapping[str, tuple[str, Mapping[str, Unit]]],
    pulses: Pulses,
) -> InputSeries | None:
    """Return the inputs of an FMU, whose equations cannot be changed.

    Formulas and functions of time are evaluated at every time that the FMU receives.

    Args:
        inputs: An `InputSeries`; or by name a number, a formula or a function of time, samples at
            the output times (n,), or an `InputSeries` with that input.
        times: Output times, s, (n,).
        units: By the name of an input: its unit, and the units in which a value may be written.
        pulses: Returns the times at which steps must end to see all terms of time.

    Raises:
        UnknownName, ParameterError, UsageError: See `driven`.
    """
    if inputs is None or isinstance(inputs, InputSeries):
        return inputs
    laws, pieces = dict[str, Callable[[Vector], Vector]](), list[InputSeries]()
    ends = times[[0, -1]] if len(times) > 1 else times[0] + np.array([0.0, 1.0])
    for name, value, numbers in _by_name(owner, inputs):
        UnknownName.reject(owner, "input", units, name)
        unit, definitions = units[name]
        if (constant := constant_of(name, value, unit, definitions)) is not None:
            value = constant
        if isinstance(value, InputSeries):
            pieces.append(_column(name, value))
        elif isinstance(value, Real):
            pieces.append(_samples(owner, name, [number(owner, name, value)] * 2, ends))
        elif isinstance(value, str) or callable(value):
            law, model = _law(f"{owner}: {name}", value, numbers, unit, times)
            if model is not None:
                switches = switch_times(model, *ends.tolist())
                own = pulses(model, np.empty(0), *ends.tolist())
                looks = _divided(np.union1d(ends, own)) if len(own) else ends
            else:
                looks, switches = ends, _samples(owner, name, value, times).jumps
            laws[name] = _on_arrays(law)
            around = np.sort(np.append(np.union1d(looks, switches), switches))
            pieces.append(InputSeries((name,), around, laws[name](around)[:, None]))
        else:
            pieces.append(_samples(owner, name, value, times))
    joined = _joined_series(pieces)
    return joined and FollowedInputs(
        joined.names, joined.time, joined.values, laws, spans=joined.spans
    )


def _law(
    title: str, value: Any, constants: Mapping[str, float], unit: str, grid: Vector
) -> tuple[Callable[[float], float], Dae | None]:
    """Return a formula or function as a function, and as the derivative in a model if it can be."""
    model = Model("input")
    if isinstance(value, str):
        symbols = {name: SX(number) for name, number in constants.items()}
        names = symbols | {"t": model.t, "time": model.t}
        found = expression(title, value, names, {"": unit})
    elif _is_symbolic(model.t, value, grid):
        found = _symbolic(model.t, value)
    else:
        return value, None
    model.derivative(model.state("integral", "1", 0.0, "integral of the input"), found)
    function = ca.Function("law", [model.t], [found])
    return value if callable(value) else lambda t: float(function(t)), model.freeze()


def _divided(times: Vector) -> Vector:
    """Return times with others between and about them: an FMU takes inputs as lines."""
    edges = graded(times)
    last = len(edges) - 1
    parts = np.linspace(0, last, _IN_PULSE * last + 1)
    return np.asarray(np.interp(parts, np.arange(len(edges)), edges))


def _on_arrays(law: Callable[[Any], Any]) -> Callable[[Vector], Vector]:
    return lambda times: np.array([law(float(t)) for t in times], dtype=float)


def with_tables(dae: Dae, series: InputSeries) -> Dae:
    """Return the model in which the lines between samples replace inputs; jumps are events."""
    laws = tuple((name, partial(_on_lines, series, i)) for i, name in enumerate(series.names))
    return with_laws(dae, laws)


def _on_lines(series: InputSeries, column: int, t: SX) -> SX:
    """Return one column of samples as an expression of time."""
    time, values = series.time.tolist(), series.values[:, column].tolist()
    followed = SX(values[0])
    for (begin, value), (end, after) in pairwise(zip(time, values, strict=True)):
        if end > begin:
            line = value + (after - value) / (end - begin) * (t - begin)
            followed = ca.if_else(t >= begin, line, followed)
    return ca.if_else(t >= time[-1], values[-1], followed)


@cached_per_thread(16)
def with_laws(dae: Dae, laws: tuple[tuple[str, Law], ...], constants: tuple[str, ...] = ()) -> Dae:
    """Return the model in which formulas, or functions for CasADi, replace inputs.

    The names of constants in the formulas become parameters of the model.

    Raises:
        UnknownName: There is no such input, or a formula uses an unknown name.
        ParameterError: A formula is malformed.
        UsageError: The model has a variable with the name of a constant.
    """
    dae = _with_parameters(dae, constants)
    known = [variable.name for variable in dae.inputs]
    rows = ca.vertsplit(dae.u)
    for name, law in laws:
        UnknownName.reject(dae.full_name, "input", known, name)
        place = known.index(name)
        if not isinstance(law, str):
            rows[place] = _symbolic(dae.t, law)
        elif (constant := constant_of(name, law, dae.inputs[place].unit)) is not None:
            rows[place] = SX(constant)
        else:
            units = {v.name: v.unit for v in dae.variables} | {"": dae.inputs[place].unit}
            rows[place] = expression(f"{dae.full_name}: {name}", law, names_of(dae), units)
    left = [i for i, name in enumerate(known) if name not in dict(laws)]
    u = ca.vertcat(*(dae.u[i] for i in left)) if left else SX(0, 1)
    followed = dae.rewritten(lambda laws: ca.substitute(laws, [dae.u], [ca.vertcat(*rows)]))
    try:
        reject_disorder(followed.start_rules, dae.t, dae.x, u, dae.p)
    except ValueError as error:
        names = ", ".join(name for name, _ in laws)
        raise UsageError(f"{dae.full_name}: {names}: {error}; give samples instead") from None
    return replace(followed, u=u, inputs=tuple(dae.inputs[i] for i in left))


def _with_parameters(dae: Dae, names: tuple[str, ...]) -> Dae:
    known = {"t", "time", *(variable.name for variable in dae.variables)}
    for name in names:
        if name in known or not is_name(name):
            raise UsageError(f"{dae.full_name}: '{name}' cannot name a constant; use another name")
    more = (Variable(name, "1", "constant of a formula", 0.0) for name in names)
    p = ca.vertcat(dae.p, *map(SX.sym, names))
    return replace(dae, p=p, parameters=(*dae.parameters, *more)) if names else dae


def names_of(dae: Dae) -> dict[str, SX]:
    """Return the symbols that a formula may use, by name: time, states and parameters."""
    symbols = dict[str, SX]()
    for column, variables in ((dae.x, dae.states), (dae.p, dae.parameters)):
        symbols |= {v.name: s for v, s in zip(variables, ca.vertsplit(column), strict=True)}
    time = {"time": dae.t, "t": dae.t}
    if "t" in symbols:  # a formula with `t` could mean either
        del time["t"], symbols["t"]
    return time | symbols


def constant_of(
    name: str, value: Any, unit: str, definitions: Mapping[str, Unit] | None = None
) -> float | None:
    """Return the number of a text such as `2 N*m`; None for a formula, and what is no text.

    Raises:
        ParameterError: Its unit does not fit; see `quantity`. Or a formula has numbers with units,
            and the unit is none of SI that is known.
    """
    if not isinstance(value, str):
        return None
    try:
        quantity(name, value, "1", definitions=definitions)
    except ParameterError as error:
        if "cannot be converted" not in str(error):
            own = (definitions or {}).get(unit) or parse_unit(unit)
            if (own is None or not own.is_si) and quoted(name, value) != value:
                raise mixed_units(name, value, "the result", unit) from None
            return None
    return quantity(name, value, unit, definitions=definitions)


def _is_symbolic(t: SX, law: Callable[[Any], Any], grid: Vector) -> bool:
    """Return whether a function yields a CasADi expression with the same values."""
    try:
        numbers = ca.Function("law", [t], [_symbolic(t, law)])
        return all(
            np.isclose(float(numbers(at)), float(law(float(at))), rtol=1e-9, atol=1e-300)
            for at in (grid[0], grid[len(grid) // 2], grid[-1])
        )
    except Exception:  # a function for numbers may raise anything on a symbol
        return False


def _symbolic(t: SX, law: Callable[[Any], Any]) -> SX:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)  # CasADi warns about numpy's functions
        return SX(law(t))


def _samples(owner: str, name: str, value: Any, grid: Vector) -> InputSeries:
    try:
        samples = [value(float(t)) for t in grid] if callable(value) else value
        array = reals(samples)
        if callable(value) and len(grid) > 1:
            grid, array = _with_jumps(value, *_with_peaks(value, grid, array))
    except Exception as error:
        raise ParameterError(
            f"{owner}: {name} = {value!r} gives no samples ({error}); give a number, a "
            "text with a unit, a formula or function of time, or samples at the output times"
        ) from error
    if array.shape != grid.shape:
        raise ParameterError(
            f"{owner}: {name} has samples of shape {array.shape}; the run has "
            f"{len(grid)} output times; give as many, or an InputSeries"
        )
    if len(grid) == 1:  # a run of no length
        grid, array = grid[0] + np.arange(2.0), np.repeat(array, 2)
    return InputSeries((name,), grid, array[:, None])


def _with_peaks(
    law: Callable[[float], Any], times: Vector, samples: Vector
) -> tuple[Vector, Vector]:
    """Return samples of a function with more of them where it departs from the line between two."""
    shares = np.linspace(0, 1, _LOOKS + 2)[1:-1]
    inner = times[:-1, None] + np.diff(times)[:, None] * shares
    found = np.array([[float(law(float(t))) for t in row] for row in inner])
    apart = np.abs(found - samples[:-1, None] - np.diff(samples)[:, None] * shares)
    odd = (apart > _PEAK * np.ptp(np.append(samples, found))).any(axis=1)
    times, order = np.unique(np.append(times, inner[odd]), return_index=True)
    return times, np.append(samples, found[odd])[order]


def _with_jumps(
    law: Callable[[float], Any], times: Vector, samples: Vector
) -> tuple[Vector, Vector]:
    """Return samples of a function with those on both sides of every jump between them."""
    gaps = np.abs(np.diff(samples))
    for k in np.flatnonzero(gaps > _STEEP * np.ptp(samples))[::-1].tolist():
        (low, high), (before, after) = times[k : k + 2], samples[k : k + 2]
        for trial in count():
            middle = 0.5 * (low + high)
            steep = abs(after - before) >= 0.5 * gaps[k]
            if not low < middle < high or (trial > _TRIALS and not steep):
                break
            value = float(law(float(middle)))
            if abs(value - before) > abs(after - value):
                high, after = middle, value
            else:
                low, before = middle, value
        if steep:
            near = 4 * np.spacing(abs(high))  # the time of a sample itself
            begins, ends = low - times[k] < near, times[k + 1] - high < near
            more = [after] if begins else [before] if ends else [before, after]
            samples = np.insert(samples, k + 1, more)
            at = times[k] if begins else times[k + 1] if ends else high
            times = np.insert(times, k + 1, [at] * len(more))
    return times, samples


def _column(name: str, series: InputSeries) -> InputSeries:
    if name in series.names:
        found = series.only({name})
        assert found is not None
        return found
    if len(series.names) == 1:
        return replace(series, names=(name,))
    raise UnknownName.among("the input series", "column", name, series.names)


def _joined_series(pieces: Sequence[InputSeries]) -> InputSeries | None:
    """Return one series at the times of all series, each interpolated linearly."""
    if len(pieces) < 2:
        return pieces[0] if pieces else None
    time = np.unique(np.concatenate([piece.time for piece in pieces]))
    jumps = np.unique(np.concatenate([piece.jumps for piece in pieces]))
    time = np.sort(np.concatenate((time, jumps)))
    second = np.diff(time, prepend=-np.inf) == 0
    values = np.concatenate([np.where(second, p.at(time), p.before(time)) for p in pieces]).T
    spans = {n: p.spans.get(n, (p.time[0], p.time[-1])) for p in pieces for n in p.names}
    return InputSeries(tuple(spans), time, values, spans=spans)
