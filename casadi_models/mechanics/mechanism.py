"""Mechanisms with closed loops in one call: to an explicit ODE, or to an index-1 DAE.

Given are coordinates q, their rates u, inertias, loads and loops g(q, t) = 0. Everything that
follows from these is declared: speeds, equations of motion, starts on the loops, invariants,
monitors.

Source  Kane & Levinson, Dynamics, 1985; Baumgarte, Comput. Methods Appl. Mech. Eng. 1, 1972.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import casadi as ca
from casadi import DM, SX

from casadi_models.dae import Model
from casadi_models.dae.expressions import column
from casadi_models.dae.packed import rewritten
from casadi_models.dae.relations import term_sizes
from casadi_models.mechanics import conditions, kane
from casadi_models.mechanics.slopes import determined, first_repeating, in_sizes_of_units

CLOSING_RATE = 1.0  # 1/s
DAMPING = 1e-10  # of the steps to the nearest closed position, of the squares of the slopes
STEPS = 50  # of Newton's method at the start


@dataclass(frozen=True, eq=False)  # CasADi's == builds an expression
class Mechanism:
    """The derived motion; columns in the model's symbols.

    Attributes:
        speeds, accelerations: Of every coordinate.
        loop_loads: What the loops exert against g (forces where g is a length).
        drives: The loads that drive the driven coordinates, in their order.
        system: Inertias and loads as the caller wrote them.
        u: The symbols that stand for the speeds there.
    """

    speeds: SX
    accelerations: SX
    loop_loads: SX
    drives: SX
    system: kane.System
    u: SX

    @property
    def kinetic_energy(self) -> SX:
        """J."""
        return self.at(kane.kinetic_energy(self.system))

    def at(self, expression: SX) -> SX:
        """Return an expression of q and u in the model's symbols."""
        return ca.substitute(expression, self.u, self.speeds)


@dataclass(frozen=True, eq=False)
class _Parts:
    model: Model
    q: SX
    u: SX
    names: tuple[str, ...]
    system: kane.System
    g: SX
    starts: Mapping[str, float] = field(default_factory=dict)
    driven: tuple[int, ...] = ()
    driven_dot: SX = field(default_factory=lambda: SX(0, 1))
    clock: SX = field(default_factory=lambda: SX(0, 1))  # time, where something moves with it

    @property
    def moving(self) -> list[int]:
        """Coordinates that are not driven."""
        return [i for i in range(len(self.names)) if i not in self.driven]

    @property
    def moved(self) -> SX:
        """The rate at which loops open while no coordinate moves."""
        return ca.jtimes(self.g, self.model.t, SX(1))

    def system_of(
        self,
        free: SX,
        inertias: Sequence[kane.InertialTerm],
        loads: Sequence[kane.Load],
        **more: SX,
    ) -> kane.System:
        """Return the system with its roles, in the symbols of `more["q_dot"]`."""
        q_dot = more.pop("q_dot")
        return kane.System(
            q=ca.vertcat(self.q, self.clock),
            q_dot=ca.vertcat(q_dot, SX.ones(self.clock.numel())),
            free=free,
            prescribed=ca.vertcat(SX(0, 1), *(q_dot[i] for i in self.driven)),
            prescribed_dot=self.driven_dot,
            inertias=tuple(inertias),
            loads=tuple(loads),
            **more,
        )


