r"""Two bars hinged end to end below a disk that turns at a constant rate, with springs and dampers.

    ---+-----  disk     D: (e1, e2, e3) turns with the disk about the vertical e3 by phi; e2 points
       |   |H1          from the axis to hinge H1, e1 = e2 x e3 is the axis of both hinges; H1 lies
    e3 ^    \  bar 1    hinge_drop below the disk's plane.
       |     \H2     Bar i: (e1, b2, b3) turns about e1 by theta_i from D, positive outward; it
       +->    \         points along -b3 and hangs at theta_i = 0.
         e2    \  bar 2

Model   disk thin, bars solid cylinders; spring and damper 1 act between disk and bar 1 on theta1,
        2 between the bars on theta2 - theta1; gravity along -e3, zero energy in the disk's plane.
        The source's figure is lost: hinges and springs are placed as assumed here.
Source  Unit 7, Exercise 7.1.
"""

from math import pi
from typing import NamedTuple

import casadi as ca
from casadi import SX

from casadi_models import conditions, kane, rotations
from casadi_models.dae import Dae, Model
from casadi_models.disk_two_bars_shapes import draw
from casadi_models.joints import free_joint, watch_joints
from casadi_models.units import FOOT, FOOT_POUND, SLUG

DISPLAY = {"rad": "deg", "N": "lbf", "N.m": "ft.lbf", "m": "ft", "kg": "slug", "m/s2": "ft/s2"}
DISPLAY |= {"N.m/rad": "ft.lbf/rad", "N.m.s/rad": "ft.lbf.s/rad"}
FORCES = ("f1_H1", "f2_H1", "f3_H1", "f1_H2", "f2_H2", "f3_H2")


class _Motion(NamedTuple):
    theta1: SX
    theta2: SX
    theta1_dot: SX
    theta2_dot: SX
    phi: SX


class _Data(NamedTuple):
    disk_inertia: SX  # about its centre, in D
    hinge: SX  # H1 from the disk's centre, in D
    mass: SX  # of a bar
    inertia: SX  # of a bar about its centre, in its axes
    length: SX  # of a bar
    Omega: SX
    g: SX
    k1: SX
    k2: SX
    c1: SX
    c2: SX


class _Bar(NamedTuple):
    """Motion of a bar relative to D; `shift` and `velocity` from what carries its upper end."""

    rotation: SX
    omega: SX  # in the bar's axes
    shift: SX  # in D
    velocity: SX  # rate of the shift, in D


class _Terms(NamedTuple):
    inertias: tuple[kane.Inertia, ...]
    loads: tuple[kane.Load, ...]
    torques: SX  # of springs and dampers on bars 1 and 2
    potential: SX


def reduced() -> Dae:
    """Return the ODE of the two angles, hinge forces and drive torque as reactions: 5 states."""
    model = _model("reduced", "equations of the two angles; hinge forces are reactions")
    motion = _motion(model)
    data = _data(model)
    theta = ca.vertcat(motion.theta1, motion.theta2)
    theta_dot = ca.vertcat(motion.theta1_dot, motion.theta2_dot)

    # Held speeds: of each bar's upper end relative to what carries it, so that the residual of
    # each equation is one component of a hinge force.
    gaps = SX.sym("gap_rate", 3, 2)
    bars = [
        _Bar(rotations.about(1, theta[i]), rotations.unit(1) * theta_dot[i], SX(3, 1), gaps[:, i])
        for i in (0, 1)
    ]
    terms = _terms(motion, data, *bars)
    system = kane.System(
        q=theta,
        q_dot=theta_dot,
        free=theta_dot,
        prescribed=data.Omega,
        prescribed_dot=SX(0),
        held=ca.vec(gaps),
        inertias=terms.inertias,
        loads=terms.loads,
    )
    solution = kane.accelerations(system)
    theta_ddot = solution.free
    conditions.watch_masses(model, solution.mass)
    model.derivative(motion.phi, data.Omega)
    model.derivative(theta, theta_dot)
    model.derivative(theta_dot, theta_ddot)
    M_disk, *forces = ca.vertsplit(kane.reactions(system, theta_ddot))
    for name, force in zip(FORCES, forces, strict=True):
        model.output(name, "N", force, _hinge("force", name), nominal=10.0)
    _outputs(model, system, terms, M_disk)
    return model.freeze()


