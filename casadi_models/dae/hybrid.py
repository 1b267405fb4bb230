"""`Hybrid`: a DAE whose relations are frozen at modes, so that solvers see smooth equations.

Every relation of the equations (a comparison, `sign`, `fabs`, `fmin`, `floor`, ...) has an argument
and a mode. The mode of a sign is 1 or -1, that of a floor an integer. Between events the modes are
constant inputs of the frozen equations; where an argument leaves the range of its mode is an event.

Source  Cellier & Kofman, Continuous System Simulation, Springer 2006, chapter 9; sliding: Filippov,
        Differential Equations with Discontinuous Righthand Sides, Kluwer 1988.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
from casadi import MX, SX

from casadi_models.dae.blending import affine_in_modes
from casadi_models.dae.events import Event
from casadi_models.dae.expressions import RELATIONS, as_text, column, implicit_change, operations
from casadi_models.dae.frozen import Dae
from casadi_models.dae.relations import KEEPS, LawsWithModes, Relation, mode_inputs, term_sizes
from casadi_models.dae.time_bounds import Enclosures, TimeBounds, enclosures, time_bounds
from casadi_models.dae.variables import Variable


@dataclass(frozen=True, eq=False)
class Hybrid:
    """Frozen equations with their events.

    Attributes:
        dae: The frozen model. Its inputs are those of the model and, after them, the modes.
        relations: One per mode.
        events: Events, with conditions in modes.
        of_time: For each relation, whether its argument depends on time and parameters alone.
        sliding: Positions of the relations whose modes follow from their arguments staying 0.
        solved: The modes of these, (n, 1), as expressions.
        encloses_lines: Whether arguments that are linear have bounds, too.
    """

    dae: Dae
    relations: tuple[Relation, ...]
    events: tuple[Event, ...]
    of_time: tuple[bool, ...]
    sliding: tuple[int, ...] = ()
    solved: SX = SX(0, 1)  # noqa: RUF009  # an empty column, which nothing changes
    encloses_lines: bool = False

    @property
    def modes(self) -> SX:
        """Symbols of the modes, (n, 1)."""
        return column(ca.vertsplit(self.dae.u)[self.dae.u.numel() - len(self.relations) :])

    @cached_property
    def floors(self) -> tuple[bool, ...]:
        """For each relation, whether its mode is a floor."""
        return tuple(relation.floor for relation in self.relations)

    @cached_property
    def arguments(self) -> SX:
        """Arguments of the relations, (n, 1)."""
        return column(r.argument for r in self.relations)

    @cached_property
    def in_laws(self) -> tuple[bool, ...]:
        """For each relation, whether dx/dt, an algebraic equation or another model feels it."""
        laws = ca.vertcat(self.dae.ode, self.dae.alg, self.dae.driving_outputs)
        return tuple(ca.depends_on(laws, mode) for mode in ca.vertsplit(self.modes))

    @cached_property
    def of_input(self) -> tuple[bool, ...]:
        """For each relation, whether its argument depends on inputs or algebraic unknowns."""
        inputs = ca.vertsplit(self.dae.u)[: self.dae.u.numel() - len(self.relations)]
        given = ca.vertcat(self.dae.z, *inputs)
        return tuple(ca.depends_on(relation.argument, given) for relation in self.relations)

    def movers(self, relation: int) -> list[int]:
        """Return the positions of inputs that may move its argument; unknowns may be of all."""
        argument, inputs = self.relations[relation].argument, ca.vertsplit(self.dae.u)
        every = ca.depends_on(argument, self.dae.z)
        known = inputs[: len(inputs) - len(self.relations)]
        return [i for i, one in enumerate(known) if every or ca.depends_on(argument, one)]

    @cached_property
    def resting(self) -> tuple[int, ...]:
        """Positions of the relations that rest where inputs do: nothing else moves them."""
        constant = self.constant
        moving = [x for i, x in enumerate(ca.vertsplit(self.dae.x)) if i not in constant]
        others = ca.vertcat(self.dae.t, self.dae.z, *moving)
        every = enumerate(zip(self.relations, self.of_input, strict=True))
        return tuple(
            i for i, (r, driven) in every if driven and not ca.depends_on(r.argument, others)
        )

    @cached_property
    def resting_on(self) -> tuple[list[bool], list[bool]]:
        """Which states, and which inputs with modes, the arguments of those depend on."""
        arguments = ca.vertcat(SX(0, 1), *(self.relations[i].argument for i in self.resting))
        x, u = (ca.which_depends(arguments, symbols) for symbols in (self.dae.x, self.dae.u))
        return x, u

    @cached_property
    def paths(self) -> frozenset[str]:
        """Inputs along which states may slide: arguments of signs depend on both."""
        arguments = [r.argument for r in self.relations if not r.floor]
        mixed = ca.vertcat(SX(0, 1), *(a for a in arguments if ca.depends_on(a, self.dae.x)))
        pairs = zip(self.dae.inputs, ca.vertsplit(self.dae.u), strict=True)
        return frozenset(v.name for v, symbol in pairs if ca.depends_on(mixed, symbol))

    @cached_property
    def linear(self) -> tuple[bool, ...]:
        """For each relation, whether its argument depends on time alone, and linearly."""
        t, arguments = self.dae.t, ca.vertsplit(self.arguments)
        return tuple(
            alone
            and not ca.depends_on(ca.jacobian(argument, t), t)
            and ca.OP_ATAN2 not in operations(argument)  # it jumps where its derivative does not
            for alone, argument in zip(self.of_time, arguments, strict=True)
        )

    @cached_property
    def time_bounds(self) -> TimeBounds:
        """Bounds of the arguments that depend on time alone, and not linearly."""
        kinds = enumerate(zip(self.of_time, self.linear, strict=True))
        bent = [i for i, (alone, linear) in kinds if alone and not linear]
        return time_bounds(self.dae, {i: self.relations[i].argument for i in bent})

    @cached_property
    def enclosures(self) -> Enclosures:
        """Bounds of the other arguments over a part of a step.

        Unless `encloses_lines`, linear ones are left out: they move as steadily as the states.
        """
        moving = ca.vertcat(self.dae.t, self.dae.x, self.dae.u)
        bent = ca.which_depends(self.arguments, moving, 2, True) if self.relations else []
        chosen = [i for i in self.of_states if bent[i] or self.encloses_lines]
        arguments = {i: self.relations[i].argument for i in chosen}
        return enclosures(self.dae, arguments, len(self.relations))

    @cached_property
    def constant(self) -> list[int]:
        """Positions of the states that only events change."""
        return [i for i, rate in enumerate(ca.vertsplit(self.dae.ode)) if rate.is_zero()]

    @property
    def rules(self) -> tuple[SX, SX]:
        """Conditions of all events, and all values that they assign; columns."""
        conditions = column(event.condition for event in self.events)
        return conditions, column(event.values for event in self.events)

    def rounding(self, name: str) -> ca.Function:
        """Return a function of t, x, z, u, p and sizes of x: how far relative rounding moves.

        Its results are the change of each argument, to first order, if all that it depends on
        changes by its size; the same with states as small as they are; and sizes of the arguments'
        time derivatives, beside which one may be but rounding.
        """
        dae, sizes = self.dae, SX.sym("sizes", self.dae.x.numel())
        given, small = ca.vertcat(dae.t, dae.x, dae.z, dae.u), ca.fabs(dae.x) / 8
        slopes = ca.fabs(ca.jacobian(self.arguments, given))
        moved = [
            ca.densify(slopes @ ca.fabs(ca.vertcat(dae.t, x, dae.z, dae.u)))
            for x in (ca.fmax(sizes, small), small)
        ]
        rates = self.rate_sizes + self._rate_terms()
        return ca.Function(name, [*dae.arguments, sizes], [*moved, rates], {"cse": True})

    @cached_property
    def rate_sizes(self) -> SX:
        """Sizes of the arguments' time derivatives, (n, 1), beside which one may be but rounding.

        Each quantity changes by its nominal value per second, states also by their rates. They are
        0 for relations of time alone, which are exact.
        """
        dae = self.dae
        fast = (ca.fabs(dae.ode) + [v.nominal for v in dae.states]) if dae.states else dae.ode
        rates = ca.vertcat(1, fast, [v.nominal for v in dae.algebraics])
        given = ca.vertcat(dae.t, dae.x, dae.z)
        sizes = ca.fabs(ca.jacobian(self.arguments, given)) @ rates
        rows = (sizes[i] * (not alone) for i, alone in enumerate(self.of_time))
        return column(rows)

    def _rate_terms(self) -> SX:
        """Return sizes of the terms that make the arguments' time derivatives, (n, 1).

        Terms may cancel, as forces do at rest. Unknowns change by their nominal values per second.
        """
        dae, unknown = self.dae, SX.sym("dz", self.dae.z.numel())
        terms = term_sizes(self.rates(self.arguments, unknown, SX(dae.u.numel(), 1)))
        return ca.densify(ca.substitute(terms, unknown, SX([v.nominal for v in dae.algebraics])))

    def with_conditions(self) -> Dae:
        """Return the frozen equations, with the arguments of the relations as limits."""
        arguments = ((relation.argument, relation.operation) for relation in self.relations)
        return replace(self.dae, limits=(*self.dae.limits, *arguments))

    def watching_more(self, arguments: SX, operation: str) -> "Hybrid":
        """Return the equations with further relations, on which no law depends.

        Args:
            arguments: Expressions of the frozen equations' symbols, (n, 1).
            operation: What each of them is, for messages.
        """
        if not arguments.numel():
            return self
        first = len(self.relations)
        more = [Relation(a, False, KEEPS, operation) for a in ca.vertsplit(arguments)]
        relations = (*self.relations, *more)
        modes = [SX.sym(f"mode_{first + i + 1}") for i in range(len(more))]
        dae = replace(
            self.dae,
            u=ca.densify(ca.vertcat(self.dae.u, *modes)),
            inputs=(*self.dae.inputs, *mode_inputs(more, first)),
        )
        return replace(self, dae=dae, relations=relations, of_time=tuple(_of_time(dae, relations)))

    def described(self, i: int) -> str:
        """Return a relation as text, e.g. "sign of v"."""
        return self._descriptions[i]

    @cached_property
    def _descriptions(self) -> tuple[str, ...]:
        return tuple(map(self._described, self.relations))

    def _described(self, relation: Relation) -> str:
        symbols = ca.symvar(relation.argument)
        count = ca.Function("f", symbols, [relation.argument]).n_instructions()
        nested = ca.depends_on(relation.argument, self.modes)
        # CasADi prints by recursion, and a deep expression would end the process
        text = as_text(relation.argument) if count < 40 and not nested else "@"
        if "@" in text:  # CasADi's name of a part that is used twice; modes are no variables
            text = ", ".join([*self._variables_in(relation.argument)][:8])
        return f"{relation.operation} of {text}"

    def _variables_in(self, expression: SX) -> dict[str, None]:
        """Return the names of the variables of an expression, those in its modes included."""
        modes = {m.element_hash(): i for i, m in enumerate(ca.vertsplit(self.modes))}
        found, seen, symbols = dict[str, None](), set[int](), ca.symvar(expression)
        while symbols:
            symbol = symbols.pop(0)
            i = modes.get(symbol.element_hash())
            if i is None:
                found[symbol.name()] = None
            elif i not in seen:
                seen.add(i)
                symbols += ca.symvar(self.relations[i].argument)
        return found

    def watching(self, name: str, *, closely: bool = True) -> ca.Function:
        """Return a function of t, x, z, u, p and du/dt, where z solves the algebraic equations.

        Its results are the arguments of the relations with their first time derivatives along a
        solution, and `solved` with its time derivative; then the second time derivatives,
        `rate_sizes` and dx/dt, unless `closely` is False.
        """
        dae = self.dae
        w, v = SX.sym("dz", dae.z.numel()), SX.sym("du", dae.u.numel())
        rates = self.rates(self.arguments, w, v)
        results = [self.arguments, rates, self.solved, self.rates(self.solved, w, v)]
        results += [self.rates(rates, w, v), self.rate_sizes, dae.ode] if closely else []
        return self._with_unknown_rates(name, dae.ode, w, [v], results)

    @property
    def of_states(self) -> tuple[int, ...]:
        """Positions of the relations whose arguments do not depend on time alone."""
        return tuple(i for i, alone in enumerate(self.of_time) if not alone)

    def along_motion(self, name: str) -> ca.Function:
        """Return a function of t, x, z, u, p, du/dt and dx/dt, where z solves its equations.

        Its results are the arguments of the relations and their time derivatives, and the modes
        with theirs: of a relation that slides, as the equations make them.
        """
        dae = self.dae
        f, w, v = (SX.sym("d", s.numel()) for s in (dae.x, dae.z, dae.u))
        modes, rates = SX(self.modes), SX.zeros(len(self.relations))
        if self.sliding:
            modes[list(self.sliding)] = self.solved
            rates[list(self.sliding)] = self.rates(self.solved, w, v, f)
        results = [self.arguments, self.rates(self.arguments, w, v, f), modes, rates]
        return self._with_unknown_rates(name, f, w, [v, f], [*map(ca.densify, results)])

    def _with_unknown_rates(
        self, name: str, ode: SX, w: SX, others: Sequence[SX], results: Sequence[SX]
    ) -> ca.Function:
        """Return results as a function that solves for dz/dt, if one of them depends on it.

        Args:
            name: Name of the function.
            ode: dx/dt as an expression of `others` or of the symbols of the equations.
            w: Symbols of dz/dt.
            others: Arguments of the function after t, x, z, u, p, the first of them du/dt.
            results: Results of the function.
        """
        dae = self.dae
        given = [*dae.arguments, *others]
        law = ca.Function("law", [*given, w], results, {"cse": True})
        symbols = [MX.sym("argument", s.numel()) for s in given]
        dz = MX.zeros(w.numel())
        if ca.depends_on(ca.vertcat(*results), w):
            known, along = ca.vertcat(dae.t, dae.x, dae.u), ca.vertcat(1, ode, others[0])
            moved = ca.jtimes(dae.balanced, known, along)
            dz = implicit_change(given, ca.jacobian(dae.balanced, dae.z), moved)(*symbols)
        return ca.Function(name, symbols, [ca.densify(found) for found in law(*symbols, dz)])

    def rates(
        self, column: SX, unknown_rates: SX, input_rates: SX, state_rates: SX | None = None
    ) -> SX:
        """Return the time derivative of a column along a solution.

        Args:
            column: Of the frozen equations' symbols, (n, 1).
            unknown_rates: Time derivatives of the algebraic unknowns, (nz, 1).
            input_rates: Those of the inputs, (nu, 1).
            state_rates: Those of the states, (nx, 1); by the equations if None.
        """
        dae = self.dae
        moving = ca.vertcat(dae.t, dae.x, dae.z, dae.u)
        ode = dae.ode if state_rates is None else state_rates
        along = ca.vertcat(1, ode, unknown_rates, input_rates)
        return ca.densify(ca.jtimes(column, moving, along))

    def along(self, column: SX, dt: SX | float = 0.0) -> SX:
        """Return the change of a column along the direction of the derivatives of the states.

        Args:
            column: Of the symbols of a DAE with `derived` states, (n, 1).
            dt: Change of time along it.
        """
        dae, nx = self.dae, self.dae.derived
        u, p = ca.vertsplit(dae.u), ca.vertsplit(dae.p)  # CasADi's [:0] may be a row
        nu, np_ = (len(u) - len(self.relations)) // 2, len(p) // 2  # each direction follows these
        moving = ca.vertcat(dae.t, dae.x[:nx], *u[:nu], *p[:np_])
        rates = ca.vertcat(dt, dae.x[nx : 2 * nx], *u[nu : 2 * nu], *p[np_:])
        return ca.densify(ca.jtimes(column, moving, rates))

    def blended(self) -> "Hybrid":
        """Return equations that are affine in each mode of a sign, between -1 and 1.

        Where all modes are -1 or 1, they have the same values: a branch that is not taken is not
        evaluated. Equations that call functions stay as they are.
        """
        first = self.dae.u.numel() - len(self.relations)
        modes = {
            first + i
            for i, (relation, alone) in enumerate(zip(self.relations, self.of_time, strict=True))
            if not (relation.floor or alone)
        }
        laws = ca.vertcat(self.dae.ode, self.dae.alg, self.dae.outputs)
        if not modes or ca.OP_CALL in operations(laws):
            return self
        return replace(self, dae=affine_in_modes(self.dae, modes, taken=True))

    def slid(self, which: Collection[int]) -> "Hybrid":
        """Return the equations in which the modes of some relations keep their arguments at 0.

        Raises:
            ValueError: The arguments do not depend on the modes, or not linearly.
        """
        chosen = tuple(sorted(which))
        if not chosen:
            return self
        dae, rows = self.dae, list(chosen)
        first = dae.u.numel() - len(self.relations)
        polynomial = affine_in_modes(dae, {first + i for i in rows})
        modes = SX.sym("slid", len(rows))
        every = self.modes
        values = SX(every)
        values[rows] = modes
        ode, alg = ca.substitute([polynomial.ode, polynomial.alg], [every], [values])
        arguments = self.arguments[rows]
        jumping = ca.depends_on(arguments, dae.z) and ca.depends_on(alg, modes)
        if jumping or ca.depends_on(arguments, every[rows]):
            raise ValueError("an expression that stays at 0 depends on what jumps with its sign")
        if dae.derived and (dae.algebraics or ca.depends_on(dae.outputs, every[rows])):
            raise ValueError(
                "while it stays at 0, no derivatives of outputs that hold it are known"
            )
        inner = replace(self, dae=replace(dae, ode=ode, alg=alg))
        rates = input_rates(dae)
        slopes = ca.vertcat(*(dae.u[rates[v.name]] if v.name in rates else 0 for v in dae.inputs))
        unknown = SX.zeros(dae.z.numel())
        if ca.depends_on(arguments, dae.z):
            given, along = ca.vertcat(dae.t, dae.x, dae.u), ca.vertcat(1, ode, slopes)
            unknown = -ca.solve(ca.jacobian(alg, dae.z), ca.jtimes(alg, given, along))
        law = inner.rates(arguments, unknown, slopes)
        if dae.algebraics:
            more = tuple(
                Variable(f"slid_{i}", "1", "mode of a relation that stays at 0", 0.0) for i in rows
            )
            unknowns = ca.vertcat(dae.z, modes)
            frozen = replace(
                dae, z=unknowns, alg=ca.vertcat(alg, law), ode=ode,
                algebraics=dae.algebraics + more, closing=None,
            )  # fmt: skip
            return replace(self, dae=frozen, sliding=chosen, solved=modes)
        matrix = ca.jacobian(law, modes)
        if ca.depends_on(matrix, modes) or ca.sprank(matrix) < len(rows):
            raise ValueError("nothing that depends on its sign keeps an expression at 0")
        offset = ca.substitute(law, modes, SX.zeros(len(rows)))
        solved = ca.densify(-ca.solve(matrix, offset))
        if dae.derived:  # the derivatives of the states hold those of the modes
            nx = dae.derived
            change = ca.jacobian(ode[:nx], modes) @ self.along(solved)
            ode[nx : 2 * nx] += change
        ode = ca.densify(ca.substitute(ode, modes, solved))
        return replace(self, dae=replace(dae, ode=ode), sliding=chosen, solved=solved)


@dataclass(frozen=True)
class InputRate(Variable):
    """An input that is the time derivative of another one, `of`."""

    of: str = ""


def with_rates(dae: Dae, names: Sequence[str]) -> Dae:
    """Return the model with the time derivatives of some inputs as further inputs."""
    known, more = {variable.name for variable in dae.variables}, list[InputRate]()
    for name in names:
        own = f"rate_of_{name}"
        while own in known:
            own += "_"
        more.append(InputRate(own, "1", f"time derivative of {name}", 0.0, of=name))
    symbols = [SX.sym(variable.name) for variable in more]
    return replace(dae, u=ca.vertcat(dae.u, *symbols), inputs=(*dae.inputs, *more))


def input_rates(dae: Dae) -> dict[str, int]:
    """Return the positions of the inputs that are time derivatives, by the inputs' names."""
    return {v.of: i for i, v in enumerate(dae.inputs) if isinstance(v, InputRate)}


