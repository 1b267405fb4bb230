"""`Model`: the builder of a `Dae`."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Unpack

import casadi as ca
from casadi import SX

from casadi_models.dae.arguments import refusing_arguments
from casadi_models.dae.events import Happening
from casadi_models.dae.expressions import (
    column,
    is_structurally_regular,
    quoted,
    reject_faulty,
    share,
)
from casadi_models.dae.frozen import Dae
from casadi_models.dae.invariants import Closing, Invariant
from casadi_models.dae.scenery import Scenery
from casadi_models.dae.starts import AT_A_START, Starting, reject_disorder
from casadi_models.dae.variables import Experiment, Facts, ModeNames, Start, Variable, number


@refusing_arguments
class Model(Starting, Happening, Scenery):
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
        super().__init__(name, formulation, {} if display is None else display)
        self._description, self._source = description, source
        with self._naming_the_model():
            self._experiment = Experiment(stop_time, output_interval, reference_tolerance)
        self._residuals: list[SX] = []
        self._inertias: list[tuple[str, SX]] = []
        self._limits: list[tuple[SX, str]] = []
        self._invariants: list[Invariant] = []
        self._rate: tuple[SX, float] | None = None
        self._mode_names: list[ModeNames] = []

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

    def discrete(
        self, name: str, unit: str, start: float, meaning: str, **facts: Unpack[Facts]
    ) -> SX:
        """Declare a variable that only events change: a state with derivative 0."""
        symbol = self.state(name, unit, start, meaning, **facts)
        self.derivative(symbol, 0)
        return symbol

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
        if isinstance(expression, str) and not isinstance(meaning, str):
            raise self._refusal(
                f"limit '{expression}': give the expression first, then its meaning: "
                f"limit(expression, '{expression}')"
            )
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

    def name_modes(
        self, state: SX, *, oscillating: Sequence[str] = (), real: Sequence[str] = ()
    ) -> None:
        """Name the modes in which a state takes part, for tables and figures of eigenvalues.

        Args:
            state: The state.
            oscillating: Names of the pairs of complex eigenvalues, the slowest oscillation first.
            real: Names of the real eigenvalues, the largest first.
        """
        (name,) = self._names(state)
        self._mode_names.append(ModeNames(name, tuple(oscillating), tuple(real)))

    def closing_rate(self, value: float) -> SX:
        """Return what stands in equations for the rate at which drift decays.

        Args:
            value: Double root of the decay, 1/s; 0 does nothing.
        """
        with self._naming_the_model():
            self._rate = SX.sym("closing_rate"), number(value, "closing_rate")
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
        unchanged = {symbol.element_hash() for symbol in ca.symvar(but)}
        symbols, values = [self.t], [0.0]
        for kind in "xup":
            for name, symbol in self._symbols[kind].items():
                if symbol.element_hash() not in unchanged:
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
            [(f"derivative of '{n}'", self._derivatives[n]) for n in self._symbols["x"]],
            [(f"equation {i}", residual) for i, residual in enumerate(equations, start=1)],
            [(f"output '{name}'", expression) for name, expression in self._outputs.items()],
            [(f"limit '{meaning}'", expression) for expression, meaning in self._limits],
            [(f"monitor '{name}'", expression) for name, expression in self._monitors.items()],
            [(f"condition of '{event.name}'", event.condition) for event in self._events],
            [(f"values of '{event.name}'", event.values) for event in self._events],
            [(f"smooth expression {i}", row) for i, row in enumerate(self._smooth, start=1)],
        )
        with self._naming_the_model():
            for part in parts:
                reject_faulty(part, ca.vertcat(self.t, x, z, u, p), "declared symbols")
            inertias = [(f"inertia of {body}", ca.vec(matrix)) for body, matrix in self._inertias]
            reject_faulty(inertias, p, "parameters")
            drifting = [
                (f"invariant '{i.meaning}'", ca.vertcat(i.residual, i.sizes))
                for i in self._invariants
            ]
            reject_faulty(drifting, ca.vertcat(self.t, x, u, p), AT_A_START)
            reject_disorder(self._rules, self.t, x, u, p)
            through = self._starts_through(x, p)
            drawing = self._drawing(ca.vertcat(self.t, x, z, u, p), p, self._variables)
        ode, alg, outputs, limits, monitors, conditions, values, smooth = share(
            [column(expression for _, expression in part) for part in parts]
        )
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
            events=tuple(self._shared_events(conditions, values)),
            smooth=(smooth,) if self._smooth else (),
            mode_names=tuple(self._mode_names),
        )
