"""Drawing of the crank shaft: Z along the shaft, gravity along -Y."""

from itertools import pairwise

import casadi as ca
from casadi import SX

from casadi_models.dae import Model
from casadi_models.dae.scenery import BLUE, DARK, GRAY, GREEN, ORANGE, PINK
from casadi_models.mechanics.rotations import about, unit

Points = tuple[tuple[int, int, int], ...]


def draw(model: Model, path: Points) -> None:
    """Declare the bars of the shaft along a path in units of the segment length, and its loads."""
    length, radius = model.named("segment_length"), model.named("diameter") / 2
    turn = about(3, model.named("phi"))
    model.world(up=(0, 1, 0), forward=(0, 0, 1), axes=("X", "Y", "Z"))
    shaft = model.body("shaft", SX.zeros(3), turn)
    corners = [length * ca.vertcat(*point) for point in path]
    for i, ends in enumerate(pairwise(corners), start=1):
        model.rod(f"bar {i}", ends, radius, body=shaft, color=BLUE)
    for i, corner in enumerate(corners[1:-1], start=1):
        model.shape(f"weld {i}", "sphere", radius, body=shaft, at=corner, color=BLUE)
    for name, place in (("A", SX.zeros(3)), ("B", corners[-1])):
        model.rod(f"bearing {name}", (place - 0.15 * length * unit(3), place
                  + 0.15 * length * unit(3)), 2.5 * radius, color=GRAY)  # fmt: skip
        size = ca.vertcat(4 * radius, length, 4 * radius)
        model.shape(f"pedestal {name}", "box", size, at=place - (length / 2 + 2.5 * radius)
                    * unit(2), color=GRAY)  # fmt: skip
        force = ca.vertcat(model.named(f"fx_{name}"), model.named(f"fy_{name}"), 0)
        model.arrow(f"force at {name}", place, turn @ force,
                    f"force of bearing {name} on the shaft", color=ORANGE)  # fmt: skip
    torque = model.named("T") * unit(3)
    at = -0.4 * length * unit(3)
    model.arrow("drive torque", at, torque, "torque of the drive on the shaft", unit="N.m",
                color=PINK)  # fmt: skip
    model.shape("axes", "axes", length / 2, body=shaft, color=DARK)
    model.trace("path of a corner", turn @ corners[2], color=GREEN)
