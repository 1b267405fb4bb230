"""`from_casadi`: import of CasADi symbols and expressions as a `Dae`."""

import os
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from casadi import MX, SX

from casadi_models.dae import Dae, Model
from casadi_models.dae.relations import term_sizes
from casadi_models.units import known as known_unit
from cosim.arrays import Vector, reals
from cosim.errors import InitialConditionError, ParameterError, UnknownName, UsageError
from cosim.model.foreign.casadi_system import (
    SYMBOLS,
    System,
    entry_names,
    evaluated,
    is_reduction,
    read_system,
    reject_sizes,
    scalars,
)
from cosim.model.foreign.named_symbols import Symbol

START_TOLERANCE = 1e-12  # of a constraint at the start, relative to its terms
PIVOT = 1e-8  # below, a constraint repeats others
NEWTON_STEPS = 50


class ConsistentStart(NamedTuple):
    """A start that satisfies the constraints: all states, (nx,), and what determines which of them.

    `states` follow from the others by the constraints `rows`, which repeat no other one.
    """

    x: Vector
    rows: tuple[int, ...]
    states: tuple[int, ...]


def _consistent_start(
    who: str, constraints: ca.Function, starts: Mapping[str, float], p: Vector, given: Set[int]
) -> ConsistentStart:
    """Move the states that are not given onto constraints, by least squares.

    `constraints(x, p)` returns them, (m,), and the sizes of their terms.
    `casadi.dae_reduce_index` returns the original constraints as `I`; a solution keeps them at zero
    if they are zero at its start. Some states are therefore calculated from the others.
    """
    names, x = [*starts], np.array([*starts.values()], dtype=float)
    slope = constraints.factory("slope", constraints.name_in(), ["jac:I:x"])
    free = [i for i in range(x.size) if i not in given]
    terms = np.asarray(constraints(np.abs(x) + np.abs(x).max(), p)[1]).ravel()
    terms[terms == 0] = 1.0
    powers = 1024.0 ** np.trunc(np.log(terms) / np.log(1024))  # 1 for rows of usual size
    for _ in range(NEWTON_STEPS):
        residual = np.asarray(constraints(x, p)[0]).ravel()
        if (np.abs(residual) <= START_TOLERANCE * np.fmin(terms, 1 + np.abs(x).max())).all():
            break
        matrix = np.asarray(ca.DM(slope(x, p)))[:, free]
        if not (np.isfinite(matrix).all() and np.isfinite(residual).all()):
            break
        x[free] -= np.linalg.lstsq(matrix / powers[:, None], residual / powers, rcond=1e-12)[0]
    residual = np.asarray(constraints(x, p)[0]).ravel()
    worst = int(np.argmax(np.nan_to_num(np.abs(residual) / terms, nan=np.inf)))
    if not abs(residual[worst]) <= 1e3 * START_TOLERANCE * terms[worst]:
        fixed = ", ".join(names[i] for i in sorted(given)) or "none"
        raise InitialConditionError(
            f"{who}: constraint {worst + 1} of I is {residual[worst]:.3g} at the start and cannot "
            f"vanish with the given starts ({fixed}); give consistent ones, or fewer"
        )
    slopes = np.asarray(ca.DM(slope(x, p))) / powers[:, None]
    rows, states = _pivots(slopes, free, sorted(given))
    return ConsistentStart(x, rows, states)


