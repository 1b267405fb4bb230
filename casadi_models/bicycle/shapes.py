"""Drawing of the bicycle: N3 is down, the ground is the plane N1 N2."""

import casadi as ca
from casadi import SX, cos, sin

from casadi_models.dae import Model
from casadi_models.dae.scenery import BLUE, DARK, GRAY, GREEN, ORANGE, PINK, SKY
from casadi_models.mechanics.rotations import about, unit

_TUBE, _TYRE = 0.016, 0.022  # m, radii
_BAR, _GRIP = 0.34, 0.2  # m, of the handlebar above S, of the hands from its middle
_SHOULDER = 0.14  # m, from the neck
_HALF_ARM = 0.9  # of the distance from shoulder to hand; two overlap, as this distance changes


def draw(model: Model) -> None:
    """Declare wheels, frame with rider, fork, the ground's forces and the paths of P and Q."""
    phi, delta, psi, theta = map(model.named, ("phi", "delta", "psi", "theta"))
    rR, rF, w, c, tilt = map(model.named, ("rR", "rF", "w", "c", "lambda"))
    P = ca.vertcat(model.named("xP"), model.named("yP"), 0)

    # Heading and roll, then pitch; tilt and steer lead to the fork (Unit 7, Example 3)
    heading = about(3, psi) @ about(1, phi)
    frame = heading @ about(2, theta)
    fork = frame @ about(2, tilt) @ about(3, delta)
    rear_axle = P - rR * heading @ unit(3)
    S = ((w + c) * cos(tilt) - rR * sin(tilt)) * unit(1)  # nearest to the axle, in tilted axes
    to_S = about(2, tilt) @ S  # from the axle, in B
    at_S = rear_axle + frame @ to_S
    hub = about(2, tilt).T @ (ca.vertcat(w, 0, rR - rF) - to_S)  # from S, in C
    front_axle = at_S + fork @ hub

    down = fork[2, :].T  # N3 in C; the contact lies below the hub in the plane of the wheel
    in_plane = ca.vertcat(down[0], 0, down[2]) / ca.sqrt(down[0] ** 2 + down[2] ** 2)
    Q = front_axle + rF * fork @ in_plane

    model.world(
        up=(0, 0, -1), forward=(1, 0, 0), axes=("N1", "N2", "N3"), ground=True, follow="rear frame"
    )
    model.body("rear wheel", rear_axle, frame @ about(2, model.named("thetaR")))
    model.body("rear frame", rear_axle, frame)
    model.body("fork", at_S, fork)
    model.body("front wheel", front_axle, fork @ about(2, model.named("thetaF")))
    for wheel, radius in (("rear wheel", rR), ("front wheel", rF)):
        size = ca.vertcat(radius, _TYRE)
        model.shape("wheel", "wheel", size, body=wheel, along=unit(2), color=DARK)
    neck = _frame(model, w, rR, to_S, tilt)
    _fork(model, rR, hub)
    bar = -_BAR * unit(3)  # from S, in C
    for side, right in (("left", -1), ("right", 1)):
        shoulder, hand = neck + _SHOULDER * right * unit(2), bar + _GRIP * right * unit(2)
        reach = _HALF_ARM * ca.norm_2(to_S + about(2, tilt) @ hand - shoulder)  # at delta = 0
        ends = rear_axle + frame @ shoulder, at_S + fork @ hand
        _arm(model, side, ends, frame[:, 1], reach)

    for point, place, wheel in (("P", P, "rear"), ("Q", Q, "front")):
        force = ca.vertcat(*(model.named(f"f{axis}_{point}") for axis in "xyz"))
        meaning = f"force of the ground on the {wheel} wheel"
        model.arrow(f"force at {point}", place, force, meaning, color=ORANGE)
    model.trace("path of P", P, color=BLUE)
    model.trace("path of Q", Q, color=PINK)


def _frame(model: Model, w: SX, rR: SX, to_S: SX, tilt: SX) -> SX:
    """Draw frame and rider without arms; return the neck.

    Points from the rear axle, in B, as parts of the wheelbase.
    """

    def point(forward: float, up: float) -> SX:
        return ca.vertcat(forward * w, 0, rR - up * w)

    axle, crank, saddle = SX.zeros(3), point(0.42, 0.28), point(0.2, 0.82)
    head = to_S - 0.16 * w * (about(2, tilt) @ unit(3))
    hip, neck = point(0.2, 0.86), point(0.45, 1.38)
    tubes = ((axle, crank), (axle, saddle), (crank, saddle), (crank, head), (saddle, head))
    for i, ends in enumerate(tubes, start=1):
        model.rod(f"tube {i}", ends, _TUBE, body="rear frame", color=BLUE)
    model.rod("trunk of the rider", (hip, neck), 0.1, body="rear frame", color=SKY)
    for side, right in (("left", -1), ("right", 1)):
        aside = 0.1 * right * unit(2)
        leg = hip + aside, crank + aside
        model.rod(f"{side} leg of the rider", leg, 0.05, body="rear frame", color=SKY)
    shoulders = neck - _SHOULDER * unit(2), neck + _SHOULDER * unit(2)
    model.rod("shoulders of the rider", shoulders, 0.05, body="rear frame", color=SKY)
    model.shape("head of the rider", "sphere", SX(0.1), body="rear frame",
                at=point(0.5, 1.55), color=SKY)  # fmt: skip
    return neck


def _arm(model: Model, side: str, ends: tuple[SX, SX], aside: SX, reach: SX) -> None:
    """Draw an arm as two rods, from shoulder and hand toward each other; points in the world.

    Args:
        model: The model.
        side: "left" or "right".
        ends: Shoulder and hand.
        aside: The second axis of the rear frame.
        reach: Length of a rod.
    """
    along = ends[1] - ends[0]
    third = along / ca.norm_2(along)
    first = ca.cross(aside, third)
    first /= ca.norm_2(first)
    axes = ca.horzcat(first, ca.cross(third, first), third)
    for owner, end, length in (("rear frame", ends[0], reach), ("fork", ends[1], -reach)):
        rod = SX.zeros(3), length * unit(3)
        body = model.body(f"{owner}/{side} arm", end, axes)
        model.rod(f"{side} arm of the rider", rod, 0.035, body=body, color=SKY)


def _fork(model: Model, rR: SX, hub: SX) -> None:
    """Draw fork and handlebar; points from S, in C."""
    crown, top = ca.vertcat(0, 0, -0.05), ca.vertcat(0, 0, -_BAR)
    model.rod("blade", (hub, crown), _TUBE, body="fork", color=GREEN)
    model.rod("steering axis", (crown, top), _TUBE, body="fork", color=GREEN)
    ends = top - 0.26 * unit(2), top + 0.26 * unit(2)
    model.rod("handlebar", ends, _TUBE, body="fork", color=GREEN)
    model.rod("axle", (hub - 0.06 * unit(2), hub + 0.06 * unit(2)), 0.01, body="fork", color=GRAY)
