"""A bicycle that coasts over a bump in its plane of symmetry: wheels lift off, fly and land.

  z ^           .-.     q = (x, z, theta, sA, sD): mass center of all bodies, pitch angle (nose up),
    |   A--G--D            and the points of the ground that are nearest to the two axles
    +--------------> x  u = (x_dot, z_dot, theta_dot, spinA, spinD), with the spins of both wheels

Model   Rigid wheels on smooth ground; rider and straight fork fixed to the frame; no air, no drive.
        A wheel on the ground rolls without slip, whatever friction that takes. When the normal
        force becomes 0, there is no friction either: the wheel loses grip, until it lands again;
        when the normal force becomes 0 once more, it lifts off. It lands without rebound and
        rolls: M (u+ - u-) = W P, and W^T u+ = 0 for the wheels on the ground.
Source  Benchmark bicycle: Meijaard et al., Proc. R. Soc. A 463, 2007. Impacts: Glocker, Set-Valued
        Force Laws, Springer 2001.
"""

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
from casadi import SX, cos, sin

from casadi_models.bicycle.declaration import PARAMETERS
from casadi_models.dae import Dae, Model
from casadi_models.dae.scenery import BLUE, DARK, GRAY, ORANGE, SKY
from casadi_models.mechanics.rotations import about

VALUE = {name: data[1] for name, data in PARAMETERS.items()}  # SI units
SPEED = 7.0  # m/s, at the start
NAMES = {"A": "rear wheel", "D": "front wheel"}
RADIUS = {"A": VALUE["rR"], "D": VALUE["rF"]}  # m
MASS = {body: VALUE[f"m{body}"] for body in "ABCD"}  # kg; wheel A, frame B, fork C, wheel D
CENTER = {  # forward of the rear wheel's lowest point and above it, m; level bicycle
    "A": np.array([0.0, VALUE["rR"]]),
    "B": np.array([VALUE["xGB"], -VALUE["zGB"]]),
    "C": np.array([VALUE["xGC"], -VALUE["zGC"]]),
    "D": np.array([VALUE["w"], VALUE["rF"]]),
}
TOTAL = sum(MASS.values())
G = sum((MASS[body] * CENTER[body] for body in "ABCD"), np.zeros(2)) / TOTAL
# In pitch about G, kg.m2; the wheels count as points, since their spins are speeds of their own
PITCH_INERTIA = VALUE["IByy"] + VALUE["ICyy"]
PITCH_INERTIA += sum(MASS[body] * float(((CENTER[body] - G) ** 2).sum()) for body in "ABCD")
M = ca.diag(ca.vertcat(TOTAL, TOTAL, PITCH_INERTIA, VALUE["IAyy"], VALUE["IDyy"]))

CLEARANCE = 1e-9  # m; a wheel that has lifted off lands when it is this far below that place
NEVER = -1.0  # m; below every gap
STUCK = 1e6  # N; more than every normal force


