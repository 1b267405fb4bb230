"""Drawing of the bar on a frame: k and Z up, bearing A at the origin."""

import casadi as ca
from casadi import SX

from casadi_models.dae import Model
from casadi_models.dae.scenery import BLUE, DARK, GRAY, GREEN, ORANGE, PINK, SKY
from casadi_models.mechanics.rotations import about, unit


def draw(model: Model) -> None:
    """Declare frame and bar, the loads of pin, bearings, drive, and the bar's path."""
    d, height, column = map(model.named, ("d", "weld_height", "column_length"))
    length, radius = model.named("length"), model.named("column_radius")
    frame = about(3, model.named("phi"))
    turn = frame @ about(2, model.named("theta"))
    O, to_G = height * unit(3), ca.vertcat(0, d, height)  # noqa: E741 - the book's letter
    G = frame @ to_G
    model.world(up=(0, 0, 1), forward=(1, 0, 0))
    model.body("frame", SX.zeros(3), frame)
    model.body("bar", G, turn)
    top = column * unit(3)
    model.rod("column", (SX.zeros(3), top), radius, body="frame", color=BLUE)
    model.rod("arm", (O, to_G), 0.8 * radius, body="frame", color=BLUE)
    half = length / 2 * unit(1)
    model.rod("bar", (-half, half), 0.8 * radius, body="bar", color=SKY)
    pin = 2 * radius * unit(2)
    model.rod("pin", (-pin, pin), 0.9 * radius, body="bar", color=DARK)
    for name, place in (("A", SX.zeros(3)), ("B", top)):
        step = radius * unit(3)
        model.rod(f"bearing {name}", (place - step, place + step), 2.2 * radius, color=GRAY)
        force = ca.vertcat(model.named(f"f1_{name}_F"), model.named(f"f2_{name}_F"), 0)
        meaning = f"force of bearing {name} on the column"
        model.arrow(f"force at {name}", place, frame @ force, meaning, color=ORANGE)
    for kind, unit_name, color in (("f", "N", GREEN), ("t", "N.m", PINK)):
        load = ca.vertcat(*(model.named(f"{kind}{axis}_G_F") for axis in "12k"))
        what = "force" if kind == "f" else "torque"
        model.arrow(f"pin {what}", G, frame @ load, f"{what} of the pin on the bar",
                    unit=unit_name, color=color)  # fmt: skip
    drive = model.named("M_phi") * unit(3)
    model.arrow("drive torque", SX.zeros(3), drive, "torque of the drive on the frame",
                unit="N.m", color=DARK)  # fmt: skip
    model.trace("path of the bar's end", G + turn @ half, color=SKY)