def mechanism(
    model: Model,
    q: SX,
    u: SX,
    inertias: Sequence[kane.InertialTerm],
    loads: Sequence[kane.Load] = (),
    loops: Mapping[str, SX] | None = None,
    *,
    independent: SX | None = None,
    driven: Mapping[str, SX | float] | None = None,
    speed_starts: Mapping[str, float] | None = None,
    constant: SX | None = None,
) -> Mechanism:
    """Declare the motion of a mechanism in a model.

    Args:
        model: Has the coordinates as states without derivative.
        q: The coordinates, (n, 1).
        u: What stands for their rates in `inertias` and `loads`: free symbols, (n, 1).
        inertias, loads: See `kane`; rates linear in u, up to what time alone moves (a pivot that is
            shaken). Momenta are of q, u, time and parameters.
        loops: g(q, t) of each loop by name, columns of functions of q, time and parameters.
        independent: Coordinates whose speeds remain; the others are eliminated and the result is an
            ODE. All speeds remain when None: a DAE with accelerations and loop loads as unknowns,
            which passes where the elimination is singular.
        driven: Accelerations of coordinates with prescribed motion, by name: loops may move
            with them. Their speeds are states; the loads that this takes are `drives`.
        speed_starts: By coordinate, 0 where it is not named; of dependent ones, it follows.
        constant: States and inputs that count as constant where momenta are differentiated: the
            mass of a rocket, whose fuel takes its momentum along.

    Raises:
        ValueError: A rate is not linear in u, a loop or a momentum depends on something whose rate
            is not known, a loop repeats others, or the number of independent coordinates is wrong.
    """
    names = tuple(variable.name for variable in model.declared(q))
    g = ca.vertcat(SX(0, 1), *(loops or {}).values())
    _reject_nonlinear(inertias, loads, u)
    closed = {f"loop '{name}'": SX(rows) for name, rows in (loops or {}).items()}
    _reject_foreign(model, closed, q, "let a coordinate of driven={...} move it")
    momenta = {f"the momentum of inertia {i}": x.momentum for i, x in enumerate(inertias, 1)}
    known = ca.vertcat(q, u, SX(0, 1) if constant is None else constant)
    _reject_foreign(model, momenta, known, "make it a coordinate, or name it in constant=")
    moves = ca.depends_on(ca.vertcat(*map(ca.vec, (closed | momenta).values())), model.t)
    clock = model.t if moves else SX(0, 1)
    system = kane.System(q=q, q_dot=u, free=u, inertias=tuple(inertias), loads=tuple(loads))
    for name in (*(speed_starts or {}), *(driven or {})):
        if name not in names:
            raise ValueError(f"start of the speed of '{name}': no such coordinate")
    order = tuple(i for i, name in enumerate(names) if name in (driven or {}))
    driven_dot = ca.vertcat(SX(0, 1), *((driven or {})[names[i]] for i in order))
    parts = _Parts(
        model, q, u, names, system, g, dict(speed_starts or {}), order, driven_dot, clock
    )
    if not g.numel():
        return _open(parts)
    moving = parts.moving
    if independent is None:
        found, place = _dependent(parts, loops or {}, moving)
        dependent = [moving[i] for i in found]
    else:
        chosen = [variable.name for variable in model.declared(independent)]
        dependent = [i for i in moving if names[i] not in chosen]
        if len(dependent) != g.numel():
            _dependent(parts, loops or {}, moving)  # one too many by repetition?
            raise ValueError(
                f"{g.numel()} loops for {len(moving)} coordinates leave {len(moving) - g.numel()} "
                f"independent ones; {len(chosen)} are named"
            )
        _dependent(parts, loops or {}, dependent)
    model.start_equation(q[dependent], g, "closure of the loops")
    model.invariant("position_drift", q[moving], g, "the loops are closed")
    if independent is None:
        return _with_multipliers(parts, loops or {}, dependent, place)
    return _eliminated(parts, dependent)


def _open(parts: _Parts) -> Mechanism:
    u, moving = parts.u, parts.moving
    system = parts.system_of(u[moving], parts.system.inertias, parts.system.loads, q_dot=u)
    solution = kane.accelerations(system)
    speeds = _speed_states(parts, range(len(parts.names)))
    rates = _column(parts, (moving, solution.free), (parts.driven, parts.driven_dot))
    rates, drives, mass = (
        ca.substitute(e, u, speeds)
        for e in (rates, kane.reactions(system, solution.unknown), solution.mass)
    )
    parts.model.derivative(ca.vertcat(parts.q, speeds), ca.vertcat(speeds, rates))
    conditions.watch_masses(parts.model, mass)
    return Mechanism(speeds, rates, SX(0, 1), drives, parts.system, u)


