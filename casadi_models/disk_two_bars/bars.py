"""Parameters, states, inertias, loads and outputs of all formulations of the disk with bars."""

from functools import partial
from math import pi
from typing import NamedTuple

import casadi as ca
from casadi import SX

from casadi_models.dae import Family, Model
from casadi_models.disk_two_bars.shapes import draw
from casadi_models.mechanics import kane, rotations
from casadi_models.units import BOOK_UNITS, FOOT, FOOT_POUND, SLUG

FAMILY = Family(
    "disk_two_bars",
    "two hinged bars below a turning disk",
    "Unit 7, Exercise 7.1",
    BOOK_UNITS | {"m": "ft", "m/s2": "ft/s2"},
    stop_time=20.0,
    draw=draw,
)
FORCES = ("f1_H1", "f2_H1", "f3_H1", "f1_H2", "f2_H2", "f3_H2")


class Motion(NamedTuple):
    """States."""

    theta1: SX
    theta2: SX
    theta1_dot: SX
    theta2_dot: SX
    phi: SX


class Data(NamedTuple):
    """Parameters, sorted by what they describe."""

    disk_inertia: SX  # about its center, in D
    hinge: SX  # H1 from the disk's center, in D
    mass: SX  # of a bar
    inertia: SX  # of a bar about its center, in its axes
    length: SX  # of a bar
    Omega: SX
    g: SX
    k1: SX
    k2: SX
    c1: SX
    c2: SX


class Bar(NamedTuple):
    """Motion of a bar relative to D; `shift` and `velocity` from what carries its upper end."""

    rotation: SX
    omega: SX  # in the bar's axes
    shift: SX  # in D
    velocity: SX  # rate of the shift, in D


class Terms(NamedTuple):
    """Inertias, loads and potential energy."""

    inertias: tuple[kane.InertialTerm, ...]
    loads: tuple[kane.Load, ...]
    torques: SX  # of springs and dampers on bars 1 and 2
    potential: SX


def terms(motion: Motion, data: Data, bar1: Bar, bar2: Bar) -> Terms:
    """Return inertias and loads of disk and bars; forces and velocities in D."""
    turn = data.Omega * rotations.unit(3)
    down = -data.length * rotations.unit(3)  # from upper to lower end, in the bar's axes
    weight = -data.mass * data.g * rotations.unit(3)
    inertias = [kane.InertialTerm(data.Omega, data.disk_inertia[2, 2] * data.Omega)]
    loads, potential = [], SX(0)
    place, velocity = data.hinge, ca.cross(turn, data.hinge)
    for bar in (bar1, bar2):
        omega = bar.rotation.T @ turn + bar.omega
        place += bar.shift
        velocity += ca.cross(turn, bar.shift) + bar.velocity
        along, across = bar.rotation @ down, bar.rotation @ ca.cross(omega, down)
        center = velocity + across / 2
        inertias += [
            kane.InertialTerm(center, data.mass * center, turn),
            kane.InertialTerm(omega, data.inertia @ omega, omega),
        ]
        loads.append(kane.Load(center, weight))
        potential -= ca.dot(weight, place + along / 2)
        place, velocity = place + along, velocity + across

    stretch = ca.vertcat(motion.theta1, motion.theta2 - motion.theta1)
    rate = ca.vertcat(motion.theta1_dot, motion.theta2_dot - motion.theta1_dot)
    k, c = ca.vertcat(data.k1, data.k2), ca.vertcat(data.c1, data.c2)
    torques = -k * stretch - c * rate
    loads.append(kane.Load(rate, torques))
    potential += ca.dot(k, stretch**2) / 2
    return Terms(tuple(inertias), tuple(loads), torques, potential)


def motion(model: Model) -> Motion:
    """Declare the states."""
    return Motion(
        model.state("theta1", "rad", 0.0, "angle of bar 1 from the downward vertical, outward"),
        model.state("theta2", "rad", 0.0, "angle of bar 2 from the downward vertical, outward"),
        model.state("theta1_dot", "rad/s", 0.0, "rate of theta1"),
        model.state("theta2_dot", "rad/s", 0.0, "rate of theta2"),
        model.state("phi", "rad", 0.0, "angle of the disk about e3", nominal=100.0),
    )


def data(model: Model) -> Data:
    """Declare the parameters."""
    size = partial(model.parameter, positive=True)

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
    return Data(
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


def outputs(model: Model, system: kane.System, terms: Terms, M_disk: SX) -> None:
    """Declare drive torque, spring torques and energies."""
    meaning = "torque of the drive on the disk about e3"
    model.output("M_disk", "N.m", M_disk, meaning, nominal=10.0)
    for i, other in ((1, "disk"), (2, "bar 1")):
        meaning = f"torque of spring and damper {i} about e1, {other} on bar {i}"
        model.output(f"spring_torque_{i}", "N.m", terms.torques[i - 1], meaning, nominal=10.0)
    model.energies(kane.kinetic_energy(system), terms.potential, nominal=100.0)


def hinge_load(what: str, name: str) -> str:
    """Return the meaning of a hinge load from its name."""
    axis, hinge = name[1], name[-1]
    axes = f"e{axis}" if what == "force" else f"b{axis} of bar {hinge}"
    return f"{what} of hinge {hinge} on bar {hinge}, {axes}"
