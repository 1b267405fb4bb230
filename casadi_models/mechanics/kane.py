"""Kane's method by automatic differentiation.

A mechanical system is a set of inertial terms and loads over coordinates q and speeds u:

    sum over terms  P^T (dp/dt)  =  sum over loads  P^T f  +  A^T lambda       (Kane's equations)
                         A u'   +  (dA/dt) u  =  0                              (constraints)

with p a momentum, P = d(rate)/du the partial rates (Kane's partial velocities) and A = dg/du for
constraints g(q, u) = 0. Momenta and rates may be resolved in any turning frame; partial rates are
Jacobians and time derivatives are directional derivatives along q', so nothing is differentiated
by hand. Time enters as a coordinate with q' = 1.

Every speed has a role:
  free        its equation gives its acceleration;
  dependent   eliminated through the constraints;
  prescribed  its acceleration is given; the residual of its equation is the driving load;
  held        always zero; the residual of its equation is the reaction.

Source  Kane & Levinson, Dynamics: Theory and Applications, 1985, chapters 4 to 6.
"""

from dataclasses import dataclass, field

import casadi as ca
from casadi import SX


def _none() -> SX:
    return SX(0, 1)


@dataclass(frozen=True, eq=False)  # CasADi's == builds an expression
class InertialTerm:
    """A momentum and the rate it goes with, both resolved in one frame.

    Attributes:
        rate: Velocity or angular velocity, (k, 1); linear in the speeds.
        momentum: Its linear or angular momentum, (k, 1).
        frame_rate: Angular velocity of the frame of both, in its own axes; None when at rest.
    """

    rate: SX
    momentum: SX
    frame_rate: SX | None = None


@dataclass(frozen=True, eq=False)
class Load:
    """A force with its point's velocity, or a torque with its body's angular velocity."""

    rate: SX
    force: SX


@dataclass(frozen=True, eq=False)
class System:
    """A mechanical system, declared once; every formulation is derived from it.

    Attributes:
        q, q_dot: Coordinates and their rates in terms of q and the speeds, (n, 1).
        free, dependent, prescribed, held: Symbols of the speeds by role, columns.
        prescribed_dot: Accelerations of the prescribed speeds.
        inertias, loads: What resists and what drives.
        constraints: g(q, u) = 0, linear in the speeds; one for each dependent speed if there are
            any.

    Raises:
        ValueError: Columns that belong together differ in length.
    """

    q: SX
    q_dot: SX
    free: SX
    inertias: tuple[InertialTerm, ...]
    loads: tuple[Load, ...] = ()
    dependent: SX = field(default_factory=_none)
    prescribed: SX = field(default_factory=_none)
    prescribed_dot: SX = field(default_factory=_none)
    held: SX = field(default_factory=_none)
    constraints: SX = field(default_factory=_none)

    def __post_init__(self) -> None:
        pairs = [("q", "q_dot"), ("prescribed", "prescribed_dot")]
        if self.dependent.numel():
            pairs.append(("dependent", "constraints"))
        for names in pairs:
            rows = [SX(getattr(self, name)).shape for name in names]
            if rows[0] != rows[1]:
                raise ValueError(f"{names[0]} has shape {rows[0]}, {names[1]} has {rows[1]}")

    @property
    def unknown(self) -> SX:
        """The speeds whose accelerations are unknown: free, then dependent."""
        return ca.vertcat(self.free, self.dependent)

    def with_held_at_zero(self, expression: SX) -> SX:
        """Put the constrained speeds to zero, after every partial derivative has been taken."""
        return ca.substitute(expression, self.held, SX.zeros(self.held.numel()))

    def time_derivative(self, expression: SX, unknown_dot: SX | None = None) -> SX:
        """Return d/dt of an expression; unknown accelerations count as zero unless given."""
        along, rate = [self.q, self.prescribed], [self.q_dot, self.prescribed_dot]
        if unknown_dot is not None:
            along, rate = [*along, self.unknown], [*rate, unknown_dot]
        return ca.jtimes(expression, ca.vertcat(*along), ca.vertcat(*rate))


@dataclass(frozen=True, eq=False)
class Accelerations:
    """Accelerations of the free and the dependent speeds.

    Attributes:
        free, dependent: Columns.
        relation: J of u_D = J u_I.
        mass: Mass matrix of the free speeds, the dependent ones eliminated.
    """

    free: SX
    dependent: SX
    relation: SX
    mass: SX

    @property
    def unknown(self) -> SX:
        """Both, in the order of `System.unknown`."""
        return ca.vertcat(self.free, self.dependent)