def _eliminated(parts: _Parts, dependent: list[int]) -> Mechanism:
    model, q, u = parts.model, parts.q, parts.u
    free = [i for i in parts.moving if i not in dependent]
    known = sorted((*free, *parts.driven))
    system = parts.system_of(
        u[free],
        parts.system.inertias,
        parts.system.loads,
        q_dot=u,
        dependent=u[dependent],
        constraints=ca.jtimes(parts.g, q, u) + parts.moved,
    )
    solution = kane.accelerations(system)
    jacobian = ca.jacobian(parts.g, q)
    states = _speed_states(parts, known)
    follow = -ca.solve(jacobian[:, dependent], jacobian[:, known] @ states + parts.moved)
    speeds = _column(parts, (known, states), (dependent, follow))
    rates = _column(
        parts,
        (free, solution.free),
        (dependent, solution.dependent),
        (parts.driven, parts.driven_dot),
    )
    loop_loads = kane.constraint_loads(system, solution.unknown)
    drives = kane.reactions(system, solution.unknown, loop_loads)
    rates, loop_loads, drives, mass = (
        ca.substitute(e, u, speeds) for e in (rates, loop_loads, drives, solution.mass)
    )
    model.derivative(q, speeds)
    model.derivative(states, rates[known])
    if free:
        conditions.watch_masses(model, mass)
    conditions.watch_elimination(model, jacobian[:, dependent])
    return Mechanism(speeds, rates, loop_loads, drives, parts.system, u)


def _with_multipliers(
    parts: _Parts, loops: Mapping[str, SX], dependent: list[int], place: DM
) -> Mechanism:
    model, q, g, moving = parts.model, parts.q, parts.g, parts.moving
    speeds = _speed_states(parts, range(len(parts.names)))
    sizes = [variable.nominal for variable in model.declared(speeds)]
    unknown = column(
        model.algebraic(f"{parts.names[i]}_dot_dot", *_rate(parts, i, 2), nominal=10.0 * sizes[i])
        for i in moving
    )
    loop_loads = column(
        model.algebraic(f"load_{name}", "1", 0.0, f"load of loop {name}") for name in _rows(loops)
    )
    velocity = ca.jtimes(g, q, speeds) + parts.moved
    terms = parts.system.inertias, parts.system.loads
    inertias, loads = rewritten(terms, lambda every: ca.substitute(every, [parts.u], [speeds]))
    system = parts.system_of(speeds[moving], inertias, loads, q_dot=speeds, constraints=velocity)
    decay = model.closing_rate(CLOSING_RATE)
    residual = kane.multiplier_equations(system, unknown, loop_loads)
    closing = 2 * decay * velocity + decay**2 * g
    model.equation(residual + ca.vertcat(SX.zeros(len(moving)), closing))
    rates = _column(parts, (moving, unknown), (parts.driven, parts.driven_dot))
    model.derivative(ca.vertcat(q, speeds), ca.vertcat(speeds, rates))
    jacobian = ca.jacobian(g, q)
    known = [i for i in range(len(parts.names)) if i not in dependent]
    others = jacobian[:, known] @ speeds[known] + parts.moved
    follow = -ca.solve(jacobian[:, dependent], others)
    model.start(speeds[dependent], follow, "the loops stay closed")
    mass = kane.mass_matrix(system)
    model.invariant(
        "velocity_drift",
        speeds[moving],
        velocity,
        "the loops stay closed",
        sizes=conditions.equal_energies(mass),
    )
    conditions.watch_masses(model, mass)

    def at_start(expression: SX) -> DM:
        return ca.Function("start", [q], [model.numbers(expression, but=q)])(place)

    conditions.watch_constraints(model, kane.constraint_matrix(system), mass, at_start)
    drives = kane.reactions(system, unknown, loop_loads)
    return Mechanism(speeds, rates, loop_loads, drives, parts.system, parts.u)


def _column(parts: _Parts, *placed: tuple[Sequence[int], SX]) -> SX:
    """Return a column over all coordinates from its rows."""
    rows = {i: row for which, c in placed for i, row in zip(which, ca.vertsplit(c), strict=True)}
    return ca.vertcat(*(rows[i] for i in range(len(parts.names))))