def multipliers() -> Dae:
    """Return the DAE of two free bars held by hinge constraints: 25 states, 22 algebraics."""
    model = _model("multipliers", "free bars; hinge forces and torques are the multipliers")
    motion = _motion(model)
    data = _data(model)
    model.derivative(motion.phi, data.Omega)
    joints = [
        free_joint(model, body, 1, angle, rate, acceleration, velocity_in="carrier")
        for body, angle, rate, acceleration in (
            ("bar1", motion.theta1, motion.theta1_dot, "theta1_dot_dot"),
            ("bar2", motion.theta2, motion.theta2_dot, "theta2_dot_dot"),
        )
    ]
    bar1, bar2 = (_Bar(j.rotation, j.omega, j.shift, j.velocity) for j in joints)
    terms = _terms(motion, data, bar1, bar2)
    relative = bar2.omega - bar2.rotation.T @ bar1.rotation @ bar1.omega  # in the axes of bar 2
    system = kane.System(
        q=ca.vertcat(*(j.q for j in joints)),
        q_dot=ca.vertcat(*(j.q_dot for j in joints)),
        free=ca.vertcat(*(j.speeds for j in joints)),
        prescribed=data.Omega,
        prescribed_dot=SX(0),
        inertias=terms.inertias,
        loads=terms.loads,
        constraints=ca.vertcat(bar1.velocity, bar2.velocity, bar1.omega[1:], relative[1:]),
    )
    accelerations = ca.vertcat(*(j.accelerations for j in joints))
    loads = ca.vertcat(
        *(model.algebraic(n, "N", 0.0, _hinge("force", n), nominal=10.0) for n in FORCES),
        *(
            model.algebraic(n, "N.m", 0.0, _hinge("torque", n))
            for n in ("t2_H1", "t3_H1", "t2_H2", "t3_H2")
        ),
    )
    model.equation(kane.multiplier_equations(system, accelerations, loads))
    _outputs(model, system, terms, kane.reactions(system, accelerations, loads))
    watch_joints(model, joints, system)
    forbidden = ca.vertcat(*(ca.vertcat(j.shift, j.tilts) for j in joints))
    model.invariant("position_drift", forbidden, forbidden, "the hinges hold")
    model.invariant("velocity_drift", system.free, system.constraints, "the hinges hold at rest")
    return model.freeze()


def _terms(motion: _Motion, data: _Data, bar1: _Bar, bar2: _Bar) -> _Terms:
    """Return inertias and loads of disk and bars; forces and velocities in D."""
    turn = data.Omega * rotations.unit(3)
    down = -data.length * rotations.unit(3)  # from upper to lower end, in the bar's axes
    weight = -data.mass * data.g * rotations.unit(3)
    inertias = [kane.Inertia(data.Omega, data.disk_inertia[2, 2] * data.Omega)]
    loads, potential = [], SX(0)
    place, velocity = data.hinge, ca.cross(turn, data.hinge)
    for bar in (bar1, bar2):
        omega = bar.rotation.T @ turn + bar.omega
        place += bar.shift
        velocity += ca.cross(turn, bar.shift) + bar.velocity
        along, across = bar.rotation @ down, bar.rotation @ ca.cross(omega, down)
        centre = velocity + across / 2
        inertias += [
            kane.Inertia(centre, data.mass * centre, turn),
            kane.Inertia(omega, data.inertia @ omega, omega),
        ]
        loads.append(kane.Load(centre, weight))
        potential -= ca.dot(weight, place + along / 2)
        place, velocity = place + along, velocity + across

    stretch = ca.vertcat(motion.theta1, motion.theta2 - motion.theta1)
    rate = ca.vertcat(motion.theta1_dot, motion.theta2_dot - motion.theta1_dot)
    k, c = ca.vertcat(data.k1, data.k2), ca.vertcat(data.c1, data.c2)
    torques = -k * stretch - c * rate
    loads.append(kane.Load(rate, torques))
    potential += ca.dot(k, stretch**2) / 2
    return _Terms(tuple(inertias), tuple(loads), torques, potential)


