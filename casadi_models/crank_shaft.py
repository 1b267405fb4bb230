"""Crank shaft S, seven welded slender bars, turning about Z in two bearings A and B.

         +--+          Z ->        S: (X', Y', Z) turns about Z by phi; the path of the bars
    A ---+  |  +--- B              lies in the plane X'Z, bar 4 is twice as long;
            +--+                   G lies midway between A (origin) and B on the axis.

Model   bars slender (no inertia about their own axis), bearings slide along Z, drive torque at A.
Source  Unit 7, Example 1; equations from Unit 2.
"""

from itertools import pairwise
from math import pi
from typing import NamedTuple

import casadi as ca
from casadi import SX

from casadi_models import kane, rotations
from casadi_models.crank_shaft_shapes import draw
from casadi_models.dae import Dae, Model
from casadi_models.joints import free_joint, watch_joints
from casadi_models.units import FOOT, INCH, POUND

# Corners of the path in units of the segment length (Unit 7, page 1)
PATH = ((0, 0, 0), (0, 0, 1), (1, 0, 1), (1, 0, 2), (-1, 0, 2), (-1, 0, 3), (0, 0, 3), (0, 0, 4))
STEEL = 0.284 * POUND / INCH**3 / (32.174 * FOOT)  # kg/m3: weight density over the book's g
DISPLAY = {"rad": "deg", "rad/s": "rpm", "N": "lbf", "N.m": "ft.lbf", "m": "in", "kg": "slug"}

# Loads on the shaft: name, unit, meaning, size
LOADS = (
    ("fx_A", "N", "force of bearing A on the shaft along X'", 100.0),
    ("fy_A", "N", "force of bearing A on the shaft along Y'", 1.0),
    ("fx_B", "N", "force of bearing B on the shaft along X'", 100.0),
    ("fy_B", "N", "force of bearing B on the shaft along Y'", 1.0),
    ("T", "N.m", "torque of the drive on the shaft about Z", 1.0),
)


class _Shaft(NamedTuple):
    length: SX  # of a segment
    mass: SX
    inertia: SX  # about G, in X'Y'Z
    alpha: SX
    g: SX


def driven() -> Dae:
    """Return the ODE of the prescribed spin; bearing forces and torque are reactions: 2 states."""
    model = _model("driven", "prescribed spin; reactions of bearings and drive as outputs")
    phi, omega = _spin(model)
    shaft = _shaft(model)
    model.derivative(phi, omega)
    model.derivative(omega, shaft.alpha)

    # Held speeds: those of the bearing points A and B across the axis, so that the residual of
    # each equation is one bearing force. The speed along Z is held by nothing: nothing acts there.
    a, b = SX.sym("v_A", 2), SX.sym("v_B", 2)
    span = 4 * shaft.length
    tilt = ca.vertcat((a[1] - b[1]) / span, (b[0] - a[0]) / span)
    velocity = ca.vertcat((a + b) / 2, 0)
    rate = ca.vertcat(tilt, omega)
    system = kane.System(
        q=phi,
        q_dot=omega,
        free=SX(0, 1),
        prescribed=omega,
        prescribed_dot=shaft.alpha,
        held=ca.vertcat(a, b),
        inertias=kane.body(shaft.mass, shaft.inertia, velocity, rate),
        loads=(_weight(shaft, velocity, rotations.about(3, phi)),),
    )
    torque, *forces = ca.vertsplit(kane.reactions(system, SX(0, 1)))
    for (name, unit, meaning, size), load in zip(LOADS, [*forces, torque], strict=True):
        model.output(name, unit, load, meaning, nominal=size)
    model.energies(kane.kinetic_energy(system), 0, nominal=50.0)  # G stays on the axis
    return model.freeze()


