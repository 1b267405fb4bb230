"""The bicycle from positions and rotation matrices alone, and its published numbers.

Nothing here comes from the model's files: the steering axis passes through the ground at w + c,
every body is carried along by rotation matrices, rates come from differentiating places.
"""

from functools import cache

import casadi as ca
import numpy as np
from casadi import SX
from scipy.optimize import brentq

ANGLES = ("phi", "thetaR", "delta", "psi", "theta", "thetaF")
RATES = tuple(f"{name}_dot" for name in ANGLES)
ACCELERATIONS = tuple(f"{name}_dot" for name in RATES)
BENCHMARK = {  # Meijaard et al. 2007, table 1
    **{"w": 1.02, "c": 0.08, "lambda": np.pi / 10, "rR": 0.3, "rF": 0.35, "g": 9.81},
    **{"mA": 2.0, "mB": 85.0, "mC": 4.0, "mD": 3.0},
    **{"IAxx": 0.0603, "IAyy": 0.12, "IDxx": 0.1405, "IDyy": 0.28},
    **{"IBxx": 9.2, "IBxz": 2.4, "IByy": 11.0, "IBzz": 2.8},
    **{"ICxx": 0.05892, "ICxz": -0.00756, "ICyy": 0.06, "ICzz": 0.00708},
    **{"xGB": 0.3, "zGB": -0.9, "xGC": 0.9, "zGC": -0.7},
}

# Meijaard et al. 2007, section 5: M q'' + v C1 q' + (g K0 + v^2 K2) q = f, q = (lean, steer)
M = np.array([[80.81722, 2.31941332208709], [2.31941332208709, 0.29784188199686]])
C1 = np.array([[0, 33.86641391492494], [-0.85035641456978, 1.68540397397560]])
K0 = np.array([[-80.95, -2.59951685249872], [-2.59951685249872, -0.80329488458618]])
K2 = np.array([[0, 76.59734589573222], [0, 2.65431523794604]])
WEAVE_SPEED, WEAVE_FREQUENCY = 4.29238253634111, 3.43503384866144  # m/s, rad/s
CAPSIZE_SPEED, DOUBLE_ROOT_SPEED = 6.02426201538837, 0.68428307889246  # m/s

# Basu-Mandal et al. 2007, table 1, in the book's letters: psi = -theta, phi = pi/2 - psi,
# theta = pi - phi, delta = -psi_f, thetaR = -beta_r, thetaF = -beta_f of the paper
TABLE_1 = {
    "phi": np.pi / 2 - 0.9501292851472,
    "theta": np.pi - 3.1257073014894,
    "delta": -0.2311385135743,
    "psi_dot": -0.7830033527065,
    "phi_dot": -0.6068425835418,
    "theta_dot": 0.0119185528069,
    "delta_dot": -0.4859824687093,
    "thetaR_dot": -8.9129896614890,
    "thetaF_dot": -8.0133620584155,
}
TABLE_1_ACCELERATIONS = {
    "psi_dot_dot": -0.8353281706379,
    "phi_dot_dot": 7.8555281128244,
    "theta_dot_dot": -0.1205543897884,
    "delta_dot_dot": 4.6198904039403,
    "thetaR_dot_dot": -1.8472554144217,
    "thetaF_dot_dot": -2.4548072904550,
}


