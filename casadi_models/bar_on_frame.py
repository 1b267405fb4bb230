"""Slender bar pinned at G to the horizontal arm OG of a frame that turns in two bearings.

    B        k   F: (n1, n2, k) turns about the vertical k by phi at the prescribed rate Omega;
    |        ^      n1 and n2 are the world's X and Y at phi = 0; A is the bottom bearing (with
    O----G   |      the drive), B the top one, O the weld of column AB and arm OG = d n2.
    |        +>  Bar: (e1, n2, e3) turns about n2 relative to F by the free angle theta;
    A        n2     e1 = C n1 - S k is its long axis, theta = 0 is horizontal.

Model   gravity off; bar slender; bearings slide along k; damper and torque T2 act in the pin, so
        that the frame bears their reaction: t2_G = T2 - b theta_dot is the book's T2.
        frame_inertia = 0 makes the frame massless (the book's "light"), 1 gives it its mass.
Source  Unit 7, Example 2; equations from Units 2 (U2) and 4 (U4).
"""

from math import pi
from typing import NamedTuple

import casadi as ca
from casadi import SX, cos, sin

from casadi_models import kane, rotations
from casadi_models.bar_on_frame_shapes import draw
from casadi_models.dae import Dae, Model
from casadi_models.joints import free_joint, watch_joints
from casadi_models.units import DEGREE, FOOT, FOOT_POUND, INCH, SLUG

DISPLAY = {"rad": "deg", "N": "lbf", "N.m": "ft.lbf", "m": "in", "kg": "slug"}
DISPLAY |= {"N.m.s/rad": "ft.lbf.s/rad"}

# Loads and motion of the bar: unit, meaning, size
_FACTS = {
    "f1_G_F": ("N", "force of the pin on the bar along n1", 1.0),
    "f2_G_F": ("N", "force of the pin on the bar along n2", 100.0),
    "fk_G_F": ("N", "force of the pin on the bar along k", 1.0),
    "f1_G_B": ("N", "force of the pin on the bar along e1", 1.0),
    "f2_G_B": ("N", "force of the pin on the bar along n2", 100.0),
    "f3_G_B": ("N", "force of the pin on the bar along e3", 1.0),
    "t1_G_F": ("N.m", "torque of the pin on the bar about n1", 1.0),
    "t2_G_F": ("N.m", "torque of the pin on the bar about n2", 1.0),
    "tk_G_F": ("N.m", "torque of the pin on the bar about k", 1.0),
    "t1_G_B": ("N.m", "torque of the pin on the bar about e1", 1.0),
    "t2_G_B": ("N.m", "torque of the pin on the bar about n2", 1.0),
    "t3_G_B": ("N.m", "torque of the pin on the bar about e3", 1.0),
    "M_phi": ("N.m", "torque of the drive on the frame about k", 1.0),
    "f1_A_F": ("N", "force of the bottom bearing on the column along n1", 1.0),
    "f2_A_F": ("N", "force of the bottom bearing on the column along n2", 100.0),
    "f1_B_F": ("N", "force of the top bearing on the column along n1", 1.0),
    "f2_B_F": ("N", "force of the top bearing on the column along n2", 100.0),
    "wx_bar": ("rad/s", "angular velocity of the bar about world X", 10.0),
    "wy_bar": ("rad/s", "angular velocity of the bar about world Y", 10.0),
    "wz_bar": ("rad/s", "angular velocity of the bar about world Z", 10.0),
    "ax_bar": ("rad/s2", "angular acceleration of the bar about world X", 100.0),
    "ay_bar": ("rad/s2", "angular acceleration of the bar about world Y", 100.0),
    "az_bar": ("rad/s2", "angular acceleration of the bar about world Z", 100.0),
}


class _Motion(NamedTuple):
    theta: SX
    theta_dot: SX
    phi: SX
    Omega: SX


class _Data(NamedTuple):
    m: SX
    d: SX
    b: SX
    bar_inertia: SX  # about G, in (e1, n2, e3)
    column_mass: SX
    column_length: SX
    column_inertia: SX  # about its centre, in F
    arm_mass: SX
    arm_inertia: SX  # about its centre, in F
    weld_height: SX
    Omega_dot: SX
    T2: SX


