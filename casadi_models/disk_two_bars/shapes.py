"""Drawing of the disk with two bars: e3 and Z up."""

import casadi as ca
from casadi import SX

from casadi_models.dae import Model
from casadi_models.dae.scenery import BLUE, DARK, GRAY, GREEN, ORANGE, PINK, SKY
from casadi_models.mechanics.rotations import about, unit


def draw(model: Model) -> None:
    """Declare disk and bars, hinge forces, drive torque and the path of the lower end."""
    reach, drop = model.named("hinge_radius"), model.named("hinge_drop")
    length, radius = model.named("bar_length"), model.named("bar_radius")
    size = model.named("disk_radius")
    disk = about(3, model.named("phi"))
    model.world(up=(0, 0, 1), forward=(1, 0, 0))
    model.body("disk", SX.zeros(3), disk)
    thin = 0.06 * size
    model.shape("disk", "cylinder", ca.vertcat(size, thin), body="disk", color=BLUE)
    model.rod("shaft", (SX.zeros(3), 0.8 * size * unit(3)), thin, color=GRAY)
    hinge = ca.vertcat(0, reach, -drop)
    model.rod("bracket", (hinge, reach * unit(2)), thin, body="disk", color=BLUE)
    mark = size * unit(2)
    model.shape("mark", "sphere", 0.08 * size, body="disk", at=mark, color=DARK)
    place = disk @ hinge
    for i, color in ((1, SKY), (2, GREEN)):
        turn = disk @ about(1, model.named(f"theta{i}"))
        bar = model.body(f"bar {i}", place, turn)
        model.rod("bar", (SX.zeros(3), -length * unit(3)), radius, body=bar, color=color)
        axle = 1.3 * radius * unit(1)
        model.rod("hinge", (-axle, axle), 0.4 * radius, body=bar, color=DARK)
        force = ca.vertcat(*(model.named(f"f{axis}_H{i}") for axis in (1, 2, 3)))
        model.arrow(f"force at H{i}", place, disk @ force, f"force of hinge {i} on bar {i}",
                    color=ORANGE)  # fmt: skip
        place = place - length * turn @ unit(3)
    drive = model.named("M_disk") * unit(3)
    model.arrow("drive torque", 0.9 * size * unit(3), drive, "torque of the drive on the disk",
                unit="N.m", color=PINK)  # fmt: skip
    model.trace("path of the lower end", place, color=PINK)
