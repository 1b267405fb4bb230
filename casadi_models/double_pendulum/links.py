"""Parameters, common start, states and outputs of all formulations of the double pendulum."""

from typing import NamedTuple

import casadi as ca
from casadi import SX

from casadi_models.dae import Family, Model
from casadi_models.dae.expressions import column
from casadi_models.double_pendulum import orientation
from casadi_models.double_pendulum.shapes import draw
from casadi_models.mechanics import rotations
from casadi_models.units import DEGREE

UP = rotations.unit(3)

# Common start of links 1 and 2: psi, theta, phi in deg (3-1-3, link along -z); w in rad/s
ANGLES = ((30.0, 20.0, 10.0), (-20.0, 35.0, 15.0))
RATES = ((0.3, -0.2, 0.5), (-0.2, 0.4, -0.5))

# A norm error decays at twice this rate, 1/s: faster than solvers make errors, slower than the
# pendulum moves (docs/double_pendulum.md compares 0, 1 and 10).
NORM_RATE = 1.0

JOINT_FORCES = tuple(
    (f"f{axis}_{joint}", f"force of {bodies} along {axis.upper()}")
    for joint, bodies in (("O", "the ground on link 1"), ("A", "link 1 on link 2"))
    for axis in "xyz"
)


FAMILY = Family(
    "double_pendulum",
    "3-D double pendulum on ball joints",
    "Unit 7, Exercises 7.2 to 7.4",
    {"rad": "deg"},
    stop_time=10.0,
    reference_tolerance=1e-11,  # the motion multiplies an error by about 1e4 in 10 s
    draw=draw,
)


class Rod(NamedTuple):
    """One of the two equal links."""

    length: SX
    m: SX
    g: SX
    inertia: SX  # about the mass center, in L1 or L2

    @property
    def center(self) -> SX:
        """Place of the mass center against the upper joint, in L1 or L2."""
        return -self.length / 2 * UP

    @property
    def weight(self) -> SX:
        """Weight of a link, in N."""
        return -self.m * self.g * UP


class Start(NamedTuple):
    """Common start of a link, in terms of parameters."""

    angles: SX  # psi, theta, phi: 3-1-3, link along -z
    quaternion: SX
    rate: SX  # in the link's frame


class Link(NamedTuple):
    """Motion of a link; `rate` in its own frame, all else in N."""

    rotation: SX
    rate: SX
    center: SX  # place of the mass center
    velocity: SX  # of the mass center


def parameters(model: Model) -> tuple[Rod, tuple[Start, Start]]:
    """Declare the parameters; return the links' properties and their start."""
    length = model.parameter("length", "m", 0.5, "length of a link", positive=True)
    m = model.parameter("m", "kg", 2.8, "mass of a link", positive=True)
    diameter = model.parameter(
        "diameter", "m", 0.03, "diameter of a link", positive=True, display_unit="cm"
    )
    g = model.parameter("g", "m/s2", 9.81, "gravity along -Z")
    transverse, axial = m * length**2 / 12, m * diameter**2 / 8  # slender, of circular section
    inertia = model.inertia("link", ca.diag(ca.vertcat(transverse, transverse, axial)))
    return Rod(length, m, g, inertia), (_start(model, 1), _start(model, 2))


def rate_states(model: Model, link: int, start: Start) -> SX:
    """Declare the angular velocity of a link in its frame."""
    about = f"rate of link {link} about its"
    rate = column(
        model.state(f"w{link}_{axis}", "rad/s", 0.0, f"{about} {axis}", nominal=5.0)
        for axis in "xyz"
    )
    model.start(rate, start.rate, f"common start of link {link}")
    return rate


def quaternion_states(model: Model, link: int, start: Start, rate: SX) -> SX:
    """Declare the orientation of a link as a unit quaternion and give it its derivative.

    q' = q (NORM_RATE (1 - |q|^2), w/2), a product of quaternions. The scalar part vanishes for a
    unit quaternion, so that the solution and the order of a solver stay what they are; it pulls
    back a norm that numerical errors have changed.
    """
    q = column(
        model.state(f"q{link}_{part}", "1", 0.0, quaternion_meaning(link, part)) for part in "wxyz"
    )
    model.start(q, start.quaternion, f"common start of link {link}")
    pull = NORM_RATE * (1 - ca.dot(q, q))
    model.derivative(q, rotations.quaternion_product(q, ca.vertcat(pull, rate / 2)))
    return q


def norm_error(q: SX) -> SX:
    """Return |q|^2 - 1, zero for a unit quaternion."""
    return ca.dot(q, q) - 1


def quaternion_meaning(link: int, part: str) -> str:
    """Describe a part of a quaternion, a state or an output."""
    return f"{part} of the unit quaternion of link {link}: link along -z to world"


def outputs(model: Model, rod: Rod, links: tuple[Link, Link]) -> None:
    """Declare places of A and the tip, vertical angular momentum and energies."""
    momentum, kinetic, height = SX(0), SX(0), SX(0)
    for link, end in zip(links, ("A", "tip"), strict=True):
        place = link.center + link.rotation @ rod.center
        for axis, value in zip("xyz", ca.vertsplit(place), strict=True):
            model.output(f"{axis}_{end}", "m", value, f"{axis} of {end}", nominal=0.5)
        spin = rod.inertia @ link.rate
        momentum += (rod.m * ca.cross(link.center, link.velocity) + link.rotation @ spin)[2]
        kinetic += (rod.m * ca.dot(link.velocity, link.velocity) + ca.dot(link.rate, spin)) / 2
        height += link.center[2]
    model.output("angular_momentum_z", "kg.m2/s", momentum, "angular momentum about O along Z")
    model.energies(kinetic, rod.m * rod.g * height, nominal=10.0)


def _start(model: Model, link: int) -> Start:
    angles = [
        model.parameter(
            f"{name}{link}_0", "rad", value * DEGREE, f"start of link {link}: 3-1-3 angle {name}"
        )
        for name, value in zip(("psi", "theta", "phi"), ANGLES[link - 1], strict=True)
    ]
    rate = [
        model.parameter(f"w{link}_{axis}0", "rad/s", value, f"start of link {link}: rate {axis}")
        for axis, value in zip("xyz", RATES[link - 1], strict=True)
    ]
    psi_theta_phi = ca.vertcat(*angles)
    return Start(psi_theta_phi, orientation.to_quaternion(psi_theta_phi), ca.vertcat(*rate))