def build() -> Dae:
    """Return the ODE: 10 states in m, rad and s, and 9 variables that events change."""
    model = Model(
        "bicycle_jump",
        description="bicycle that jumps off a bump",
        stop_time=1.0,
        output_interval=0.005,
    )
    height = model.parameter("height", "m", 0.1, "height of the bump")
    width = model.parameter("width", "m", 0.4, "half width of the bump at 1/e of its height")
    top = model.parameter("top", "m", 3.5, "place of the bump's top")
    g = model.parameter("g", "m/s2", VALUE["g"], "gravity")
    x = model.state("x", "m", float(G[0]), "mass center, forward")
    z = model.state("z", "m", float(G[1]), "mass center, up")
    theta = model.state("theta", "rad", 0.0, "pitch angle, nose up")
    s = {
        wheel: model.state(
            f"s{wheel}", "m", float(CENTER[wheel][0]), f"ground nearest to the {name}"
        )
        for wheel, name in NAMES.items()
    }
    u = ca.vertcat(
        model.state("x_dot", "m/s", SPEED, "rate of x"),
        model.state("z_dot", "m/s", 0.0, "rate of z"),
        model.state("theta_dot", "rad/s", 0.0, "rate of theta"),
    )
    spin = {
        wheel: model.state(f"spin{wheel}", "rad/s", SPEED / RADIUS[wheel], f"spin of the {name}")
        for wheel, name in NAMES.items()
    }
    for wheel, radius in RADIUS.items():
        model.start(spin[wheel], u[0] / radius, f"the {NAMES[wheel]} rolls on level ground")
    u = ca.vertcat(u, *spin.values())
    q = ca.vertcat(x, z, theta, *s.values())

    def ground(at: Any) -> SX:
        return height * ca.exp(-(((at - top) / width) ** 2))

    # Velocities of each wheel's lowest point along the ground's normal and tangent, rates of sA, sD
    turn = ca.blockcat([[cos(theta), -sin(theta)], [sin(theta), cos(theta)]])
    gaps, velocities, s_dot = {}, [], []
    for wheel, r in RADIUS.items():
        arm = turn @ ca.DM(CENTER[wheel] - G)
        axle = ca.vertcat(x, z) + arm
        velocity = u[:2] + u[2] * ca.vertcat(-arm[1], arm[0])
        slope = ca.jacobian(ground(s[wheel]), s[wheel])
        length = ca.sqrt(1 + slope**2)
        normal, tangent = ca.vertcat(-slope, 1) / length, ca.vertcat(1, slope) / length
        curvature = ca.jacobian(slope, s[wheel]) / length**3
        along = ca.dot(tangent, velocity)
        gaps[wheel] = ca.dot(normal, axle - ca.vertcat(s[wheel], ground(s[wheel]))) - r
        velocities += [ca.dot(normal, velocity), along - r * spin[wheel]]
        s_dot.append(along / (length * (1 - (r + gaps[wheel]) * curvature)))
    v = ca.vertcat(*velocities)
    W = ca.jacobian(v, u).T

    # Newton and Euler: M u' = f + W P; closed directions keep W^T u = 0, the others have P = 0
    mode = {
        wheel: [
            model.discrete(
                f"contact{wheel}", "1", 1.0, f"1 if the {name} is on the ground, else 0"
            ),
            model.discrete(f"grip{wheel}", "1", 1.0, f"1 if the {name} rolls, else 0"),
        ]
        for wheel, name in NAMES.items()
    }
    closed = ca.vertcat(*mode["A"], *mode["D"])

    def reactions(velocity: SX, closed: SX) -> SX:
        """Return P along W that takes away this velocity, or this acceleration."""
        matrix = (closed @ closed.T) * (W.T @ ca.solve(M, W)) + ca.diag(1 - closed)
        return ca.solve(matrix, -closed * velocity)

    q_dot = ca.vertcat(u[:3], *s_dot)
    f = ca.vertcat(0, -TOTAL * g, 0, 0, 0)
    P = reactions(W.T @ ca.solve(M, f) + ca.jtimes(v, q, q_dot), closed)
    model.derivative(q, q_dot)
    model.derivative(u, ca.solve(M, f + W @ P))

    loss = model.discrete("loss", "J", 0.0, "kinetic energy lost in impacts", nominal=100.0)
    floor, impulse = {}, []
    for wheel, name in NAMES.items():
        floor[wheel] = model.discrete(f"floor{wheel}", "m", NEVER, f"gap at which the {name} lands")
        meaning = f"last one on the {name}"
        impulse.append(model.discrete(f"impulse{wheel}", "N.s", 0.0, meaning, nominal=100.0))
    for i, (wheel, name) in enumerate(NAMES.items()):
        contact, grip = mode[wheel]
        normal = P[2 * i]
        model.when(normal + 1 - grip < 0, {grip: 0}, name=f"{name} loses grip")
        model.when(
            normal + STUCK * grip + 1 - contact < 0,
            {contact: 0, floor[wheel]: gaps[wheel] - CLEARANCE},
            name=f"{name} lifts off",
        )
        landed = SX(closed)
        landed[2 * i : 2 * i + 2] = 1
        J = reactions(v, landed)
        after = ca.vertsplit(u + ca.solve(M, W @ J))
        new = dict(zip(ca.vertsplit(u), after, strict=True))
        new |= {contact: 1, grip: 1, floor[wheel]: NEVER, loss: loss - ca.dot(J, v) / 2}
        new |= dict(zip(impulse, (J[0], J[2]), strict=True))
        model.when(gaps[wheel] < floor[wheel], new, name=f"{name} lands")
        model.output(f"normal{wheel}", "N", normal, f"normal force on the {name}", nominal=100.0)
        model.output(
            f"friction{wheel}", "N", P[2 * i + 1], f"friction on the {name}", nominal=100.0
        )
        model.output(f"gap{wheel}", "m", gaps[wheel], f"from the ground to the {name}")
    model.energies(ca.dot(u, M @ u) / 2, TOTAL * g * z, nominal=1000.0)
    _draw(model, ca.vertcat(x, 0, z), about(2, -theta), ground)
    return model.freeze()


def _draw(model: Model, center: SX, rotation: SX, ground: Callable[[Any], SX]) -> None:
    """Declare the ground, the frame with its rider, the wheels, and the path of the mass center."""
    model.world(forward=(1, -0.6, 0))
    places = np.concatenate(([0.0], np.linspace(2.5, 4.5, 41), [8.0]))  # m
    points = ca.horzcat(*(ca.vertcat(place, 0, ground(place)) for place in places))
    model.shape("ground", "line", points, color=GRAY)
    model.body("frame", center, rotation)

    def point(forward: float, up: float) -> ca.DM:  # from the rear wheel's lowest point, m
        return ca.DM([forward - float(G[0]), 0, up - float(G[1])])

    for wheel, name in NAMES.items():
        at = point(*CENTER[wheel])
        size = [RADIUS[wheel], 0.022]
        model.shape(name, "wheel", size, body="frame", at=at, along=(0, 1, 0), color=DARK)
    axle, hub = (point(*CENTER[wheel]) for wheel in "AD")
    crank, saddle, head = point(0.43, 0.28), point(0.2, 0.9), point(0.8, 0.85)
    hip, neck, crown = point(0.2, 0.98), point(0.5, 1.5), point(0.56, 1.7)
    ends = ((axle, crank), (axle, saddle), (crank, saddle), (crank, head), (saddle, head))
    for i, (start, end) in enumerate((*ends, (head, hub)), start=1):
        model.rod(f"tube {i}", (start, end), 0.016, body="frame", color=BLUE)
    for name, start, end in (("trunk", hip, neck), ("leg", hip, crank), ("arm", neck, head)):
        model.rod(name, (start, end), 0.05, body="frame", color=SKY)
    model.shape("head", "sphere", [0.1], body="frame", at=crown, color=SKY)
    model.trace("path of the mass center", center, color=ORANGE)