def body(
    mass: SX, inertia: SX, velocity: SX, omega: SX, frame_rate: SX | None = None
) -> tuple[InertialTerm, ...]:
    """Return the inertial terms of a rigid body.

    Args:
        mass: kg.
        inertia: About the mass center, in the frame of `omega`, (3, 3), kg.m2.
        velocity: Of the mass center, in that frame, (3, 1), m/s.
        omega: Angular velocity of the body, in that frame, (3, 1), rad/s.
        frame_rate: Angular velocity of the frame; the body's own when None. It may be another
            one where the inertia looks the same in it (wheels).
    """
    turning = omega if frame_rate is None else frame_rate
    return (
        InertialTerm(velocity, mass * velocity, turning),
        InertialTerm(omega, inertia @ omega, turning),
    )


def gyrostat(
    mass: SX, inertia: SX, velocity: SX, omega: SX, rotor_inertia: SX, axis: SX, spin: SX
) -> tuple[InertialTerm, ...]:
    """Return the inertial terms of a rigid body that carries an axisymmetric rotor.

    Args:
        mass, inertia, velocity, omega: Of body and rotor together, locked; see `body`.
        rotor_inertia: Of the rotor about its axis, kg.m2.
        axis: Unit vector of that axis, fixed in the body, (3, 1).
        spin: Rate of the rotor relative to the body, rad/s.
    """
    momentum = inertia @ omega + rotor_inertia * spin * axis
    return (
        InertialTerm(velocity, mass * velocity, omega),
        InertialTerm(omega, momentum, omega),
        InertialTerm(spin, rotor_inertia * (spin + ca.dot(axis, omega))),
    )


@dataclass(frozen=True, eq=False)
class Part:
    """A body whose mass center is fixed in a frame, in which it may turn.

    Attributes:
        mass: kg.
        place: Mass center from the base point of the frame, (3, 1), m.
        inertia: About the mass center, (3, 3), kg.m2; the same whichever way the body has turned.
        spin: Angular velocity relative to the frame, (3, 1), rad/s.
    """

    mass: SX
    place: SX
    inertia: SX
    spin: SX


@dataclass(eq=False)
class Carrier:
    """A frame that carries bodies and loads, with all vectors in its axes.

    Attributes:
        velocity: Of its base point, (3, 1), m/s.
        omega: Its angular velocity, (3, 1), rad/s.
        parts: The bodies.
        force, moment: Resultants of the loads about the base point, (3, 1), N, N.m.
    """

    velocity: SX
    omega: SX
    parts: list[Part] = field(default_factory=list)
    force: SX = field(default_factory=lambda: SX(3, 1))
    moment: SX = field(default_factory=lambda: SX(3, 1))

    def loads(self) -> tuple[Load, Load]:
        """Return the resultants of the loads."""
        return Load(self.velocity, self.force), Load(self.omega, self.moment)

    def inertias(self) -> tuple[InertialTerm, ...]:
        """Return the inertial terms of the bodies, welded but for their spins."""
        mass, center = self.parts[0].mass, self.parts[0].place
        if len(self.parts) > 1:
            mass = sum((part.mass for part in self.parts), SX(0))
            center = sum((part.mass * part.place for part in self.parts), SX(3, 1)) / mass
        inertia = SX(3, 3)
        for part in self.parts:  # parallel axes theorem
            arm = part.place - center
            inertia += part.inertia + part.mass * (ca.dot(arm, arm) * SX.eye(3) - arm @ arm.T)
        velocity = self.velocity + ca.cross(self.omega, center)
        turning = [part for part in self.parts if not part.spin.is_zero()]
        momentum = inertia @ self.omega
        for part in turning:
            momentum += part.inertia @ part.spin
        return (
            InertialTerm(velocity, mass * velocity, self.omega),
            InertialTerm(self.omega, momentum, self.omega),
            *(
                InertialTerm(part.spin, part.inertia @ (self.omega + part.spin), self.omega)
                for part in turning
            ),
        )


def speed_relation(system: System) -> SX:
    """Return J of u_D = J u_I from the constraints, (n_D, n_I)."""
    independent = ca.jacobian(system.constraints, system.free)
    dependent = ca.jacobian(system.constraints, system.dependent)
    return system.with_held_at_zero(-ca.solve(dependent, independent))


