"""`Model`: the builder of a `Dae`."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, Unpack

import casadi as ca
from casadi import SX

from casadi_models.dae import shown
from casadi_models.dae.expressions import (
    column,
    is_structurally_regular,
    quoted,
    refuse_faulty,
    share,
)
from casadi_models.dae.frozen import Dae
from casadi_models.dae.invariants import Closing, Invariant
from casadi_models.dae.scenery import Scenery
from casadi_models.dae.starts import AT_A_START, Starting, refuse_disorder
from casadi_models.dae.variables import Experiment, Facts, Start, Variable, is_name, number
from casadi_models.units import convert

_SPREAD = 1e12  # a positive parameter may differ from its default by this factor, not more


class Model(Starting, Scenery):
    """Builder of a `Dae`: declare, relate, freeze.

    Every declaring call returns the bare CasADi symbol, so that equations read as in the book.
    All refusals are `ValueError`s that name the model and the variable.

    Args:
        name: The system, a C identifier.
        formulation: Which equations describe it; empty for a system with only one.
        description: One line for lists; its meaning is the physical system.
        source: Book, unit and example, or a reference.
        display: Display unit by SI unit, for every variable that does not name its own.
        stop_time: End of the run that the model is shown with, s.
        output_interval: Distance of its output times, s.
        reference_tolerance: See `Experiment`.

    Example:
        >>> model = Model("decay", description="a decay")
        >>> x = model.state("x", "1", 1.0, "what is left")
        >>> model.derivative(x, -x)
        >>> model.freeze().full_name
        'decay'
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
        reference_tolerance: float = 1e-10,
    ) -> None:
        super().__init__()
        for part in (name, formulation or name):
            if not is_name(part):
                raise ValueError(f"{part!r} cannot name a model: use letters, digits and _")
        self._name, self._formulation = name, formulation
        self._description, self._source = description, source
        self._display = dict(display or {})
        with self._naming_the_model():
            self._experiment = Experiment(stop_time, output_interval, reference_tolerance)
            for unit, wanted in self._display.items():
                convert(1.0, unit, wanted)
        self.t = SX.sym("time")
        self._variables: dict[str, Variable] = {}
        self._symbols: dict[str, dict[str, SX]] = {kind: {} for kind in "xzup"}
        self._outputs: dict[str, SX] = {}
        self._monitors: dict[str, SX] = {}
        self._derivatives: dict[str, SX] = {}
        self._residuals: list[SX] = []
        self._inertias: list[tuple[str, SX]] = []
        self._limits: list[tuple[SX, str]] = []
        self._invariants: list[Invariant] = []
        self._rate: tuple[SX, float] | None = None

    def __repr__(self) -> str:
        told = ", ".join(f"{len(own)} {kind}" for kind, own in self._groups() if own)
        return f"Model {self._full_name}: {told or 'nothing declared'}; freeze() makes a Dae of it"

    def _repr_html_(self) -> str:
        return shown.table(repr(self), self._groups())

    @property
    def _full_name(self) -> str:
        return f"{self._name}/{self._formulation}" if self._formulation else self._name

    def _groups(self) -> Iterator[tuple[str, list[Variable]]]:
        names = ("states", "algebraics", "inputs", "parameters")
        for kind, name in zip("xzup", names, strict=True):
            yield name, [self._variables[own] for own in self._symbols[kind]]

    # -- declarations ---------------------------------------------------------------------------

    def state(self, name: str, unit: str, start: float, meaning: str, **facts: Unpack[Facts]) -> SX:
        """Declare a state; `start` is exact unless a start rule makes it a first guess."""
        return self._declare("x", self._variable(name, unit, meaning, facts, start))

    def algebraic(
        self, name: str, unit: str, guess: float, meaning: str, **facts: Unpack[Facts]
    ) -> SX:
        """Declare an unknown that an `equation` determines, solved for from `guess`."""
        return self._declare("z", self._variable(name, unit, meaning, facts, guess, Start.GUESS))

    def input(self, name: str, unit: str, start: float, meaning: str, **facts: Unpack[Facts]) -> SX:
        """Declare an input; it keeps its start value where nobody drives it."""
        return self._declare("u", self._variable(name, unit, meaning, facts, start))

    def parameter(
        self,
        name: str,
        unit: str,
        value: float,
        meaning: str,
        *,
        positive: bool = False,
        **facts: Unpack[Facts],
    ) -> SX:
        """Declare a parameter; `positive` bounds it to 1e-12 ... 1e12 times its default."""
        with self._naming_the_model():
            size = abs(number(value, f"{name}: value"))
        facts.setdefault("nominal", size or 1.0)
        if positive:
            if not value > 0:
                raise self._refusal(f"{name}: value {value} is not positive, as declared")
            facts.setdefault("minimum", value / _SPREAD)
            facts.setdefault("maximum", value * _SPREAD)
        return self._declare("p", self._variable(name, unit, meaning, facts, value))

    def output(
        self, name: str, unit: str, expression: Any, meaning: str, **facts: Unpack[Facts]
    ) -> None:
        """Declare an output of the model, given by a scalar expression."""
        variable = self._variable(name, unit, meaning, facts, None, Start.CALCULATED)
        self._outputs[name] = self._column(f"output '{name}'", expression, 1)
        self._variables[name] = variable

    def monitor(self, name: str, expression: Any, meaning: str) -> None:
        """Declare a number that tells how well conditioned the equations are (1).

        It costs nothing until it is named as an output; see `Dae.watching`.
        """
        facts: Facts = {"own_meaning": "it describes the equations, which differ"}
        variable = self._variable(name, "1", meaning, facts, None, Start.CALCULATED)
        self._monitors[name] = self._column(f"monitor '{name}'", expression, 1)
        self._variables[name] = variable

    def energies(self, kinetic: Any, potential: Any, *, nominal: float = 1.0) -> None:
        """Declare `kinetic_energy`, `potential_energy` and their sum `energy`, J."""
        self.output("kinetic_energy", "J", kinetic, "kinetic energy", nominal=nominal)
        self.output("potential_energy", "J", potential, "potential energy", nominal=nominal)
        self.output("energy", "J", kinetic + potential, "total energy", nominal=nominal)

    # -- relations ------------------------------------------------------------------------------

    def derivative(self, states: SX, expression: Any) -> None:
        """Give a state (or a column of states) its time derivative."""
        names = self._names(states)
        what = f"derivative of {quoted(names)}"
        rates = ca.vertsplit(self._column(what, expression, len(names)))
        for name, rate in zip(names, rates, strict=True):
            if name in self._derivatives:
                raise self._refusal(f"state '{name}' has two derivatives; give it one")
            self._derivatives[name] = rate

    def equation(self, residual: Any) -> None:
        """Add residuals that the algebraic unknowns make zero."""
        self._residuals += ca.vertsplit(self._column("equation", residual))

    def inertia(self, body: str, matrix: Any) -> SX:
        """Note that a matrix of parameters must be the inertia of a real body; return it."""
        tensor = self._expression(f"inertia of {body}", matrix)
        if tensor.shape != (3, 3):
            raise self._refusal(f"inertia of {body} has shape {tensor.shape}; give a 3x3 matrix")
        self._inertias.append((body, tensor))
        return tensor

    def limit(self, expression: Any, meaning: str) -> None:
        """Note that the model holds only while a scalar expression is positive.

        Args:
            expression: Scalar, of any declared symbols.
            meaning: What is true while it is positive, e.g. "the rear wheel keeps the ground".
        """
        if not (isinstance(meaning, str) and meaning.strip()):
            raise self._refusal("the meaning of a limit is missing; describe it in a few words")
        if meaning in (known for _, known in self._limits):
            raise self._refusal(f"limit '{meaning}' is declared twice; keep one")
        self._limits.append((self._column(f"limit '{meaning}'", expression, 1), meaning))

    def invariant(
        self, name: str, states: SX, residual: Any, meaning: str, *, sizes: Any = None
    ) -> None:
        """Note residuals that are zero in every exact solution and drift in a numerical one.

        Args:
            name: Of the monitor that shows the largest of them, in SI units.
            states: What a projection moves to make them zero again; positions before speeds.
            residual: Of time, states, inputs and parameters; no more rows than `states`.
            meaning: What is true while they are zero.
            sizes: What counts as an equally large move of each state; its nominal value when None.
        """
        rows, names = self._column(f"invariant '{meaning}'", residual), self._names(states)
        order = list(self._symbols["x"])
        positions = tuple(map(order.index, names))
        if sizes is None:
            sizes = [self._variables[state].nominal for state in names]
        weights = self._column(f"sizes of '{meaning}'", sizes, len(names))
        if not 0 < rows.numel() <= len(positions):
            raise self._refusal(
                f"invariant '{meaning}' has {rows.numel()} rows for {len(positions)} states; "
                "name at least as many states as rows"
            )
        self.monitor(name, ca.norm_inf(rows), f"largest drift (SI units) from: {meaning}")
        self._invariants.append(Invariant(positions, rows, weights, meaning))

    def closing_rate(self, value: float) -> SX:
        """Return what stands in equations for the rate at which drift decays.

        Args:
            value: Double root of the decay, 1/s; 0 does nothing.
        """
        self._rate = SX.sym("closing_rate"), float(value)
        return self._rate[0]

    # -- what has been declared ------------------------------------------------------------------

    def declared(self, symbols: SX) -> tuple[Variable, ...]:
        """Return what was declared of states, one for each row of a column."""
        return tuple(self._variables[name] for name in self._names(symbols))

    @property
    def constants(self) -> SX:
        """Symbols of the parameters declared so far, (n, 1)."""
        return column(self._symbols["p"].values())

    def numbers(self, expression: SX, *, but: SX) -> SX:
        """Replace every parameter, input and state but some by its start value; time by 0."""
        kept = {symbol.element_hash() for symbol in ca.symvar(but)}
        symbols, values = [self.t], [0.0]
        for kind in "xup":
            for name, symbol in self._symbols[kind].items():
                if symbol.element_hash() not in kept:
                    symbols.append(symbol)
                    values.append(self._variables[name].start or 0.0)
        return ca.substitute(expression, ca.vertcat(*symbols), SX(values))

    # -- the result -----------------------------------------------------------------------------

    def freeze(self) -> Dae:
        """Check that the declarations are complete and consistent; return the `Dae`."""
        x, z, u, p = (column(self._symbols[kind].values()) for kind in "xzup")
        missing = [name for name in self._symbols["x"] if name not in self._derivatives]
        if missing:
            raise self._refusal(f"no derivative for state {quoted(missing)}; call derivative()")
        if len(self._residuals) != z.numel():
            raise self._refusal(
                f"{len(self._residuals)} equations for {z.numel()} algebraic unknowns; "
                "give each unknown one equation"
            )
        equations, closing = self._residuals, None
        if self._rate is not None:
            symbol, rate = self._rate
            closing = Closing(rate, symbol, column(self._residuals))
            equations = ca.vertsplit(ca.substitute(closing.residual, symbol, rate))
        parts = (
            {f"derivative of '{n}'": self._derivatives[n] for n in self._symbols["x"]},
            {f"equation {i}": residual for i, residual in enumerate(equations, start=1)},
            {f"output '{name}'": expression for name, expression in self._outputs.items()},
            {f"limit '{meaning}'": expression for expression, meaning in self._limits},
            {f"monitor '{name}'": expression for name, expression in self._monitors.items()},
        )
        with self._naming_the_model():
            for part in parts:
                refuse_faulty(part, ca.vertcat(self.t, x, z, u, p), "declared symbols")
            inertias = {f"inertia of {body}": ca.vec(matrix) for body, matrix in self._inertias}
            refuse_faulty(inertias, p, "parameters")
            drifting = {
                f"invariant '{i.meaning}'": ca.vertcat(i.residual, i.sizes)
                for i in self._invariants
            }
            refuse_faulty(drifting, ca.vertcat(self.t, x, u, p), AT_A_START)
            refuse_disorder(self._rules, self.t, x, u, p)
            through = self._starts_through(x, p)
            drawing = self._drawing(ca.vertcat(self.t, x, z, u, p), p, self._variables)
        ode, alg, outputs, limits, monitors = share([column(part.values()) for part in parts])
        if not is_structurally_regular(alg, z):
            raise self._refusal(
                "the algebraic equations do not determine every algebraic unknown (index above 1); "
                "differentiate the constraints until they hold the unknowns, as "
                "casadi.dae_reduce_index does"
            )
        calculated = {i for rule in self._rules for i in rule.states}
        return Dae(
            name=self._name,
            formulation=self._formulation,
            description=self._description,
            source=self._source,
            experiment=self._experiment,
            t=self.t,
            x=x,
            z=z,
            u=u,
            p=p,
            ode=ode,
            alg=alg,
            outputs=outputs,
            states=tuple(
                replace(v, start_kind=Start.CALCULATED, start=None) if i in calculated else v
                for i, v in enumerate(self._of("x"))
            ),
            algebraics=self._of("z"),
            inputs=self._of("u"),
            parameters=self._of("p"),
            output_variables=tuple(self._variables[name] for name in self._outputs),
            start_rules=tuple(self._rules),
            start_outputs=through,
            inertias=tuple(self._inertias),
            observed=(*self._symbols["x"], *self._symbols["z"], *self._outputs),
            x_start=tuple(v.start for v in self._of("x") if v.start is not None),
            limits=tuple((limits[i], meaning) for i, (_, meaning) in enumerate(self._limits)),
            invariants=tuple(self._invariants),
            closing=closing,
            monitors=tuple(
                (self._variables[name], monitors[i]) for i, name in enumerate(self._monitors)
            ),
            drawing=drawing,
        )

    # -- details --------------------------------------------------------------------------------

    def _variable(
        self,
        name: str,
        unit: str,
        meaning: str,
        facts: Facts,
        start: float | None,
        start_kind: Start = Start.EXACT,
    ) -> Variable:
        unknown = facts.keys() - Facts.__annotations__
        if unknown:
            raise self._refusal(
                f"{name}: {quoted(sorted(unknown))} is no fact of a variable; "
                f"there are {', '.join(Facts.__annotations__)}"
            )
        if isinstance(unit, str) and unit in self._display:
            facts.setdefault("display_unit", self._display[unit])
        with self._naming_the_model():
            variable = Variable(name, unit, meaning, start, start_kind, **facts)
        if name in self._variables:
            raise self._refusal(f"'{name}' is declared twice; choose another name")
        return variable

    def _declare(self, kind: str, variable: Variable) -> SX:
        symbol = SX.sym(variable.name)
        self._variables[variable.name] = variable
        self._symbols[kind][variable.name] = symbol
        return SX(symbol)  # a copy, for a user who writes into it

    def _of(self, kind: str) -> tuple[Variable, ...]:
        return tuple(self._variables[name] for name in self._symbols[kind])

    def _names(self, states: SX) -> tuple[str, ...]:
        known = {symbol.element_hash(): name for name, symbol in self._symbols["x"].items()}
        rows = ca.vertsplit(self._column("column of states", states))
        for row in rows:
            if row.element_hash() not in known:
                raise self._refusal(
                    f"'{row}' is not a state of this model; declare it with state()"
                )
        return tuple(known[row.element_hash()] for row in rows)

    def _expression(self, what: str, expression: Any) -> SX:
        try:
            return ca.densify(SX(expression))
        except NotImplementedError:  # CasADi: wrong type of argument
            raise self._refusal(f"{what} is {expression!r}; give an SX expression") from None

    def _column(self, what: str, expression: Any, rows: int | None = None) -> SX:
        value = self._expression(what, expression)
        if value.shape != (value.shape[0] if rows is None else rows, 1):
            wanted = f"({'n' if rows is None else rows}, 1)"
            raise self._refusal(f"{what} has shape {value.shape}; give shape {wanted}")
        return value

    @contextmanager
    def _naming_the_model(self) -> Iterator[None]:
        try:
            yield
        except ValueError as error:
            raise self._refusal(str(error)) from error

    def _display_of(self, unit: str) -> str:
        return self._display.get(unit, unit)

    def _refusal(self, reason: str) -> ValueError:
        return ValueError(f"{self._full_name}: {reason}")