def reduced() -> Dae:
    """Return the ODE of the bar in a frame of given motion, all loads as outputs: 4 states."""
    model = _model("reduced", "equation of motion of the bar, loads in closed form")
    theta, theta_dot, phi, Omega = _motion(model)
    data = _data(model)
    m, d, Omega_dot = data.m, data.d, data.Omega_dot
    s, c = sin(theta), cos(theta)
    inertia = data.bar_inertia[1, 1]  # about n2 and about e3

    # Euler for the bar about n2 (U2): inertia (theta'' + Omega^2 s c) = T2
    t2 = data.T2 - data.b * theta_dot
    theta_ddot = t2 / inertia - Omega**2 * s * c
    model.derivative(theta, theta_dot)
    model.derivative(theta_dot, theta_ddot)
    model.derivative(phi, Omega)
    model.derivative(Omega, Omega_dot)

    # Newton for G, Euler about e1 and e3 (U2): what the pin must supply
    force = m * ca.vertcat(-d * Omega_dot, -d * Omega**2, 0)
    t3 = inertia * (Omega_dot * c - 2 * theta_dot * Omega * s)
    torque_B = ca.vertcat(0, t2, t3)
    to_frame = rotations.about(2, theta)
    torque = to_frame @ torque_B
    _outputs(model, "f1_G_F f2_G_F fk_G_F", force)
    _outputs(model, "f1_G_B f2_G_B f3_G_B", to_frame.T @ force)
    _outputs(model, "t1_G_F t2_G_F tk_G_F", torque)
    _outputs(model, "t1_G_B t2_G_B t3_G_B", torque_B)

    # Lagrange for the frame's angle (U4): what the drive must supply
    frame_inertia = data.column_inertia[2, 2] + data.arm_inertia[2, 2] + data.arm_mass * d**2 / 4
    about_k = frame_inertia + m * d**2 + inertia * c**2
    M_phi = about_k * Omega_dot - 2 * inertia * s * c * theta_dot * Omega
    _outputs(model, "M_phi", M_phi)

    # Newton-Euler for frame and bar about A: what the bearings must supply across k. The column's
    # centre rests and its angular momentum is along k; the arm's centre is at d/2.
    arm_force = data.arm_mass / 2 * ca.vertcat(-d * Omega_dot, -d * Omega**2, 0)
    at_G, at_arm = (ca.vertcat(0, reach, data.weld_height) for reach in (d, d / 2))
    moment = torque + ca.cross(at_G, force) + ca.cross(at_arm, arm_force)
    top = ca.vertcat(moment[1], -moment[0]) / data.column_length
    bottom = (force + arm_force)[:2] - top
    _outputs(model, "f1_A_F f2_A_F f1_B_F f2_B_F", ca.vertcat(bottom, top))

    # Both vectors in (n1, n2, k), turned into the world
    to_world = rotations.about(3, phi)
    rate = ca.vertcat(0, theta_dot, Omega)
    acceleration = ca.vertcat(-Omega * theta_dot, theta_ddot, Omega_dot)
    _outputs(model, "wx_bar wy_bar wz_bar", to_world @ rate)
    _outputs(model, "ax_bar ay_bar az_bar", to_world @ acceleration)
    model.energies((about_k * Omega**2 + inertia * theta_dot**2) / 2, 0, nominal=10.0)
    return model.freeze()


def two_body() -> Dae:
    """Return the DAE of frame and bar in bearings, drive and pin: 24 states, 22 algebraics."""
    model = _model("two_body", "two bodies; loads of bearings, drive and pin are the multipliers")
    theta, theta_dot, phi, Omega = _motion(model)
    data = _data(model)
    # Place of the column's foot A in the world, of the bar's centre G from the arm's end; both
    # velocities in F
    frame = free_joint(model, "frame", 3, phi, Omega, "phi_dot_dot", velocity_in="body")
    bar = free_joint(model, "bar", 2, theta, theta_dot, "theta_dot_dot", velocity_in="carrier")

    def of_frame(point: SX) -> SX:
        """Return the velocity of a point of F, in F."""
        return frame.velocity + ca.cross(frame.omega, point)

    at_A, at_B = SX.zeros(3), ca.vertcat(0, 0, data.column_length)
    at_arm, at_G = (ca.vertcat(0, reach, data.weld_height) for reach in (data.d / 2, data.d))
    velocity = of_frame(at_G + bar.shift) + bar.velocity  # of G, in F
    omega = bar.rotation.T @ frame.omega + bar.omega  # of the bar, in (e1, n2, e3)
    drive = SX.sym("drive_rate")  # the fifth constraint ties the frame to the drive
    system = kane.System(
        q=ca.vertcat(frame.q, bar.q),
        q_dot=ca.vertcat(frame.q_dot, bar.q_dot),
        free=ca.vertcat(frame.speeds, bar.speeds),
        prescribed=drive,
        prescribed_dot=data.Omega_dot,
        inertias=(
            *kane.body(data.column_mass, data.column_inertia, of_frame(at_B / 2), frame.omega),
            *kane.body(data.arm_mass, data.arm_inertia, of_frame(at_arm), frame.omega),
            kane.Inertia(velocity, data.m * velocity, frame.omega),
            kane.Inertia(omega, data.bar_inertia @ omega, omega),
        ),
        loads=(kane.Load(theta_dot, data.T2 - data.b * theta_dot),),
        constraints=ca.vertcat(
            of_frame(at_A)[:2], of_frame(at_B)[:2], Omega - drive, bar.velocity, bar.omega[[0, 2]]
        ),
    )
    accelerations = ca.vertcat(frame.accelerations, bar.accelerations)
    loads = _algebraics(
        model, "f1_A_F f2_A_F f1_B_F f2_B_F M_phi f1_G_F f2_G_F fk_G_F t1_G_B t3_G_B"
    )
    model.equation(kane.multiplier_equations(system, accelerations, loads))

    t1, t3 = ca.vertsplit(loads[8:])
    torque_B = ca.vertcat(t1, data.T2 - data.b * theta_dot, t3)
    _outputs(model, "f1_G_B f2_G_B f3_G_B", bar.rotation.T @ loads[5:8])
    _outputs(model, "t1_G_F t2_G_F tk_G_F", bar.rotation @ torque_B)
    _outputs(model, "t2_G_B", torque_B[1])
    rate = frame.rotation @ bar.rotation @ omega
    _outputs(model, "wx_bar wy_bar wz_bar", rate)
    _outputs(model, "ax_bar ay_bar az_bar", system.rate_of(rate, accelerations))
    model.energies(kane.kinetic_energy(system), 0, nominal=10.0)
    watch_joints(model, (frame, bar), system)
    forbidden = ca.vertcat(frame.shift[:2], frame.tilts, bar.shift, bar.tilts)
    model.invariant("position_drift", forbidden, forbidden, "bearings and pin hold")
    held = ca.vertcat(system.constraints[:4], system.constraints[5:])  # without the drive
    model.invariant("velocity_drift", system.free, held, "bearings and pin hold at rest")
    return model.freeze()


