"""What users give for inputs: numbers, texts, samples, functions and formulas of time."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from numbers import Real
from typing import Any

import casadi as ca
import numpy as np
from casadi import SX

from casadi_models.dae import Dae
from casadi_models.dae.starts import refuse_disorder
from cosim.arrays import Vector
from cosim.errors import ParameterError, UnknownName, UsageError
from cosim.memo import kept_per_thread
from cosim.model.formula import expression
from cosim.model.inputs import FollowedInputs, InputSeries
from cosim.model.quantities import quantity

Law = str | Callable[[Any], Any]


@dataclass(frozen=True)
class Driven:
    """A model with its inputs settled.

    Attributes:
        dae: The model, laws of time in place of the inputs that follow one.
        constants: Numbers of other inputs, SI.
        series: Samples of the rest.
    """

    dae: Dae
    constants: Mapping[str, float]
    series: InputSeries | None


def driven(dae: Dae, inputs: Any, times: Callable[[], Vector]) -> Driven:
    """Settle the inputs of a run.

    A law is put into the equations where CasADi can take it, so that solvers follow it as exactly
    as the states. One that needs numbers (with `if`, a table) is sampled at the output times.

    Args:
        dae: The model.
        inputs: An `InputSeries`; or by name a number, a text with a unit, a formula of time,
            states and parameters, a function of time, samples at the output times (n,), or an
            `InputSeries` with that input.
        times: Returns the output times, s, (n,).

    Raises:
        UnknownName: The model has no such input, or a formula an unknown name.
        ParameterError, UsageError: A value is none of these.
    """
    if inputs is None or isinstance(inputs, InputSeries):
        return Driven(dae, {}, inputs)
    if not isinstance(inputs, Mapping):
        wanted = "what read_inputs returns, or values by name, e.g. {'steer_torque': 1.0}"
        raise UsageError.of_type(f"{dae.full_name}: inputs", inputs, wanted)
    known = {variable.name: variable for variable in dae.inputs}
    constants, laws, pieces = dict[str, float](), list[tuple[str, Law]](), list[InputSeries]()
    for name, value in inputs.items():
        if name not in known:
            raise UnknownName.among(dae.full_name, "input", str(name), known)
        if isinstance(value, str) and _is_quantity(value):
            constants[name] = quantity(name, value, known[name].unit)
        elif isinstance(value, Real):
            constants[name] = float(value)
        elif isinstance(value, InputSeries):
            pieces.append(_column(name, value))
        elif isinstance(value, str) or (callable(value) and _is_symbolic(dae, value, times())):
            laws.append((name, value))
        else:
            pieces.append(_samples(dae.full_name, name, value, times()))
    if laws:
        dae = with_laws(dae, tuple(laws))
    return Driven(dae, constants, _joined_series(pieces))


def followed(owner: str, inputs: Any, times: Vector) -> InputSeries | None:
    """Return the inputs of a run whose equations cannot be changed: an FMU's.

    Formulas and functions of time are followed wherever the FMU is told a time.

    Args:
        owner: Who asks, for messages.
        inputs: An `InputSeries`; or by name a number, a formula or a function of time, samples at
            the output times (n,), or an `InputSeries` with that input.
        times: Output times, s, (n,).

    Raises:
        UnknownName, ParameterError, UsageError: See `driven`.
    """
    if inputs is None or isinstance(inputs, InputSeries):
        return inputs
    if not isinstance(inputs, Mapping):
        wanted = "what cosim.read_inputs returns, or values by name, e.g. {'u': 'sin(t)'}"
        raise UsageError.of_type(f"{owner}: inputs", inputs, wanted)
    laws, pieces = dict[str, Callable[[Vector], Vector]](), list[InputSeries]()
    ends = times[[0, -1]] if len(times) > 1 else times[0] + np.array([0.0, 1.0])
    for name, value in inputs.items():
        if isinstance(value, InputSeries):
            pieces.append(_column(name, value))
            continue
        law: Callable[[Any], Any] | None = value if callable(value) else None
        if isinstance(value, str):
            law = _function_of_time(f"{owner}: {name}", value)
        elif isinstance(value, Real):
            law = partial(_constant, float(value))
        if law is not None:
            laws[name] = _on_arrays(law)
        pieces.append(_samples(owner, name, law or value, ends if law else times))
    joined = _joined_series(pieces)
    return joined and FollowedInputs(joined.names, joined.time, joined.values, laws)


def _function_of_time(owner: str, text: str) -> Callable[[float], float]:
    time = SX.sym("time")
    function = ca.Function("law", [time], [expression(owner, text, {"t": time, "time": time})])
    return lambda t: float(function(t))


def _constant(value: float, _time: float) -> float:
    return value


def _on_arrays(law: Callable[[Any], Any]) -> Callable[[Vector], Vector]:
    return lambda times: np.array([law(float(t)) for t in times], dtype=float)


@kept_per_thread(16)
def with_laws(dae: Dae, laws: tuple[tuple[str, Law], ...]) -> Dae:
    """Return the model with formulas, or functions that CasADi can take, in place of inputs.

    Raises:
        UnknownName: There is no such input, or a formula has an unknown name.
        ParameterError: It is no formula.
    """
    known = [variable.name for variable in dae.inputs]
    rows = ca.vertsplit(dae.u) if known else []
    for name, law in laws:
        if name not in known:
            raise UnknownName.among(dae.full_name, "input", name, known)
        owner = f"{dae.full_name}: {name}"
        found = (
            expression(owner, law, names_of(dae)) if isinstance(law, str) else _symbolic(dae, law)
        )
        rows[known.index(name)] = found
    left = [i for i, name in enumerate(known) if name not in dict(laws)]
    u = ca.vertcat(*(dae.u[i] for i in left)) if left else SX(0, 1)
    followed = dae.rewritten(lambda laws: ca.substitute(laws, [dae.u], [ca.vertcat(*rows)]))
    try:
        refuse_disorder(followed.start_rules, dae.t, dae.x, u, dae.p)
    except ValueError as error:
        names = ", ".join(name for name, _ in laws)
        raise UsageError(f"{dae.full_name}: {names}: {error}; give it as numbers") from None
    return replace(followed, u=u, inputs=tuple(dae.inputs[i] for i in left))


def names_of(dae: Dae) -> dict[str, SX]:
    """Return what a formula may use of a model: time, states and parameters."""
    symbols = {"t": dae.t, "time": dae.t}
    for column, variables in ((dae.x, dae.states), (dae.p, dae.parameters)):
        symbols |= {v.name: s for v, s in zip(variables, ca.vertsplit(column), strict=True)}
    return symbols


def _is_quantity(text: str) -> bool:
    try:
        quantity("", text, "1")
    except ParameterError as error:
        return "cannot be converted" in str(error)
    return True


def _is_symbolic(dae: Dae, law: Callable[[Any], Any], grid: Vector) -> bool:
    """Tell whether CasADi can take a function: it gives an expression with the same numbers."""
    try:
        found = _symbolic(dae, law)
        numbers = ca.Function("law", [dae.t], [found])
        return all(
            np.isclose(float(numbers(t)), float(law(float(t))), rtol=1e-9, atol=1e-300)
            for t in (grid[0], grid[len(grid) // 2], grid[-1])
        )
    except Exception:  # whatever a function for numbers makes of a symbol
        return False


def _symbolic(dae: Dae, law: Callable[[Any], Any]) -> SX:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)  # of CasADi, on numpy's functions
        return SX(law(dae.t))


def _samples(owner: str, name: str, value: Any, grid: Vector) -> InputSeries:
    try:
        samples = [value(float(t)) for t in grid] if callable(value) else value
        array = np.array(samples, dtype=float)
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
    return InputSeries((name,), grid, array[:, None])


def _column(name: str, series: InputSeries) -> InputSeries:
    if name in series.names:
        found = series.only({name})
        assert found is not None
        return found
    if len(series.names) == 1:
        return replace(series, names=(name,))
    raise UnknownName.among("the input series", "column", name, series.names)


def _joined_series(pieces: Sequence[InputSeries]) -> InputSeries | None:
    """Return one series at the times of all; between their samples each stays a straight line."""
    if len(pieces) < 2:
        return pieces[0] if pieces else None
    time = np.unique(np.concatenate([piece.time for piece in pieces]))
    jumps = np.unique(np.concatenate([piece.jumps for piece in pieces]))
    time = np.sort(np.concatenate((time, jumps)))
    second = np.diff(time, prepend=-np.inf) == 0
    values = np.concatenate([np.where(second, p.at(time), p.before(time)) for p in pieces]).T
    return InputSeries(tuple(name for piece in pieces for name in piece.names), time, values)
