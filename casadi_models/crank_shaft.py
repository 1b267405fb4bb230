"""Crank shaft S, seven welded slender bars, turning about Z in two bearings A and B.

         +--+          Z ->        S: (X', Y', Z) turns about Z by phi; the path of the bars
    A ---+  |  +--- B              lies in the plane X'Z, bar 4 is twice as long;
            +--+                   G lies midway between A (origin) and B on the axis.

Model   bars slender (no inertia about their own axis), bearings slide along Z, drive torque at A.
Source  Unit 7, Example 1; equations from Unit 2.
"""

from math import pi
from typing import NamedTuple

import casadi as ca
from casadi import SX

from casadi_models import kane, rotations
from casadi_models.dae import Dae, Model
from casadi_models.units import FOOT, INCH, POUND

# Corners of the path in units of the segment length (Unit 7, page 1)
PATH = ((0, 0, 0), (0, 0, 1), (1, 0, 1), (1, 0, 2), (-1, 0, 2), (-1, 0, 3), (0, 0, 3), (0, 0, 4))
STEEL = 0.284 * POUND / INCH**3 / (32.174 * FOOT)  # kg/m3: weight density over the book's g
DISPLAY = {"rad": "deg", "rad/s": "rpm", "N": "lbf", "N.m": "ft.lbf", "m": "in", "kg": "slug"}


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
    torque, fx_a, fy_a, fx_b, fy_b = ca.vertsplit(kane.reactions(system, SX(0, 1)))
    for name, force in zip(("fx_A", "fy_A", "fx_B", "fy_B"), (fx_a, fy_a, fx_b, fy_b), strict=True):
        model.output(name, "N", force, _bearing(name))
    model.output("T", "N.m", torque, "drive torque on the shaft about Z")
    height = SX(0)
    _energies(model, shaft, rate=ca.vertcat(0, 0, omega), velocity=SX.zeros(3), height=height)
    return model.freeze()


def multipliers() -> Dae:
    """Return the DAE of a free body held by bearings and a drive: 12 states, 11 algebraics."""
    model = _model("multipliers", "free body; bearing forces and drive torque are the multipliers")
    phi, omega = _spin(model)
    place = ca.vertcat(
        *(
            model.state(f"{axis}_G", "m", 0.0, f"{axis} of G from its place, world")
            for axis in "xyz"
        )
    )
    tilts = [
        model.state(f"tilt_{i}", "rad", 0.0, f"tilt of the axis about follower axis {i}")
        for i in (1, 2)
    ]
    velocity = ca.vertcat(
        *(
            model.state(f"v{axis}_G", "m/s", 0.0, f"velocity of G along {axis}', follower")
            for axis in "xyz"
        )
    )
    rates = [
        model.state(f"omega_{i}", "rad/s", 0.0, f"angular velocity about follower axis {i}")
        for i in (1, 2)
    ]
    shaft = _shaft(model)

    # Body-fixed 1-2-3 angles, the spin last: regular while the axis is near Z.
    rotation = rotations.about(1, tilts[0]) @ rotations.about(2, tilts[1]) @ rotations.about(3, phi)
    rate = ca.vertcat(*rates, omega)
    angle_rates = SX.sym("angle_rates", 3)
    angles = ca.vertcat(*tilts, phi)
    _, omega_of = rotations.body_fixed((1, 2, 3), angles, angle_rates)
    to_angles = ca.solve(ca.jacobian(omega_of, angle_rates), rate)
    q, q_dot = ca.vertcat(place, angles), ca.vertcat(rotation @ velocity, to_angles)

    arm = 2 * shaft.length * rotations.unit(3)  # from G to B
    at_a = (velocity + ca.cross(rate, -arm))[:2]
    at_b = (velocity + ca.cross(rate, arm))[:2]
    speeds = ca.vertcat(velocity, rate)
    drive = SX.sym("drive_rate")  # of the drive, to which the shaft is held by the last constraint
    system = kane.System(
        q=q,
        q_dot=q_dot,
        free=speeds,
        prescribed=drive,
        prescribed_dot=shaft.alpha,
        inertias=kane.body(shaft.mass, shaft.inertia, velocity, rate),
        loads=(_weight(shaft, velocity, rotation),),
        constraints=ca.vertcat(at_a, at_b, omega - drive),
    )
    accelerations = ca.vertcat(
        *(
            model.algebraic(f"{name}_dot", unit, 0.0, f"rate of {name}", nominal=nominal)
            for name, unit, nominal in [(f"v{a}_G", "m/s2", 1.0) for a in "xyz"]
            + [(n, "rad/s2", 10.0) for n in ("omega_1", "omega_2", "omega")]
        )
    )
    loads = [
        model.algebraic(name, "N", 0.0, _bearing(name), nominal=10.0)
        for name in ("fx_A", "fy_A", "fx_B", "fy_B")
    ]
    loads.append(model.algebraic("T", "N.m", 0.0, "drive torque on the shaft about Z"))
    model.equation(kane.multiplier_equations(system, accelerations, ca.vertcat(*loads)))
    model.derivative(ca.vertcat(place, *tilts, phi), q_dot)
    model.derivative(speeds, accelerations)
    _energies(model, shaft, rate=rate, velocity=velocity, height=place[1])
    return model.freeze()


def _model(formulation: str, description: str) -> Model:
    return Model(
        "crank_shaft",
        formulation,
        description=f"crank shaft in two bearings: {description}",
        source="Unit 7, Example 1",
        display=DISPLAY,
        stop_time=4.0,
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
    for start, end in zip(PATH, PATH[1:], strict=False):
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


def _bearing(name: str) -> str:
    return f"force of bearing {name[-1]} on the shaft along {name[1].upper()}'"


def _energies(model: Model, shaft: _Shaft, *, rate: SX, velocity: SX, height: SX) -> None:
    kinetic = (ca.dot(rate, shaft.inertia @ rate) + shaft.mass * ca.dot(velocity, velocity)) / 2
    potential = shaft.mass * shaft.g * height
    model.energies(kinetic, potential, nominal=50.0)