def _model(formulation: str, description: str) -> Model:
    return draw(
        Model(
            "disk_two_bars",
            formulation,
            description=f"two hinged bars below a turning disk: {description}",
            source="Unit 7, Exercise 7.1",
            display=DISPLAY,
            stop_time=20.0,
        )
    )


def _motion(model: Model) -> _Motion:
    return _Motion(
        model.state("theta1", "rad", 0.0, "angle of bar 1 from the downward vertical, outward"),
        model.state("theta2", "rad", 0.0, "angle of bar 2 from the downward vertical, outward"),
        model.state("theta1_dot", "rad/s", 0.0, "rate of theta1"),
        model.state("theta2_dot", "rad/s", 0.0, "rate of theta2"),
        model.state("phi", "rad", 0.0, "angle of the disk about e3", nominal=100.0),
    )


def _data(model: Model) -> _Data:
    def size(name: str, unit: str, value: float, meaning: str) -> SX:
        return model.parameter(name, unit, value, meaning, positive=True)

    def not_negative(name: str, unit: str, value: float, meaning: str) -> SX:
        return model.parameter(name, unit, value * FOOT_POUND, meaning, minimum=0.0)

    disk_mass = size("disk_mass", "kg", 0.2 * SLUG, "mass of the disk")
    radius = size("disk_radius", "m", 1 * FOOT, "radius of the disk")
    reach = size("hinge_radius", "m", 0.5 * FOOT, "distance of H1 from the axis")
    drop = model.parameter("hinge_drop", "m", 0.2 * FOOT, "depth of H1 below the disk's plane")
    mass = size("bar_mass", "kg", 0.1 * SLUG, "mass of each bar")
    length = size("bar_length", "m", 2 * FOOT, "length of each bar")
    bar_radius = size("bar_radius", "m", 0.1 * FOOT, "radius of each bar")
    disk = disk_mass * radius**2 / 4 * ca.diag(SX([1, 1, 2]))
    across, along = mass * (3 * bar_radius**2 + length**2) / 12, mass * bar_radius**2 / 2
    bar = ca.diag(ca.vertcat(across, across, along))
    return _Data(
        disk_inertia=model.inertia("disk", disk),
        hinge=ca.vertcat(0, reach, -drop),
        mass=mass,
        inertia=model.inertia("bar", bar),
        length=length,
        k1=not_negative("k1", "N.m/rad", 50, "stiffness between disk and bar 1"),
        k2=not_negative("k2", "N.m/rad", 5, "stiffness between the bars"),
        c1=not_negative("c1", "N.m.s/rad", 4, "damping between disk and bar 1"),
        c2=not_negative("c2", "N.m.s/rad", 0.4, "damping between the bars"),
        Omega=model.parameter("Omega", "rad/s", 2 * pi, "rate of the disk about e3"),
        g=model.parameter("g", "m/s2", 32.174 * FOOT, "gravity along -e3"),
    )


def _outputs(model: Model, system: kane.System, terms: _Terms, M_disk: SX) -> None:
    meaning = "torque of the drive on the disk about e3"
    model.output("M_disk", "N.m", M_disk, meaning, nominal=10.0)
    for i, other in ((1, "disk"), (2, "bar 1")):
        meaning = f"torque of spring and damper {i} about e1, {other} on bar {i}"
        model.output(f"spring_torque_{i}", "N.m", terms.torques[i - 1], meaning, nominal=10.0)
    model.energies(kane.kinetic_energy(system), terms.potential, nominal=100.0)


def _hinge(what: str, name: str) -> str:
    """Return the meaning of a hinge load from its name."""
    axis, hinge = name[1], name[-1]
    axes = f"e{axis}" if what == "force" else f"b{axis} of bar {hinge}"
    return f"{what} of hinge {hinge} on bar {hinge}, {axes}"
