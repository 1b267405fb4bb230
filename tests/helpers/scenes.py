"""Small models with a drawing."""

import casadi as ca
from casadi import SX

from casadi_models.dae import Dae, Model
from casadi_models.mechanics.rotations import about


def spinning(rate: float, *, drawn: bool = True, limit: float | None = None) -> Dae:
    """Return a disk that turns about Z; valid while its angle is below a limit."""
    model = Model("spinning", description="a disk", source="a test", stop_time=1.0)
    angle = model.state("angle", "rad", 0.0, "angle about Z", display_unit="deg")
    speed = model.parameter("rate", "rad/s", rate, "its rate")
    radius = model.parameter("radius", "m", 0.5, "its radius", positive=True)
    model.derivative(angle, speed)
    if limit is not None:
        model.limit(limit - angle, f"the disk turns by less than {limit:g} rad")
    if drawn:
        turn = about(3, angle)
        model.body("disk", ca.vertcat(0, 0, 1), turn)
        model.shape("disk", "cylinder", ca.vertcat(radius, 0.1), body="disk", color="#D55E00")
        model.shape("mark", "sphere", 0.1, body="disk", at=ca.vertcat(radius, 0, 0))
        model.shape("post", "box", (0.1, 0.1, 1), at=(0, 0, 0.5), color="#9A9A9A")
        rim = ca.vertcat(0, 0, 1) + turn @ ca.vertcat(radius, 0, 0)
        model.arrow("pull", rim, turn @ ca.vertcat(-radius * speed**2, 0, 0), "on the rim")
        model.arrow("twist", SX.zeros(3), ca.vertcat(0, 0, speed), "of the drive", unit="N.m")
        model.trace("rim", rim)
    return model.freeze()
