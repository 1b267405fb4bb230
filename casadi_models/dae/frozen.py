"""`Dae`: a semi-explicit symbolic DAE that knows its variables."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from functools import cached_property
from math import inf, log
from typing import Any

import casadi as ca
from casadi import SX

from casadi_models.dae import packed, shown
from casadi_models.dae.balance import row_sizes
from casadi_models.dae.drawing import Drawing
from casadi_models.dae.events import Event
from casadi_models.dae.expressions import irregular_place, operation_count
from casadi_models.dae.invariants import CONSTRAINT_CONDITION, Closing, Invariant
from casadi_models.dae.starts import StartRule, StartThrough
from casadi_models.dae.variables import Experiment, ModeNames, Variable

_LAWS = (
    *("ode", "alg", "outputs", "start_rules", "start_outputs", "limits", "invariants"),
    *("closing", "monitors", "events", "smooth"),
)


@dataclass(frozen=True, eq=False)  # CasADi's == builds an expression
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
        x_start: Start value, or initial guess where a rule is implicit, of every state.
        report: What a reduction took away and why, a line each.
        limits: (scalar expression, meaning): the model holds only while each one is positive.
        invariants: What solvers let drift; a later one may move what an earlier one does not.
        closing: How drift decays; None where no equation sees to that.
        monitors: (variable, scalar expression) of how well conditioned the equations are; no
            outputs unless they are requested.
        drawing: What the system looks like; see `Model.shape`.
        start_outputs: Outputs by whose value starts of states may be given.
        events: What happens at an instant, besides the relations of the equations; see `Event`.
        smooth: Expressions whose relations are no events.
        driving: Outputs that drive other models, so that their relations are events.
        mode_names: What the modes of the linear system are called.
        derived: How many states, the first ones, are followed by their derivatives along a
            direction of the parameters.

    Raises:
        ValueError: Symbols, expressions and variables differ in number.

    Example:
        >>> import cosim
        >>> dae = cosim.load("bicycle")
        >>> [v.name for v in dae.inputs], dae.ode.shape
        (['steer_torque', 'roll_torque', 'rear_wheel_torque'], (11, 1))
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
    report: tuple[str, ...] = ()
    limits: tuple[tuple[SX, str], ...] = ()
    invariants: tuple[Invariant, ...] = ()
    closing: Closing | None = None
    monitors: tuple[tuple[Variable, SX], ...] = ()
    drawing: Drawing = field(default_factory=Drawing)
    start_outputs: tuple[StartThrough, ...] = ()
    events: tuple[Event, ...] = ()
    smooth: tuple[SX, ...] = ()
    driving: tuple[str, ...] = ()
    mode_names: tuple[ModeNames, ...] = ()
    derived: int = 0

    def __post_init__(self) -> None:
        for what, variables, columns in (
            ("states", self.states, (self.x, self.ode, SX(list(self.x_start)))),
            ("algebraics", self.algebraics, (self.z, self.alg)),
            ("inputs", self.inputs, (self.u,)),
            ("parameters", self.parameters, (self.p,)),
            ("output_variables", self.output_variables, (self.outputs,)),
        ):
            if any(rows.shape != (len(variables), 1) for rows in columns):
                raise ValueError(
                    f"{self.full_name}: {len(variables)} {what}, "
                    f"but columns of shape {', '.join(str(rows.shape) for rows in columns)}"
                )

    def __repr__(self) -> str:
        head = f"Dae {self.full_name}: {self.description}".rstrip(": ")
        lines = [head, *shown.lines(self._groups)]
        if self.report:
            lines.append(f"  reduced: {self.report[0]}" + (", ..." if len(self.report) > 1 else ""))
        stop, interval = self.experiment.stop_time, self.experiment.output_interval
        return "\n".join((*lines, f"  runs 0 ... {stop:g} s, every {interval:g} s"))

    def _repr_html_(self) -> str:
        return shown.table(f"{self.full_name}: {self.description}", self._groups)

    @property
    def _groups(self) -> shown.Groups:
        yield "states", self.states
        yield "algebraics", self.algebraics
        yield "inputs", self.inputs
        yield "parameters", self.parameters
        yield "outputs", self.output_variables

    def __reduce__(self) -> tuple[Any, ...]:
        return packed.unpacked, packed.packed(self)

    @cached_property
    def digest(self) -> str:
        """Hash of everything that a run depends on, which words about it and pictures are not."""
        bare = replace(
            self,
            description="",
            source="",
            report=(),
            drawing=Drawing(),
            parameters=tuple(replace(v, nominal=1.0) for v in self.parameters),  # of derivatives
        )
        return packed.digest(bare)

    @property
    def full_name(self) -> str:
        """`MODEL/FORMULATION`, as the command line takes it."""
        return f"{self.name}/{self.formulation}" if self.formulation else self.name

    @property
    def arguments(self) -> list[SX]:
        """`[t, x, z, u, p]`: the arguments of functions that are made of its expressions."""
        return [self.t, self.x, self.z, self.u, self.p]

    @cached_property
    def balanced(self) -> SX:
        """The residual of z, each row over the size of its coefficients, (nz, 1).

        The sizes are expressions of the parameters, and powers of 1024: rows of very different
        sizes, as those of forces beside lengths, cost a linear solution its digits, but others
        stay as they are, and two equal ones cancel exactly where the equations lose rank.
        """
        if not self.algebraics:
            return self.alg
        others = (*self.algebraics, *self.inputs)
        start = ca.DM([0.0, *self.x_start, *(variable.start or 0.0 for variable in others)])
        nominal = ca.DM([1.0, *(variable.nominal for variable in (*self.states, *others))])
        # beside the start, where a coefficient may vanish
        place = start + nominal * irregular_place(start.numel())
        slopes = ca.jacobian(self.alg, self.z)
        there = ca.substitute(slopes, ca.vertcat(self.t, self.x, self.z, self.u), SX(place))
        sizes = row_sizes(there, self.p, self.parameters)
        usual = [parameter.start or 0.0 for parameter in self.parameters]
        known = ca.Function("sizes", [self.p], [sizes])(usual)
        factors = 1024.0 ** -ca.floor(ca.log(ca.fmax(sizes, 1e-100)) / log(1024) + 0.5)
        return self.alg * ca.if_else(ca.logic_and(known > 0, known < inf), factors, 1)

    @property
    def margins(self) -> SX:
        """The margins of its limits, (n, 1): positive while these hold."""
        return ca.vertcat(SX(0, 1), *(margin for margin, _ in self.limits))

    @property
    def driving_outputs(self) -> SX:
        """The outputs that drive other models, (n, 1)."""
        pairs = zip(self.output_variables, ca.vertsplit(self.outputs), strict=True)
        return ca.vertcat(SX(0, 1), *(value for v, value in pairs if v.name in self.driving))

    @property
    def constraint_condition(self) -> SX | None:
        """Condition number of the constraints; None if the model does not declare it."""
        known = [*self.monitors]
        known += zip(self.output_variables, ca.vertsplit(self.outputs), strict=True)
        return next((value for v, value in known if v.name == CONSTRAINT_CONDITION), None)

    @property
    def distance_from_singularity(self) -> SX:
        """Reciprocal condition of the declared constraints: 1 at best, 0 if they are singular."""
        condition = self.constraint_condition
        assert condition is not None
        return 1 / condition

    @property
    def has_conditioned_multipliers(self) -> bool:
        """Whether multipliers enforce constraints whose condition number is declared."""
        return bool(self.algebraics) and self.constraint_condition is not None

    @property
    def casadi(self) -> dict[str, SX]:
        """What `casadi.integrator` takes: t, x, z, u, p, ode and alg by these names."""
        return {
            **dict(zip(("t", "x", "z", "u", "p"), self.arguments, strict=True)),
            "ode": self.ode,
            "alg": self.alg,
        }

    @property
    def variables(self) -> tuple[Variable, ...]:
        """All variables: states, algebraics, outputs, inputs, parameters."""
        return self.states + self.algebraics + self.output_variables + self.inputs + self.parameters

    @property
    def own_meanings(self) -> dict[str, str]:
        """Names that mean something else in other formulations of the system, and why."""
        return {v.name: v.own_meaning for v in self.variables if v.own_meaning}

    def watching(self, names: Collection[str]) -> "Dae":
        """Return the DAE with those of its monitors among the outputs that are named."""
        requested = [(v, expression) for v, expression in self.monitors if v.name in names]
        if not requested:
            return self
        return replace(
            self,
            outputs=ca.densify(ca.vertcat(self.outputs, *(e for _, e in requested))),
            output_variables=self.output_variables + tuple(v for v, _ in requested),
            observed=self.observed + tuple(v.name for v, _ in requested),
            monitors=tuple((v, e) for v, e in self.monitors if v.name not in names),
        )

    def rewritten(self, rewrite: Callable[[list[SX]], Sequence[SX]]) -> "Dae":
        """Return the DAE with its laws rewritten, all at once: what they share stays shared."""
        laws = tuple(getattr(self, name) for name in _LAWS)
        changed = packed.rewritten(laws, lambda every: list(map(ca.densify, rewrite(every))))
        return replace(self, **dict(zip(_LAWS, changed, strict=True)))

    def closing_at(self, rate: float) -> "Dae":
        """Return the DAE whose drift decays at another rate, 1/s; at 0 it grows.

        Raises:
            ValueError: No equation lets it decay, or the rate is negative or not finite.
        """
        if self.closing is None:
            raise ValueError(f"{self.full_name}: no equation makes drift decay")
        if not 0 <= rate < inf:
            raise ValueError(
                f"{self.full_name}: Baumgarte stabilization rate {rate} 1/s; give 0 or more"
            )
        alg = ca.substitute(self.closing.residual, self.closing.symbol, rate)
        return replace(self, alg=ca.densify(alg), closing=replace(self.closing, rate=rate))

    def variable(self, name: str) -> Variable:
        """Return the variable of that name; `KeyError` if there is none."""
        for candidate in self.variables:
            if candidate.name == name:
                return candidate
        near = get_close_matches(str(name), [known.name for known in self.variables], 1)
        hint = f"; did you mean {near[0]}?" if near else ""
        raise KeyError(f"{self.full_name} has no variable '{str(name)[:80]}'{hint}")

    def operations(self, *, with_outputs: bool = False) -> int:
        """Count the scalar operations of dx/dt and the residual, parameters being numbers.

        Args:
            with_outputs: Count the operations of the outputs, too.
        """
        values = ca.DM([variable.start or 0.0 for variable in self.parameters])
        columns = [self.ode, self.alg, *([self.outputs] if with_outputs else [])]
        equations = ca.substitute(ca.vertcat(*columns), self.p, SX(values))
        function = ca.Function("f", [self.t, self.x, self.z, self.u], [equations], {"cse": True})
        return operation_count(function)