def _pivots(matrix: Vector, *groups: Sequence[int]) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return rows and columns of a regular part, with columns of the first group where possible."""
    rest, size = matrix.copy(), np.abs(matrix).max(initial=0.0)
    rows: list[int] = []
    columns: list[int] = []
    for group in groups:
        for _ in range(min(len(group), matrix.shape[0])):
            part = np.abs(rest[:, group])
            row, place = np.unravel_index(int(np.argmax(part)), part.shape)
            if part[row, place] <= PIVOT * size:
                break
            column = group[int(place)]
            rows.append(int(row))
            columns.append(int(column))
            rest -= np.outer(rest[:, column] / rest[row, column], rest[row])
            rest[row] = 0.0
    return tuple(rows), tuple(columns)


@dataclass(frozen=True)
class Facts:
    """Start values, units, meanings and nominal values by name; see `from_casadi`."""

    who: str
    starts: Mapping[str, Any]
    units: Mapping[str, str]
    meanings: Mapping[str, str]
    nominals: Mapping[str, float]

    def reject_strangers(self, system: System) -> None:
        """Reject values for what does not exist.

        Raises:
            UnknownName: With the names that come nearest.
        """
        symbols = [s for kind in "xzup" for s in system.symbols[kind]]
        if not (symbols or system.laws or system.outputs):
            raise UsageError(f"{self.who}: there is neither a state nor an output; give one")
        quads = scalars("quad", system.laws["quad"]) if "quad" in system.laws else []
        own = [n for s in symbols for n in (s.name, *s.entries)]
        own += ["quad", *(n for n, _ in quads)] if quads else []
        shown = [n for key, e in system.outputs.items() for n in (key, *entry_names(key, e))]
        for option, what, given, known in (
            ("start_values", "start value", self.starts, own),
            ("units", "unit", self.units, own + shown),
            ("meanings", "meaning", self.meanings, own + shown),
            ("nominals", "nominal value", self.nominals, own + shown),
        ):
            UsageError.reject(f"{self.who}: {option}", given, Mapping, "a dict by name")
            UnknownName.reject(self.who, f"variable for the {what} of", known, *given)

    def of(self, name: str, symbol: str, meaning: str) -> tuple[str, str, dict[str, Any]]:
        """Return unit, meaning and further facts of a variable."""
        unit = self.units.get(name, self.units.get(symbol, "1"))
        meaning = self.meanings.get(name, self.meanings.get(symbol, meaning))
        more: dict[str, Any] = {}
        UsageError.reject(f"{self.who}: unit of {name}", unit, str, "a text")
        if not known_unit(unit):
            more["foreign_unit"] = True
            meaning = f"{meaning} (unit '{unit}' is unknown here: factor 1)"
        nominal = self.nominals.get(name, self.nominals.get(symbol))
        if nominal is not None:
            more["nominal"] = nominal
        return unit, meaning, more

    def start(self, symbol: Symbol, kind: str) -> list[Any]:
        """Return the start of each variable of a symbol: a number or an expression.

        Raises:
            ParameterError: A parameter has none, or there are too many or too few.
        """
        default = None if kind == "p" else 0.0
        values: list[Any] = [default] * len(symbol.entries)
        if symbol.name in self.starts:
            values = self._spread(symbol.name, len(values))
        for i, entry in enumerate(symbol.entries):
            if entry in self.starts and entry != symbol.name:
                (values[i],) = self._spread(entry, 1)
        missing = [e for e, value in zip(symbol.entries, values, strict=True) if value is None]
        if missing:
            raise ParameterError(
                f"{self.who}: parameter {', '.join(missing)} has no value; give it one"
            )
        return values

    def _spread(self, name: str, size: int) -> list[Any]:
        """Return as many start values as a variable has entries from those given for it."""
        given = self.starts[name]
        if isinstance(given, SX | MX):
            entries: list[Any] = ca.vertsplit(ca.vec(given))
        else:
            try:
                if given is None or np.asarray(given).dtype == bool:
                    raise TypeError
                entries = [float(v) for v in reals(given).flatten(order="F")]
            except (TypeError, ValueError):
                raise ParameterError(
                    f"{self.who}: start of {name} is {given!r}; give numbers"
                ) from None
        if len(entries) not in (1, size):
            raise ParameterError(
                f"{self.who}: {name} has {size} entries, but {len(entries)} start values"
            )
        return entries * size if len(entries) == 1 else list(entries)


CONSTRAINTS = "the constraints that index reduction keeps"
_OPTIONS = (
    *("start_values", "outputs", "units", "meanings", "nominals", "name", "description"),
    *("stop_time", "output_interval"),
)


def from_casadi(
    system: Any,
    start_values: Mapping[str, Any] | None = None,
    outputs: Mapping[str, Any] | None = None,
    *,
    name: str = "model",
    description: str = "",
    units: Mapping[str, str] | None = None,
    meanings: Mapping[str, str] | None = None,
    nominals: Mapping[str, float] | None = None,
    stop_time: float = 10.0,
    output_interval: float = 0.01,
) -> Dae:
    """Return the DAE of CasADi expressions, ready for both backends.

    A vector symbol `y` gives the variables `y_1` ... `y_n`, a matrix `A` gives `A_1_2` and so on;
    every mapping below takes the name of a variable, or that of its symbol for all its variables.

    Args:
        system: A mapping of `x`, `ode`, and where needed `t`, `z`, `u`, `p`, `alg`, `quad`, `zero`
            to SX or MX (a list of symbols is their column), with `zero` also the Function
            `transition` of `casadi.integrator`; a `casadi.Function` with inputs and outputs of
            these names, whose other outputs become outputs of the model; the path of a saved
            Function (.casadi); or the result of `casadi.dae_reduce_index`. A quadrature becomes a
            state.
        start_values: Numbers (for a vector: as many, or one for all) of states, inputs, parameters
            and initial guesses of z; of states also expressions of parameters, inputs and time.
            The default is a Function's own `default_in`, or 0; parameters need a value.
        outputs: Expressions by name.
        name, description: Of the model.
        units, meanings, nominals: By name; "1", the name, and 1 by default. An unknown unit has
            the factor 1, which the meaning states.
        stop_time, output_interval: Of the run that the model is shown with, s.

    Raises:
        UsageError: Something is missing, of the wrong size, or has neither equations nor C code.
        UnknownName: A value is given for what does not exist.

    Example:
        >>> import casadi as ca
        >>> x, k = ca.SX.sym("x"), ca.SX.sym("k")
        >>> dae = from_casadi({"x": x, "p": k, "ode": -k * x}, {"x": 1, "k": 2}, {"twice": 2 * x})
        >>> [v.name for v in dae.variables]
        ['x', 'twice', 'k']
    """
    who = f"from_casadi({name})"
    UsageError.reject(f"{who}: outputs", outputs, Mapping | None, "a dict of expressions by name")
    found = read_system(who, system, outputs or {})
    facts = Facts(who, start_values or {}, units or {}, meanings or {}, nominals or {})
    reject_sizes(who, found)
    try:
        model = Model(
            name,
            description=description or f"{name}, from CasADi expressions",
            source="casadi",
            stop_time=stop_time,
            output_interval=output_interval,
        )
        x, laws = declare_system(found, facts, model)
        if "I" in laws:
            model.invariant("constraint_drift", x, laws["I"], CONSTRAINTS)
        return model.freeze()
    except ValueError as error:
        raise UsageError(f"from_casadi: {error}") from error


def is_system(value: object) -> bool:
    """Return whether `from_casadi` accepts this object, alone or paired with start values."""
    if isinstance(value, tuple) and len(value) == 2:
        return is_system(value[0])
    if isinstance(value, str | os.PathLike):
        return os.fspath(value).endswith(".casadi")
    return isinstance(value, ca.Function) or (
        isinstance(value, Mapping) and not {"ode", "alg", "quad"}.isdisjoint(value)
    )


def from_user(value: Any, name: str) -> Dae:
    """Return the DAE of the system and options that a user's function returned.

    Args:
        value: A system; a mapping may hold the options of `from_casadi`, too; or a pair of a system
            and its start values.
        name: Of the model, where the mapping does not say.
    """
    options: dict[str, Any] = {"name": name}
    if isinstance(value, tuple) and not is_reduction(value):
        value, options["start_values"] = value
    if isinstance(value, Mapping):
        options |= {key: value[key] for key in _OPTIONS if key in value}
        value = {key: item for key, item in value.items() if key not in options}
    return from_casadi(value, **options)


def declare_system(system: System, facts: Facts, model: Model) -> tuple[SX, dict[str, SX]]:
    """Return the states and all laws in the symbols of the model; of `I` the independent rows."""
    facts.reject_strangers(system)
    who, facts = facts.who, replace(facts, starts=system.starts | dict(facts.starts))
    starts = {kind: _given_starts(who, system, facts, kind) for kind in "xzup"}
    rules = {entry: start for entry, start in starts["x"].items() if not isinstance(start, float)}
    starts["x"] |= dict.fromkeys(rules, 0.0)
    consistent = None
    if "I" in system.laws:
        if rules:
            raise UsageError(f"{who}: starts of a reduced DAE follow from I; give numbers")
        consistent = _consistent(who, system, facts, starts)
        starts["x"] = dict(zip(starts["x"], consistent.x.tolist(), strict=True))

    values = _declared(system, facts, starts, model)
    expressions = system.laws | system.outputs | {f"start of {n}": e for n, e in rules.items()}
    expressions |= {f"jump {i}": states for i, states in enumerate(system.jumps())}
    results = evaluated(who, system, values, expressions)
    model.derivative(values["x"], results.get("ode", SX(0, 1)))
    model.equation(results.get("alg", SX(0, 1)))
    for i, zero in enumerate(ca.vertsplit(results.get("zero", SX(0, 1)))):
        declare_jump(model, zero, values["x"], results[f"jump {i}"], f"event {i + 1}")
    quad = results.get("quad", SX(0, 1))
    begin = facts.start(Symbol("quad", quad.shape, quad), "x")
    for (entry, rate), start in zip(scalars("quad", quad), begin, strict=True):
        unit, meaning, more = facts.of(entry, "quad", f"integral {entry}")
        model.derivative(model.state(entry, unit, start, meaning, **more), rate)
    for key in system.outputs:
        for entry, expression in scalars(key, results[key]):
            unit, meaning, more = facts.of(entry, key, key)
            model.output(entry, unit, expression, meaning, **more)
    for entry in rules:
        state = values["x"][[*starts["x"]].index(entry)]
        model.start(state, results[f"start of {entry}"], f"start of {entry}")
    if consistent:
        results["I"] = results["I"][list(consistent.rows)]
        model.start_equation(values["x"][list(consistent.states)], results["I"], CONSTRAINTS)
    return values["x"], results


def declare_jump(model: Model, zero: SX, x: SX, new: SX, name: str) -> None:
    """Declare an event at which an expression falls below 0, with the states that it changes."""
    rows = zip(ca.vertsplit(x), ca.vertsplit(new), strict=True)
    model.when(zero < 0, {s: value for s, value in rows if not ca.is_equal(s, value)}, name=name)


def _declared(
    system: System, facts: Facts, starts: Mapping[str, Mapping[str, float]], model: Model
) -> dict[str, SX]:
    """Declare all variables; return the model's symbols."""
    declare: dict[str, Callable[..., SX]] = {
        "p": model.parameter,
        "x": model.state,
        "u": model.input,
        "z": model.algebraic,
    }
    values: dict[str, SX] = {"t": model.t}
    for kind, declaring in declare.items():
        rows = []
        for symbol in system.symbols[kind]:
            for entry in symbol.entries:
                one = symbol.name if len(symbol.entries) == 1 else f"{entry} of {symbol.name}"
                unit, meaning, more = facts.of(entry, symbol.name, one or entry)
                rows.append(declaring(entry, unit, starts[kind][entry], meaning, **more))
        values[kind] = ca.vertcat(SX(0, 1), *rows)
    return values


