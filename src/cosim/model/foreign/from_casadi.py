"""From CasADi's symbols, expressions and functions to a `Dae`.

    x' = ode(t, x, z, u, p)     0 = alg(t, x, z, u, p)     q' = quad(t, x, z, u, p)

in the keys of CasADi's own `integrator`, in SX or MX.
"""

import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
from casadi import SX

from casadi_models.dae import Dae, Model
from cosim.errors import ParameterError, UsageError
from cosim.model.foreign.casadi_system import (
    SYMBOLS,
    System,
    evaluated,
    is_reduction,
    read_system,
    refuse_sizes,
    scalars,
)
from cosim.model.foreign.index_reduction import ConsistentStart, consistent_start
from cosim.model.foreign.named_symbols import Symbol
from cosim.model.foreign.variable_facts import Facts

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
    """Return the DAE of CasADi expressions, ready for both roads.

    A vector symbol `y` gives the variables `y_1` ... `y_n`, a matrix `A` gives `A_1_2` and so on;
    every mapping below takes the name of a variable, or that of its symbol for all its variables.

    Args:
        system: A mapping of `x`, `ode`, and where needed `t`, `z`, `u`, `p`, `alg`, `quad` to SX or
            MX (a list of symbols counts as their column); a `casadi.Function` from inputs to
            outputs of these names, other outputs being outputs; the path of a saved Function
            (.casadi); or what `casadi.dae_reduce_index` returns. A quadrature becomes a state.
        start_values: Numbers (for a vector: as many, or one for all) of states, inputs, parameters,
            first guesses of z; of states expressions of parameters, inputs and time, too. Where
            nothing is said, a Function's own `default_in`, or 0, except for parameters, which need
            a value.
        outputs: Expressions by name.
        name, description: Of the model.
        units, meanings, nominals: "1", the name, and 1 where nothing is said. A unit that is
            unknown here counts with factor 1, and the meaning says so.
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
    if not isinstance(outputs, Mapping | None):
        raise UsageError.of_type(f"{who}: outputs", outputs, "a dict of expressions by name")
    found = read_system(who, system, outputs or {})
    facts = Facts(who, start_values or {}, units or {}, meanings or {}, nominals or {})
    facts.refuse_strangers(found)
    facts = replace(facts, starts=found.starts | dict(facts.starts))
    try:
        model = Model(
            name,
            description=description or f"{name}, from CasADi expressions",
            source="casadi",
            stop_time=stop_time,
            output_interval=output_interval,
        )
        return _built(who, found, facts, model)
    except ValueError as error:
        raise UsageError(f"from_casadi: {error}") from error


def is_system(value: object) -> bool:
    """Tell whether `from_casadi` may take this, alone or with its start values as a pair."""
    if isinstance(value, tuple) and len(value) == 2:
        return is_system(value[0])
    if isinstance(value, str | os.PathLike):
        return os.fspath(value).endswith(".casadi")
    return isinstance(value, ca.Function) or (
        isinstance(value, Mapping) and not {"ode", "alg", "quad"}.isdisjoint(value)
    )


def from_user(value: Any, name: str) -> Dae:
    """Return the DAE of what a user's own function returned: a system with its options.

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


def _built(who: str, system: System, facts: Facts, model: Model) -> Dae:
    refuse_sizes(who, system)
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
    wanted = system.laws | system.outputs | {f"start of {n}": e for n, e in rules.items()}
    results = evaluated(who, system, values, wanted)
    model.derivative(values["x"], results.get("ode", SX(0, 1)))
    model.equation(results.get("alg", SX(0, 1)))
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
        held = results["I"][list(consistent.rows)]
        model.start_equation(values["x"][list(consistent.states)], held, CONSTRAINTS)
        model.invariant("constraint_drift", values["x"], held, CONSTRAINTS)
    return model.freeze()


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
                unit, meaning, more = facts.of(entry, symbol.name, _meaning(symbol, entry))
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
    constraints = ca.Function("I", [values["x"], values["p"]], [law], ["x", "p"], ["I"])
    names = [*starts["x"]]
    given = {
        names.index(entry)
        for symbol in system.symbols["x"]
        for entry in symbol.entries
        if {entry, symbol.name} & {*facts.starts}
    }
    x, p = (np.array([*starts[kind].values()], dtype=float) for kind in "xp")
    return consistent_start(who, constraints, x, p, names, given)


def _meaning(symbol: Symbol, entry: str) -> str:
    return symbol.name or entry if len(symbol.entries) == 1 else f"{entry} of {symbol.name}"