def _model(formulation: str, description: str) -> Model:
    return draw(
        Model(
            "bar_on_frame",
            formulation,
            description=f"bar pinned to a turning frame: {description}",
            source="Unit 7, Example 2",
            display=DISPLAY,
            stop_time=10.0,
        )
    )


def _motion(model: Model) -> _Motion:
    return _Motion(
        model.state("theta", "rad", 60 * DEGREE, "angle of the bar about n2, relative to F"),
        model.state("theta_dot", "rad/s", 3.0, "rate of theta", nominal=10.0),
        model.state("phi", "rad", 0.0, "angle of the frame about k", nominal=100.0),
        model.state("Omega", "rad/s", 2 * pi, "rate of the frame about k", nominal=10.0),
    )


def _data(model: Model) -> _Data:
    def size(name: str, unit: str, value: float, meaning: str) -> SX:
        return model.parameter(name, unit, value, meaning, positive=True)

    m = size("m", "kg", 0.2 * SLUG, "mass of the bar")
    length = size("length", "m", 1 * FOOT, "length of the bar")
    d = size("d", "m", 1 * FOOT, "length of the arm OG")
    b = model.parameter("b", "N.m.s/rad", 0.02 * FOOT_POUND, "damping in the pin", minimum=0.0)
    column_mass = size("column_mass", "kg", 0.01 * SLUG, "mass of the column")
    column_length = size("column_length", "m", 24 * INCH, "length of the column AB")
    radius = size("column_radius", "m", 0.5 * INCH, "radius of column and arm")
    arm_mass = size("arm_mass", "kg", 0.005 * SLUG, "mass of the arm")
    weld_height = size("weld_height", "m", 18 * INCH, "height of O above A")
    Omega_dot = model.parameter("Omega_dot", "rad/s2", 1.0, "angular acceleration of the frame")
    frame = model.parameter(
        "frame_inertia", "1", 1.0, "1: the frame has its mass, 0: it has none", minimum=0, maximum=1
    )
    T2 = model.input("T2", "N.m", 0.0, "torque in the pin on the bar about n2", nominal=0.1)
    return _Data(
        m=m,
        d=d,
        b=b,
        bar_inertia=model.inertia("bar", _slender(m, length, SX(0), axis=1)),
        column_mass=frame * column_mass,
        column_length=column_length,
        column_inertia=frame
        * model.inertia("column", _slender(column_mass, column_length, radius, axis=3)),
        arm_mass=frame * arm_mass,
        arm_inertia=frame * model.inertia("arm", _slender(arm_mass, d, radius, axis=2)),
        weld_height=weld_height,
        Omega_dot=Omega_dot,
        T2=T2,
    )


def _slender(mass: SX, length: SX, radius: SX, *, axis: int) -> SX:
    """Return the inertia of a rod about its centre: slender across, a cylinder about its axis."""
    across, along = mass * length**2 / 12, mass * radius**2 / 2
    return ca.diag(ca.vertcat(*(along if i == axis else across for i in (1, 2, 3))))


def _outputs(model: Model, names: str, column: SX) -> None:
    for name, component in zip(names.split(), ca.vertsplit(column), strict=True):
        unit, meaning, nominal = _FACTS[name]
        model.output(name, unit, component, meaning, nominal=nominal)


def _algebraics(model: Model, names: str) -> SX:
    def declared(name: str) -> SX:
        unit, meaning, nominal = _FACTS[name]
        return model.algebraic(name, unit, 0.0, meaning, nominal=nominal)

    return ca.vertcat(*map(declared, names.split()))