def hybrid(dae: Dae) -> Hybrid | None:
    """Return the equations of a model with every relation frozen at a mode; None without events.

    Relations that depend on parameters alone, and those in `Model.smooth`, stay as they are, and so
    do those that only validity conditions and outputs have which drive no other model.
    """
    driving = dae.driving_outputs
    if operations(ca.vertcat(dae.ode, dae.alg, driving)).isdisjoint(RELATIONS) and not dae.events:
        return None
    conditions = ca.vertcat(SX(0, 1), *(event.condition for event in dae.events))
    values = [event.values for event in dae.events]
    laws = LawsWithModes([dae.ode, dae.alg, conditions, driving], [dae.outputs, *values], dae)
    ode, alg, conditions, _, outputs, *values = laws.results
    relations = laws.relations
    if not relations and not dae.events:
        return None
    more = mode_inputs(relations)
    smooth = replace(
        dae,
        u=ca.densify(ca.vertcat(dae.u, *laws.modes)),
        inputs=(*dae.inputs, *more),
        ode=ode,
        alg=alg,
        outputs=outputs,
        events=(),
        smooth=(),
    )
    events = tuple(
        replace(event, condition=condition, values=own)
        for event, condition, own in zip(dae.events, ca.vertsplit(conditions), values, strict=True)
    )
    return Hybrid(smooth, tuple(relations), events, tuple(_of_time(smooth, relations)))


def _of_time(dae: Dae, relations: Sequence[Relation]) -> list[bool]:
    """Tell which arguments depend on time, parameters and modes that do so alone."""
    first = dae.u.numel() - len(relations)
    found = list[bool]()
    for relation in relations:
        others = [dae.u[first + i] for i in range(len(relations)) if found[i : i + 1] != [True]]
        moving = ca.vertcat(dae.x, dae.z, *ca.vertsplit(dae.u)[:first], *others)
        found.append(not ca.depends_on(relation.argument, moving))
    return found