@cache
def newton_euler():
    """Return the loads that Newton's and Euler's laws demand, as a CasADi function.

    Inputs: q (6 angles, xP, yP), u (6 rates), a (6 accelerations), p (in BENCHMARK's order).
    Outputs: force and moment about P on the whole bicycle, moments on the wheels about their axles
    and on the front assembly about the steering axis, all besides gravity; arms and directions;
    energies; d(slip)/du of the front wheel, (3, 6). N, m, J; in the ground's axes.
    """
    q, u, a = SX.sym("q", 8), SX.sym("u", 6), SX.sym("a", 6)
    symbols = {name: SX.sym(name) for name in BENCHMARK}
    p = symbols
    phi, thetaR, delta, psi, theta, thetaF = ca.vertsplit(q)[:6]
    e1, e2, e3 = ca.horzsplit(SX.eye(3))
    speed = -p["rR"] * (u[1] + u[4])  # P is always below the axle
    q_dot = ca.vertcat(u, speed * ca.cos(psi), speed * ca.sin(psi))

    def turn(axis, angle):  # Rodrigues
        return (
            ca.cos(angle) * SX.eye(3)
            + ca.sin(angle) * ca.skew(axis)
            + (1 - ca.cos(angle)) * (axis @ axis.T)
        )

    def rate(expression):
        return ca.jtimes(expression, ca.vertcat(q, u), ca.vertcat(q_dot, a))

    def spin(matrix):  # angular velocity: the skew matrix of it is dR/dt R^T
        turning = ca.reshape(rate(ca.vec(matrix)), 3, 3) @ matrix.T
        return ca.vertcat(turning[2, 1], turning[0, 2], turning[1, 0])

    heading = turn(e3, psi)
    R_B = heading @ turn(e1, phi) @ turn(e2, theta)
    steering_axis = ca.vertcat(ca.sin(p["lambda"]), 0, ca.cos(p["lambda"]))
    R_C = R_B @ turn(steering_axis, delta)
    r_P = ca.vertcat(q[6:8], 0)
    axle = r_P - p["rR"] * heading @ turn(e1, phi) @ e3
    on_axis = ca.vertcat(p["w"] + p["c"], 0, 0)
    rear_axle = ca.vertcat(0, 0, -p["rR"])
    at_axis = axle + R_B @ (on_axis - rear_axle)

    def fork_point(x, z):
        return at_axis + R_C @ (ca.vertcat(x, 0, z) - on_axis)

    R_D = R_C @ turn(e2, thetaF)
    hub = fork_point(p["w"], -p["rF"])
    across = R_C @ e2
    to_Q = e3 - across * across[2]
    r_Q = hub + p["rF"] * to_Q / ca.norm_2(to_Q)

    def body(letter, place, carrier, attitude):
        xx, yy = p[f"I{letter}xx"], p[f"I{letter}yy"]
        zz, xz = p.get(f"I{letter}zz", xx), p.get(f"I{letter}xz", SX(0))
        inertia = ca.blockcat([[xx, 0, xz], [0, yy, 0], [xz, 0, zz]])
        momentum = carrier @ inertia @ carrier.T @ spin(attitude)
        mass, velocity = p[f"m{letter}"], rate(place)
        demand = mass * (rate(velocity) - p["g"] * e3)
        kinetic = (mass * ca.dot(velocity, velocity) + ca.dot(spin(attitude), momentum)) / 2
        return place, demand, rate(momentum), kinetic, -mass * p["g"] * place[2]

    bodies = [
        body("A", axle, R_B, R_B @ turn(e2, thetaR)),
        body("B", axle + R_B @ (ca.vertcat(p["xGB"], 0, p["zGB"]) - rear_axle), R_B, R_B),
        body("C", fork_point(p["xGC"], p["zGC"]), R_C, R_C),
        body("D", hub, R_C, R_D),
    ]

    def moment(about, parts):
        return sum((ca.cross(r - about, f) + h for r, f, h, *_ in parts), SX.zeros(3))

    axis = R_B @ steering_axis
    results = {
        "force": sum((f for _, f, *_ in bodies), SX.zeros(3)),
        "moment": moment(r_P, bodies),
        "rear_axle_moment": ca.dot(R_B @ e2, bodies[0][2]),
        "front_axle_moment": ca.dot(across, bodies[3][2]),
        "steering_moment": ca.dot(axis, moment(at_axis, bodies[2:])),
        "PQ": r_Q - r_P,
        "axis_to_Q": r_Q - at_axis,
        "hub_to_Q": r_Q - hub,
        "axle_to_P": r_P - axle,
        "rear_axle": R_B @ e2,
        "front_axle": across,
        "steering_axis": axis,
        "roll_axis": heading @ e1,
        "kinetic": sum(b[3] for b in bodies),
        "potential": sum(b[4] for b in bodies),
        "rolling": ca.jacobian(rate(hub) + ca.cross(spin(R_D), r_Q - hub), u),
    }
    inputs = [q, u, a, ca.vertcat(*symbols.values())]
    names = ["q", "u", "a", "p"], list(results)
    return ca.Function("newton_euler", inputs, list(results.values()), *names, {"cse": True})


def admissible_state(rng, parameters):
    """Return angles, path and rates by name: the front wheel touches the ground and rolls.

    Args:
        rng: Source of roll up to 0.7 rad, steer up to 1.2 rad, rates up to 3 and 20 rad/s.
        parameters: In BENCHMARK's order.
    """
    phi, delta, psi = rng.uniform([-0.7, -1.2, -3.0], [0.7, 1.2, 3.0])
    thetaR, thetaF, xP, yP = rng.uniform(-10.0, 10.0, 4)

    def at(theta):
        q = [phi, thetaR, delta, psi, theta, thetaF, xP, yP]
        return newton_euler()(q=q, u=0, a=0, p=parameters)

    theta = brentq(lambda theta: float(at(theta)["PQ"][2]), -0.4, 0.4, xtol=1e-15)
    independent = rng.uniform([-3.0, -20.0, -3.0], [3.0, 20.0, 3.0])
    rolling = at(theta)["rolling"].full()
    dependent = -np.linalg.solve(rolling[:, 3:], rolling[:, :3] @ independent)
    values = [phi, thetaR, delta, psi, theta, thetaF, xP, yP, *independent, *dependent]
    return dict(zip([*ANGLES, "xP", "yP", *RATES], values, strict=True))


def published(speed):
    """Return A of x' = A x, x = (lean, steer, rates), from the published matrices at a speed."""
    stiffness = 9.81 * K0 + speed**2 * K2
    return np.block(
        [
            [np.zeros((2, 2)), np.eye(2)],
            [-np.linalg.solve(M, stiffness), -np.linalg.solve(M, speed * C1)],
        ]
    )
