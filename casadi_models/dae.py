"""`Dae`: a semi-explicit symbolic DAE that knows its variables; `Model`: the builder of one.

    x' = ode(t, x, z, u, p)      0 = alg(t, x, z, u, p)      outputs = y(t, x, z, u, p)

The symbols and expressions are plain CasADi `SX`; every variable carries unit, display unit,
meaning, start value, nominal value and bounds, which travel with it to XML, CSV and axis labels.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from math import inf, isfinite
from typing import Any

import casadi as ca
from casadi import SX

from casadi_models.units import UNITS

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_SPREAD = 1e12  # a positive parameter may differ from its default by this factor, not more


class Start(Enum):
    """How a start value comes about."""

    EXACT = "exact"  # given, and the user may change it
    CALCULATED = "calculated"  # follows from other starts and parameters
    GUESS = "guess"  # where the solution for an algebraic unknown begins


@dataclass(frozen=True)
class Variable:
    """What is known of a variable besides its equation; all numbers in `unit`."""

    name: str
    unit: str
    meaning: str
    start: float | None = None
    start_kind: Start = Start.EXACT
    display_unit: str | None = None
    nominal: float = 1.0
    minimum: float = -inf
    maximum: float = inf

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name) or self.name == "time":
            raise ValueError(f"'{self.name}' cannot name a variable: use letters, digits and _")
        for unit in (self.unit, self.display_unit):
            if unit is not None and unit not in UNITS:
                raise ValueError(
                    f"{self.name}: unit '{unit}' is unknown; known: {', '.join(UNITS)}"
                )
        if self.display_unit and dict(UNITS[self.display_unit].base) != dict(UNITS[self.unit].base):
            raise ValueError(f"{self.name}: '{self.display_unit}' cannot display '{self.unit}'")
        if not self.meaning:
            raise ValueError(f"{self.name}: the meaning is missing; describe it in a few words")
        if not (isfinite(self.nominal) and self.nominal > 0):
            raise ValueError(f"{self.name}: nominal {self.nominal} is not a positive number")
        if not self.minimum <= self.maximum:
            raise ValueError(f"{self.name}: bounds {self.minimum}..{self.maximum} are empty")
        if self.start is not None and not self.minimum <= self.start <= self.maximum:
            raise ValueError(
                f"{self.name}: start {self.start} is not within {self.minimum}..{self.maximum}"
            )


@dataclass(frozen=True)
class StartRule:
    """Start values of some states, from parameters and from starts settled before.

    Attributes:
        states: Positions in `Dae.x`.
        expression: The start values themselves, or the residual that they make zero.
        implicit: Whether `expression` is a residual, to be solved from the states' start guesses.
        meaning: The law, for messages.
    """

    states: tuple[int, ...]
    expression: SX
    implicit: bool
    meaning: str


@dataclass(frozen=True)
class Experiment:
    """The run that a model is shown with, s."""

    stop_time: float
    output_interval: float = 0.01


@dataclass(frozen=True)
class Dae:
    """An immutable symbolic DAE in SI units; build one with `Model`.

    Attributes:
        name: The system, e.g. "bicycle".
        formulation: Which equations describe it, e.g. "multipliers"; may be empty.
        description: One line for lists and documentation.
        source: Where the equations come from.
        experiment: Default span and output interval.
        t, x, z, u, p: Symbols: time, states, algebraic unknowns, inputs, parameters; columns.
        ode, alg, outputs: Expressions: dx/dt, residual of z, outputs; columns.
        states, algebraics, inputs, parameters, output_variables: One `Variable` per row.
        start_rules: How calculated start values follow, in the order of evaluation.
        inertias: (body, 3x3 expression of p) for every inertia that must be physical.
        observed: Names that a run records; states, algebraics and outputs when not reduced.
        x_start: Start value, or first guess where a rule is implicit, of every state.
    """

    name: str
    formulation: str
    description: str
    source: str
    experiment: Experiment
    t: SX
    x: SX
    z: SX
    u: SX
    p: SX
    ode: SX
    alg: SX
    outputs: SX
    states: tuple[Variable, ...]
    algebraics: tuple[Variable, ...]
    inputs: tuple[Variable, ...]
    parameters: tuple[Variable, ...]
    output_variables: tuple[Variable, ...]
    start_rules: tuple[StartRule, ...]
    inertias: tuple[tuple[str, SX], ...]
    observed: tuple[str, ...]
    x_start: tuple[float, ...]

    @property
    def full_name(self) -> str:
        """`MODEL/FORMULATION`, as the command line takes it."""
        return f"{self.name}/{self.formulation}" if self.formulation else self.name

    @property
    def variables(self) -> tuple[Variable, ...]:
        """All variables: states, algebraics, outputs, inputs, parameters."""
        return self.states + self.algebraics + self.output_variables + self.inputs + self.parameters

    def variable(self, name: str) -> Variable:
        """Return the variable of that name; `KeyError` when there is none."""
        for candidate in self.variables:
            if candidate.name == name:
                return candidate
        raise KeyError(name)

    def operations(self) -> int:
        """Count the scalar operations of dx/dt and the residual, parameters being numbers."""
        values = ca.DM([variable.start or 0.0 for variable in self.parameters])
        equations = ca.substitute(ca.vertcat(self.ode, self.alg), self.p, SX(values))
        function = ca.Function("f", [self.t, self.x, self.z, self.u], [equations], {"cse": True})
        moves = (ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST)
        codes = (function.instruction_id(i) for i in range(function.n_instructions()))
        return sum(code not in moves for code in codes)


class Model:
    """Builder of a `Dae`: declare, relate, freeze.

    Every declaring call returns the bare CasADi symbol, so that equations read as in the book.
    All refusals are `ValueError`s that name the model and the variable.

    Args:
        name: The system, a C identifier.
        formulation: Which equations describe it; empty for a system with only one.
        description: One line for lists; its meaning is the physical system.
        source: Book, unit and example, or a reference.
        display: Display unit by SI unit, for every variable that does not name its own.
    """

    def __init__(
        self,
        name: str,
        formulation: str = "",
        *,
        description: str = "",
        source: str = "",
        display: Mapping[str, str] | None = None,
        stop_time: float = 10.0,
        output_interval: float = 0.01,
    ) -> None:
        if not _NAME.fullmatch(name):
            raise ValueError(f"'{name}' cannot name a model: use letters, digits and _")
        self._name, self._formulation = name, formulation
        self._description, self._source = description, source
        self._display = dict(display or {})
        self._experiment = Experiment(stop_time, output_interval)
        self.t = SX.sym("time")
        self._variables: dict[str, Variable] = {}
        self._symbols: dict[str, dict[str, SX]] = {k: {} for k in ("x", "z", "u", "p", "y")}
        self._derivatives: dict[str, SX] = {}
        self._residuals: list[SX] = []
        self._rules: list[tuple[tuple[str, ...], SX, bool, str]] = []
        self._inertias: list[tuple[str, SX]] = []

    # -- declarations ---------------------------------------------------------------------------

    def state(self, name: str, unit: str, start: float, meaning: str, **facts: Any) -> SX:
        """Declare a state; `start` is exact unless a start rule makes it a first guess."""
        return self._declare("x", name, unit, start, meaning, facts)

    def algebraic(self, name: str, unit: str, guess: float, meaning: str, **facts: Any) -> SX:
        """Declare an unknown that an `equation` determines; `guess` is where its solution begins."""
        return self._declare("z", name, unit, guess, meaning, facts, Start.GUESS)

    def input(self, name: str, unit: str, start: float, meaning: str, **facts: Any) -> SX:
        """Declare an input; it keeps its start value where nobody drives it."""
        return self._declare("u", name, unit, start, meaning, facts)

    def parameter(
        self,
        name: str,
        unit: str,
        value: float,
        meaning: str,
        *,
        positive: bool = False,
        **facts: Any,
    ) -> SX:
        """Declare a parameter; `positive` bounds it to 1e-12 ... 1e12 times its default."""
        if positive:
            facts = {"minimum": value / _SPREAD, "maximum": value * _SPREAD} | facts
        facts.setdefault("nominal", abs(value) or 1.0)
        return self._declare("p", name, unit, value, meaning, facts)

    def output(self, name: str, unit: str, expression: Any, meaning: str, **facts: Any) -> None:
        """Declare an output of the model, given by an expression."""
        self._declare("y", name, unit, None, meaning, facts, Start.CALCULATED)
        self._symbols["y"][name] = self._scalar(name, expression)

    def energies(self, kinetic: Any, potential: Any, *, nominal: float = 1.0) -> None:
        """Declare `kinetic_energy`, `potential_energy` and their sum `energy`, J."""
        self.output("kinetic_energy", "J", kinetic, "kinetic energy", nominal=nominal)
        self.output("potential_energy", "J", potential, "potential energy", nominal=nominal)
        self.output("energy", "J", kinetic + potential, "total energy", nominal=nominal)

    # -- relations ------------------------------------------------------------------------------

    def derivative(self, state: SX, expression: Any) -> None:
        """Give a state (or a column of states) its time derivative."""
        for symbol, rate in zip(ca.vertsplit(state), ca.vertsplit(SX(expression)), strict=True):
            name = self._name_of("x", symbol)
            if name in self._derivatives:
                raise self._refusal(f"state '{name}' has two derivatives; give it one")
            self._derivatives[name] = rate

    def equation(self, residual: Any) -> None:
        """Add residuals that the algebraic unknowns make zero."""
        self._residuals += ca.vertsplit(SX(residual))

    def start(self, states: SX, expression: Any, meaning: str) -> None:
        """Calculate starts of states from parameters and other starts, explicitly."""
        self._start_rule(states, expression, implicit=False, meaning=meaning)

    def start_equation(self, states: SX, residual: Any, meaning: str) -> None:
        """Calculate starts of states as the root of a residual, from their start as a guess."""
        self._start_rule(states, residual, implicit=True, meaning=meaning)

    def inertia(self, body: str, matrix: Any) -> SX:
        """Note that a matrix of parameters must be the inertia of a real body; return it."""
        self._inertias.append((body, SX(matrix)))
        return SX(matrix)

    # -- the result -----------------------------------------------------------------------------

    def freeze(self) -> Dae:
        """Check that the declarations are complete and consistent; return the `Dae`."""
        symbols = {kind: ca.vertcat(*named.values()) for kind, named in self._symbols.items()}
        columns = {kind: ca.reshape(SX(column), -1, 1) for kind, column in symbols.items()}
        missing = [name for name in self._symbols["x"] if name not in self._derivatives]
        if missing:
            raise self._refusal(f"no derivative for state {_quoted(missing)}; call derivative()")
        unknowns = len(self._symbols["z"])
        if len(self._residuals) != unknowns:
            raise self._refusal(
                f"{len(self._residuals)} equations for {unknowns} algebraic unknowns; "
                "give each unknown one equation"
            )
        ode = _column([self._derivatives[name] for name in self._symbols["x"]])
        alg = _column(self._residuals)
        known = [self.t, columns["x"], columns["z"], columns["u"], columns["p"]]
        for what, expression in (
            ("derivatives", ode),
            ("equations", alg),
            ("outputs", columns["y"]),
        ):
            self._refuse_undeclared(what, expression, known)
        if unknowns and not _structurally_regular(alg, columns["z"]):
            raise self._refusal(
                "the algebraic equations do not determine every algebraic unknown (index above 1); "
                "differentiate the constraints until they hold the unknowns"
            )
        rules = self._frozen_rules(columns["x"], columns["p"])
        ode, alg, outputs = _share(ode, alg, columns["y"])
        calculated = {i for rule in rules for i in rule.states}
        states = tuple(
            replace(v, start_kind=Start.CALCULATED, start=None) if i in calculated else v
            for i, v in enumerate(self._of("x"))
        )
        return Dae(
            name=self._name,
            formulation=self._formulation,
            description=self._description,
            source=self._source,
            experiment=self._experiment,
            t=self.t,
            x=columns["x"],
            z=columns["z"],
            u=columns["u"],
            p=columns["p"],
            ode=ode,
            alg=alg,
            outputs=outputs,
            states=states,
            algebraics=self._of("z"),
            inputs=self._of("u"),
            parameters=self._of("p"),
            output_variables=self._of("y"),
            start_rules=rules,
            inertias=tuple(self._inertias),
            observed=tuple(v.name for kind in "xzy" for v in self._of(kind)),
            x_start=tuple(float(v.start or 0.0) for v in self._of("x")),
        )

    # -- details --------------------------------------------------------------------------------

    def _declare(
        self,
        kind: str,
        name: str,
        unit: str,
        start: float | None,
        meaning: str,
        facts: Mapping[str, Any],
        start_kind: Start = Start.EXACT,
    ) -> SX:
        if name in self._variables:
            raise self._refusal(f"'{name}' is declared twice; choose another name")
        if start is not None and not isfinite(start):
            raise self._refusal(f"'{name}' starts at {start}; give a finite number")
        details = {"display_unit": self._display.get(unit)} | dict(facts)
        try:
            variable = Variable(name, unit, meaning, start, start_kind, **details)
        except (TypeError, ValueError) as error:
            raise self._refusal(str(error)) from error
        self._variables[name] = variable
        self._symbols[kind][name] = SX.sym(name)
        return self._symbols[kind][name]

    def _of(self, kind: str) -> tuple[Variable, ...]:
        return tuple(self._variables[name] for name in self._symbols[kind])

    def _name_of(self, kind: str, symbol: SX) -> str:
        for name, known in self._symbols[kind].items():
            if ca.is_equal(known, symbol):
                return name
        raise self._refusal(f"'{symbol}' is not a state of this model; declare it with state()")

    def _scalar(self, name: str, expression: Any) -> SX:
        value = SX(expression)
        if value.shape != (1, 1):
            raise self._refusal(f"output '{name}' has shape {value.shape}; outputs are scalars")
        return ca.densify(value)

    def _start_rule(self, states: SX, expression: Any, *, implicit: bool, meaning: str) -> None:
        names = tuple(self._name_of("x", symbol) for symbol in ca.vertsplit(states))
        column = ca.densify(SX(expression))
        if column.shape != (len(names), 1):
            raise self._refusal(
                f"{len(names)} starts ({meaning}) but {column.shape[0]} expressions"
            )
        self._rules.append((names, column, implicit, meaning))

    def _frozen_rules(self, x: SX, p: SX) -> tuple[StartRule, ...]:
        order = list(self._symbols["x"])
        settled = {name for name in order if not any(name in rule[0] for rule in self._rules)}
        frozen = []
        for names, expression, implicit, meaning in self._rules:
            self._refuse_undeclared(f"start ({meaning})", expression, [x, p])
            own = set(names) if implicit else set()
            for i, name in enumerate(order):
                if name not in settled | own and ca.depends_on(expression, x[i]):
                    raise self._refusal(
                        f"start ({meaning}) needs '{name}', which is not settled yet"
                    )
            if settled & set(names):
                raise self._refusal(f"start of {_quoted(sorted(settled & set(names)))} given twice")
            settled |= set(names)
            frozen.append(StartRule(tuple(map(order.index, names)), expression, implicit, meaning))
        return tuple(frozen)

    def _refuse_undeclared(self, what: str, expression: SX, known: Sequence[SX]) -> None:
        allowed = {symbol.__hash__() for symbol in ca.symvar(ca.vertcat(*known))}
        stray = [str(s) for s in ca.symvar(expression) if s.__hash__() not in allowed]
        if stray:
            raise self._refusal(
                f"{what} use {_quoted(stray)}, declared nowhere; declare or replace"
            )

    def _refusal(self, reason: str) -> ValueError:
        return ValueError(f"{self._name}: {reason}")


def _quoted(names: Sequence[str]) -> str:
    return ", ".join(f"'{name}'" for name in names)


def _column(expressions: Sequence[SX]) -> SX:
    return ca.densify(ca.reshape(ca.vertcat(SX(0, 1), *expressions), -1, 1))


def _structurally_regular(residual: SX, unknowns: SX) -> bool:
    jacobian = ca.jacobian_sparsity(residual, unknowns)
    return bool(ca.sprank(ca.DM.ones(jacobian)) == unknowns.numel())


def _share(*columns: SX) -> list[SX]:
    """Let all columns share their common subexpressions."""
    return [_column(ca.vertsplit(column)) for column in ca.cse(list(columns))]
