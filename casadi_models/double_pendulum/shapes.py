"""Drawing of the double pendulum: Z up, O at the origin."""

import casadi as ca
from casadi import SX

from casadi_models.dae import Model
from casadi_models.dae.scenery import BLUE, DARK, GREEN, ORANGE, PINK, SKY
from casadi_models.mechanics.rotations import from_quaternion, unit


def draw(model: Model) -> None:
    """Declare two links, the joint forces and the path of the tip."""
    length, radius = model.named("length"), model.named("diameter") / 2
    model.world(up=(0, 0, 1), forward=(1, 0, 0))
    model.shape("joint O", "sphere", 1.6 * radius, color=DARK)
    place = SX.zeros(3)
    for i, (color, joint) in enumerate(((BLUE, "O"), (SKY, "A")), start=1):
        q = ca.vertcat(*(model.named(f"q{i}_{part}") for part in "wxyz"))
        turn = from_quaternion(q / ca.norm_2(q))
        link = model.body(f"link {i}", place, turn)
        model.rod("rod", (SX.zeros(3), -length * unit(3)), radius, body=link, color=color)
        # a mark beside the axis, so that a turn about it is seen
        model.rod("mark", (radius * unit(1), radius * unit(1) - length * unit(3)), radius / 3,
                  body=link, color=DARK)  # fmt: skip
        force = ca.vertcat(*(model.named(f"f{axis}_{joint}") for axis in "xyz"))
        carrier = "the ground" if i == 1 else "link 1"
        model.arrow(f"force at {joint}", place, force, f"force of {carrier} on link {i}",
                    color=ORANGE)  # fmt: skip
        place = place - length * turn @ unit(3)
        if i == 1:
            model.shape("joint A", "sphere", 1.4 * radius, body=link, at=-length * unit(3),
                        color=DARK)  # fmt: skip
            model.trace("path of A", place, color=GREEN)
    model.shape("tip", "sphere", 1.8 * radius, body="link 2", at=-length * unit(3), color=PINK)
    model.trace("path of the tip", place, color=PINK)
