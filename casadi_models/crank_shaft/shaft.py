"""Shape, parameters, states and names of loads of all formulations of the crank shaft."""

from functools import partial
from itertools import pairwise
from math import pi
from typing import NamedTuple

import casadi as ca
from casadi import SX

from casadi_models.crank_shaft.shapes import draw
from casadi_models.dae import Family, Model
from casadi_models.mechanics import kane
from casadi_models.units import BOOK_UNITS, FOOT, INCH, POUND

# Corners of the path in units of the segment length (Unit 7, page 1)
PATH = ((0, 0, 0), (0, 0, 1), (1, 0, 1), (1, 0, 2), (-1, 0, 2), (-1, 0, 3), (0, 0, 3), (0, 0, 4))
STEEL = 0.284 * POUND / INCH**3 / (32.174 * FOOT)  # kg/m3: weight density over the book's g
FAMILY = Family(
    "crank_shaft",
    "crank shaft in two bearings",
    "Unit 7, Example 1",
    BOOK_UNITS | {"rad/s": "rpm"},
    stop_time=4.0,
    draw=partial(draw, path=PATH),
)

# Loads on the shaft: name, unit, meaning, size
LOADS = (
    ("fx_A", "N", "force of bearing A on the shaft along X'", 100.0),
    ("fy_A", "N", "force of bearing A on the shaft along Y'", 1.0),
    ("fx_B", "N", "force of bearing B on the shaft along X'", 100.0),
    ("fy_B", "N", "force of bearing B on the shaft along Y'", 1.0),
    ("T", "N.m", "torque of the drive on the shaft about Z", 1.0),
)


class Shaft(NamedTuple):
    """The shaft's properties and what drives it."""

    length: SX  # of a segment
    mass: SX
    inertia: SX  # about G, in X'Y'Z
    alpha: SX
    g: SX


def spin(model: Model) -> tuple[SX, SX]:
    """Declare angle and rate of the shaft."""
    phi = model.state("phi", "rad", 0.0, "angle of the shaft about Z", nominal=100.0)
    omega = model.state("omega", "rad/s", 50.0, "angular velocity about Z", nominal=50.0)
    return phi, omega


def properties(model: Model) -> Shaft:
    """Declare the parameters."""
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
        # slender bar about its center, then the parallel axes theorem (Unit 1)
        unit_inertia = _point(along) / 12 + _point(middle)
        inertia += size * unit_inertia * segment * length**2
    return Shaft(length, 8 * segment, model.inertia("shaft", inertia), alpha, g)


def _point(r: ca.DM) -> ca.DM:
    return ca.dot(r, r) * ca.DM.eye(3) - r @ r.T


def weight(shaft: Shaft, velocity: SX, rotation: SX) -> kane.Load:
    """Return the weight at G, resolved in the axes of its velocity."""
    return kane.Load(velocity, rotation.T @ ca.vertcat(0, -shaft.mass * shaft.g, 0))