def accelerations(system: System) -> Accelerations:
    """Solve Kane's equations for the free speeds, the dependent speeds being eliminated.

    The partial rates are projected on the free speeds before the mass matrix is formed.

    Raises:
        ValueError: The system has constraints, but no dependent speeds to eliminate by them.
    """
    free, dependent = system.free, system.dependent
    if system.constraints.numel() and not dependent.numel():
        raise ValueError("constraints without dependent speeds; use multiplier_equations")
    relation, offset = SX(0, free.numel()), _none()
    if dependent.numel():
        relation = speed_relation(system)
        matrix = ca.jacobian(system.constraints, dependent)
        offset = -ca.solve(matrix, system.time_derivative(system.constraints))
    # One forward sweep per free speed, and one along the motion, through shared subexpressions
    directions = ca.vertcat(SX.eye(free.numel()), relation)
    known_dot = ca.vertcat(SX.zeros(free.numel()), offset)

    def project(expression: SX) -> SX:
        return ca.jtimes(expression, system.unknown, directions)

    mass = SX.zeros(free.numel(), free.numel())
    force = SX.zeros(free.numel())
    for term in system.inertias:
        partial = project(term.rate)
        mass += partial.T @ project(term.momentum)
        force -= partial.T @ _momentum_rate(system, term, known_dot)
    for load in system.loads:
        force += project(load.rate).T @ load.force
    mass, force = system.with_held_at_zero(mass), system.with_held_at_zero(force)
    # M is symmetric and positive definite: L D L^T costs a third of the general solution
    mass = ca.triu2symm(ca.triu(mass))
    free_dot = ca.ldl_solve(force, *ca.ldl(mass))
    return Accelerations(
        free_dot, relation @ free_dot + system.with_held_at_zero(offset), relation, mass
    )


def mass_matrix(system: System) -> SX:
    """Return the mass matrix of the free speeds, constraints left aside."""
    mass = SX.zeros(system.free.numel(), system.free.numel())
    for term in system.inertias:
        partial = ca.jacobian(term.rate, system.free)
        mass += partial.T @ ca.jacobian(term.momentum, system.free)
    return system.with_held_at_zero(mass)


def constraint_matrix(system: System) -> SX:
    """Return the partial derivatives of the constraints with respect to the free speeds."""
    return system.with_held_at_zero(ca.jacobian(system.constraints, system.free))


def generalized_residual(system: System, unknown_dot: SX, rows: SX) -> SX:
    """Return P^T (dp/dt - f): the load that is missing in the equations of some speeds.

    Args:
        system: The mechanical system.
        unknown_dot: Accelerations of `System.unknown`.
        rows: The speeds whose equations are returned.
    """
    missing = SX.zeros(rows.numel())
    for term in system.inertias:
        rate = _momentum_rate(system, term, unknown_dot)
        missing += ca.jacobian(term.rate, rows).T @ rate
    for load in system.loads:
        missing -= ca.jacobian(load.rate, rows).T @ load.force
    return system.with_held_at_zero(missing)


def constraint_acceleration(system: System, unknown_dot: SX) -> SX:
    """Return the time derivative of the constraints."""
    return system.with_held_at_zero(system.time_derivative(system.constraints, unknown_dot))


def multiplier_equations(system: System, free_dot: SX, multipliers: SX) -> SX:
    """Return the index-1 residuals: Kane's equations of the free speeds, then the constraints.

    Args:
        system: A system without dependent speeds.
        free_dot: Symbols of the unknown accelerations.
        multipliers: Symbols of the unknown constraint loads, which do power against `constraints`.

    Raises:
        ValueError: The system has dependent speeds.
    """
    if system.dependent.numel():
        raise ValueError("dependent speeds are eliminated already; declare all of them free")
    motion = (
        generalized_residual(system, free_dot, system.free)
        - constraint_matrix(system).T @ multipliers
    )
    return ca.vertcat(motion, constraint_acceleration(system, free_dot))


def constraint_loads(system: System, unknown_dot: SX) -> SX:
    """Return the loads of the constraints that `accelerations` eliminated."""
    partial = system.with_held_at_zero(ca.jacobian(system.constraints, system.dependent))
    return ca.solve(partial.T, generalized_residual(system, unknown_dot, system.dependent))


def reactions(system: System, unknown_dot: SX, multipliers: SX | None = None) -> SX:
    """Return the loads that drive the prescribed and enforce the constrained speeds, in that order.

    Args:
        system: The mechanical system.
        unknown_dot: Accelerations of `System.unknown`.
        multipliers: Loads of the constraints; needed where the system has any.

    Raises:
        ValueError: They are missing.
    """
    rows = ca.vertcat(system.prescribed, system.held)
    load = generalized_residual(system, unknown_dot, rows)
    if multipliers is None:
        if system.constraints.numel():
            raise ValueError("the loads of the constraints are missing; give them as multipliers")
        return load
    return load - system.with_held_at_zero(ca.jacobian(system.constraints, rows)).T @ multipliers


def kinetic_energy(system: System) -> SX:
    """Return half the product of momenta and rates, J."""
    twice = sum((ca.dot(term.rate, term.momentum) for term in system.inertias), SX(0))
    return system.with_held_at_zero(twice / 2)


def _momentum_rate(system: System, term: InertialTerm, unknown_dot: SX) -> SX:
    rate = system.time_derivative(term.momentum, unknown_dot)
    if term.frame_rate is not None:
        rate += ca.cross(term.frame_rate, term.momentum)
    return rate