def _rate(parts: _Parts, i: int, order: int) -> tuple[str, float, str]:
    """Return unit, start and meaning of a derivative of a coordinate."""
    (variable,) = parts.model.declared(parts.q[i])
    power = {1: "s", 2: "s2"}[order]
    unit = f"1/{power}" if variable.unit == "1" else f"{variable.unit}/{power}"
    what = "rate" if order == 1 else "second rate"
    return (
        unit,
        parts.starts.get(variable.name, 0.0) if order == 1 else 0.0,
        (f"{what} of {variable.name}"),
    )


def _speed_states(parts: _Parts, which: Sequence[int]) -> SX:
    sizes = [variable.nominal for variable in parts.model.declared(parts.q)]
    return column(
        parts.model.state(f"{parts.names[i]}_dot", *_rate(parts, i, 1), nominal=sizes[i])
        for i in which
    )


def _rows(loops: Mapping[str, SX]) -> list[str]:
    """Return the name of every row of the loops."""
    return [
        name if SX(rows).numel() == 1 else f"{name}_{i + 1}"
        for name, rows in loops.items()
        for i in range(SX(rows).numel())
    ]


def _reject_nonlinear(
    inertias: Sequence[kane.InertialTerm], loads: Sequence[kane.Load], u: SX
) -> None:
    rates = {f"inertia {i}": term.rate for i, term in enumerate(inertias, start=1)}
    rates |= {f"load {i}": load.rate for i, load in enumerate(loads, start=1)}
    for what, rate in rates.items():
        if ca.depends_on(ca.jacobian(SX(rate), u), u):
            raise ValueError(f"the rate of {what} is not linear in the speeds")


def _reject_foreign(model: Model, rows: Mapping[str, SX], own: SX, way_out: str) -> None:
    """Reject what depends on something whose rate of change is not known, by name."""
    known = ca.vertcat(own, model.t, model.constants)
    for what, expression in rows.items():
        for symbol in ca.symvar(SX(expression)):
            if not ca.depends_on(known, symbol):
                raise ValueError(
                    f"{what} depends on '{symbol}', which is no coordinate, parameter or time, and "
                    f"whose rate is not known; {way_out}"
                )


def _dependent(
    parts: _Parts, loops: Mapping[str, SX], chosen: Sequence[int]
) -> tuple[list[int], DM]:
    """Return which of some coordinates the loops determine, later ones first, and all at the start.

    Raises:
        ValueError: Names a loop that repeats others there.
    """
    jacobian = ca.jacobian(parts.g, parts.q)[:, chosen]
    at_start = parts.model.numbers(ca.vertcat(parts.g, ca.vec(jacobian)), but=parts.q)
    m, n = jacobian.shape
    full = ca.Function(
        "slope", [parts.q], [parts.model.numbers(ca.jacobian(parts.g, parts.q), but=parts.q)]
    )
    terms = ca.fmin(term_sizes(at_start[:m, :]), 1)
    law = ca.Function("law", [parts.q], [at_start, terms])
    place = DM([variable.start or 0.0 for variable in parts.model.declared(parts.q)])
    for _ in range(STEPS):  # the nearest closed position
        rows, sizes = law(place)
        residual = rows[:m]
        if all((ca.fabs(residual) < 1e-12 * sizes).elements()):
            break
        slope = ca.densify(full(place))  # its rows may repeat each other
        damped = slope @ slope.T + DAMPING * ca.sumsqr(slope) * DM.eye(m)
        place -= slope.T @ ca.solve(damped + DM.eye(m) * (ca.sumsqr(slope) == 0), residual)
    units = [parts.model.declared(parts.q)[i].unit for i in chosen]
    slopes = in_sizes_of_units(ca.reshape(law(place)[0][m:], m, n), units)
    found, left = determined(slopes)
    if left:
        name = _rows(loops)[first_repeating(slopes, left[0])]
        raise ValueError(
            f"loop '{name}' repeats others at the start, or the dependent "
            "coordinates cannot close it; leave it out, or choose other independent ones"
        )
    return found, place