def _given_starts(who: str, system: System, facts: Facts, kind: str) -> dict[str, Any]:
    starts = {
        entry: start
        for symbol in system.symbols[kind]
        for entry, start in zip(symbol.entries, facts.start(symbol, kind), strict=True)
    }
    if kind != "x":
        for entry, start in starts.items():
            if not isinstance(start, float):
                raise ParameterError(f"{who}: the start of {entry} is {start}; give a number")
    return starts


def _consistent(
    who: str, system: System, facts: Facts, starts: Mapping[str, Mapping[str, float]]
) -> ConsistentStart:
    """Return a start that satisfies the invariants of an index reduction."""
    sizes = {kind: sum(len(s.entries) for s in system.symbols[kind]) for kind in SYMBOLS}
    values = {kind: SX.sym(kind, size) for kind, size in (sizes | {"t": 1}).items()}
    law = ca.densify(evaluated(who, system, values, {"I": system.laws["I"]})["I"])
    if ca.depends_on(law, values["z"]):
        raise UsageError(f"{who}: I depends on z; only time, x, u and p may stand there")
    u = ca.DM([*starts["u"].values()])
    law = ca.substitute(law, ca.vertcat(values["t"], values["u"]), ca.vertcat(0, u))
    results = [law, term_sizes(law)]
    constraints = ca.Function("I", [values["x"], values["p"]], results, ["x", "p"], ["I", "terms"])
    given = {
        [*starts["x"]].index(entry)
        for symbol in system.symbols["x"]
        for entry in symbol.entries
        if {entry, symbol.name} & {*facts.starts}
    }
    p = np.array([*starts["p"].values()], dtype=float)
    return _consistent_start(who, constraints, starts["x"], p, given)