def multipliers() -> Dae:
    """Return the DAE of a free body held by bearings and a drive: 12 states, 11 algebraics."""
    model = _model("multipliers", "free body; bearing forces and drive torque are the multipliers")
    phi, omega = _spin(model)
    shaft = _shaft(model)
    # Place of G in the world, its velocity in the follower axes X', Y', Z
    joint = free_joint(model, "shaft", 3, phi, omega, "omega_dot", velocity_in="body")
    to_B = 2 * shaft.length * rotations.unit(3)
    at_A, at_B = (joint.velocity + ca.cross(joint.omega, arm) for arm in (-to_B, to_B))
    drive = SX.sym("drive_rate")  # the last constraint ties the shaft to the drive
    system = kane.System(
        q=joint.q,
        q_dot=joint.q_dot,
        free=joint.speeds,
        prescribed=drive,
        prescribed_dot=shaft.alpha,
        inertias=kane.body(shaft.mass, shaft.inertia, joint.velocity, joint.omega),
        loads=(_weight(shaft, joint.velocity, joint.rotation),),
        constraints=ca.vertcat(at_A[:2], at_B[:2], omega - drive),
    )
    loads = [model.algebraic(n, u, 0.0, m, nominal=size) for n, u, m, size in LOADS]
    model.equation(kane.multiplier_equations(system, joint.accelerations, ca.vertcat(*loads)))
    potential = shaft.mass * shaft.g * joint.shift[1]
    model.energies(kane.kinetic_energy(system), potential, nominal=50.0)
    watch_joints(model, (joint,), system)
    forbidden = ca.vertcat(joint.shift[:2], joint.tilts)
    model.invariant("position_drift", forbidden, forbidden, "the bearings hold")
    held = system.constraints[:4]  # without the drive
    model.invariant("velocity_drift", joint.speeds, held, "the bearings hold at rest")
    return model.freeze()


def _model(formulation: str, description: str) -> Model:
    return draw(
        Model(
            "crank_shaft",
            formulation,
            description=f"crank shaft in two bearings: {description}",
            source="Unit 7, Example 1",
            display=DISPLAY,
            stop_time=4.0,
        ),
        PATH,
    )


def _spin(model: Model) -> tuple[SX, SX]:
    phi = model.state("phi", "rad", 0.0, "angle of the shaft about Z", nominal=100.0)
    omega = model.state("omega", "rad/s", 50.0, "angular velocity about Z", nominal=50.0)
    return phi, omega


def _shaft(model: Model) -> _Shaft:
    length = model.parameter("segment_length", "m", 6 * INCH, "length of a segment", positive=True)
    diameter = model.parameter("diameter", "m", 0.5 * INCH, "diameter of the bars", positive=True)
    density = model.parameter(
        "density", "kg/m3", STEEL, "density of the bars", positive=True, display_unit="slug/ft3"
    )
    alpha = model.parameter("alpha", "rad/s2", 10.0, "angular acceleration about Z")
    g = model.parameter("g", "m/s2", 0.0, "gravity along world -Y", display_unit="ft/s2")
    segment = density * pi / 4 * diameter**2 * length
    inertia = SX.zeros(3, 3)
    for start, end in pairwise(PATH):
        ends = [ca.DM(point) - ca.DM([0, 0, 2]) for point in (start, end)]
        middle, along = (ends[0] + ends[1]) / 2, ends[1] - ends[0]
        size = float(ca.norm_2(along))
        # slender bar about its centre, then the parallel axes theorem (Unit 1)
        unit_inertia = _point(along) / 12 + _point(middle)
        inertia += size * unit_inertia * segment * length**2
    return _Shaft(length, 8 * segment, model.inertia("shaft", inertia), alpha, g)


def _point(r: ca.DM) -> ca.DM:
    return ca.dot(r, r) * ca.DM.eye(3) - r @ r.T


def _weight(shaft: _Shaft, velocity: SX, rotation: SX) -> kane.Load:
    return kane.Load(velocity, rotation.T @ ca.vertcat(0, -shaft.mass * shaft.g, 0))
