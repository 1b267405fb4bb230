"""Motion of the bicycle as two gyrostats: velocities, rolling, heights, inertia.

Each wheel forms a gyrostat with the body that carries it: A with B, D with C. Axes of resolution:

  H  heading of the rear wheel, its axle, down in its plane;
  E  fixed in the rear frame, e3 along the steering axis: pitch and tilt from H;
  C  fixed in the fork, c3 = e3: the steer angle from E;
  W  heading of the front wheel, its axle (c2), down in its plane.
"""

from typing import NamedTuple

import casadi as ca
from casadi import SX, cos, sin

from casadi_models.bicycle.declaration import Bicycle, Body, Torques
from casadi_models.bicycle.loads import Carried, loads
from casadi_models.mechanics import kane, rotations


class Motion(NamedTuple):
    """Kinematics and loads from which the formulations are built.

    Attributes:
        system: Six free speeds; the rear contact P is held by three speeds along N1, N2, N3.
        slip: Velocity of the front wheel's material at its contact Q, in W, m/s.
        W_to_C, C_to_N: Rotation matrices.
        closure: Depth of Q below the ground, m.
        potential: Energy of gravity, zero at the ground, J.
        path_rate: Velocity of the contact point P along N1, N2, m/s.
        speed: The same along the heading of the rear wheel, m/s.
    """

    system: kane.System
    slip: SX
    W_to_C: SX
    C_to_N: SX
    closure: SX
    potential: SX
    path_rate: SX
    speed: SX

    def residuals(self) -> SX:
        """Return loop closure (m) and slip in C (m/s), all zero in an admissible state, (4, 1)."""
        return ca.vertcat(self.closure, self.W_to_C @ self.slip)


class _Frame(NamedTuple):
    """Rear frame: orientation, angular velocity, velocity of the axle; both in E."""

    to_N: SX
    omega: SX
    v_axle: SX


def motion(bike: Bicycle, torques: Torques, q: SX, u: SX) -> Motion:
    """Return the motion in terms of coordinates and speeds.

    Args:
        bike, torques: Parameters and inputs.
        q: phi, thetaR, delta, psi, theta, thetaF, rad.
        u: Their rates, rad/s.
    """
    phi, _, delta, psi, _, _ = ca.vertsplit(q)
    _, thetaR_dot, delta_dot, _, theta_dot, thetaF_dot = ca.vertsplit(u)

    # Constants, turned into E once; S is the point of the steering axis nearest to the axle
    B_to_E = rotations.about(2, bike.tilt).T
    axle = bike.rear_wheel.center
    S = ((bike.w + bike.c) * cos(bike.tilt) - bike.rR * sin(bike.tilt)) * rotations.unit(1)
    at_S = axle + B_to_E.T @ S
    rear = _turned(_welded(bike.rear_wheel, bike.rear_frame), B_to_E, axle)
    front = _turned(_welded(bike.fork, bike.front_wheel), B_to_E, at_S)
    hub = B_to_E @ (bike.front_wheel.center - at_S)

    v_P = SX.sym("v_P", 3)  # of the rear wheel's material at P, in N; held
    frame = _rear_frame(bike, q, u, v_P)
    v_rear = frame.v_axle + ca.cross(frame.omega, rear.center)
    C_to_E = rotations.about(3, delta)
    omega = C_to_E.T @ frame.omega + delta_dot * rotations.unit(3)  # of the fork, in C
    v_S = C_to_E.T @ (frame.v_axle + ca.cross(frame.omega, S))
    v_front = v_S + ca.cross(omega, front.center)

    # Rolling: v_Q = v_hub + omega_D x rF w3, where the product has no part along w3
    down_E = frame.to_N[2, :].T
    down = C_to_E.T @ down_E  # N3 in C
    in_plane = ca.sqrt(down[0] ** 2 + down[2] ** 2)  # its part in the plane of the front wheel
    w1 = ca.vertcat(down[2], 0, -down[0]) / in_plane
    w3 = ca.vertcat(down[0], 0, down[2]) / in_plane
    W_to_C = ca.horzcat(w1, rotations.unit(2), w3)
    rolled = bike.rF * ca.vertcat(omega[1] + thetaF_dot, -ca.dot(omega, w1), 0)
    slip = W_to_C.T @ (v_S + ca.cross(omega, hub)) + rolled

    depth_axle = -bike.rR * cos(phi)
    depth_S = depth_axle + ca.dot(down_E, S)
    depth_rear = depth_axle + ca.dot(down_E, rear.center)
    depth_front = depth_S + ca.dot(down, front.center)
    speed = -bike.rR * (thetaR_dot + theta_dot)  # P keeps below the axle while the frame pitches

    axes = rotations.unit(2), rotations.unit(2)
    spins = bike.rear_wheel.inertia[1, 1], bike.front_wheel.inertia[1, 1]
    return Motion(
        system=kane.System(
            q=q,
            q_dot=u,
            free=u,
            held=v_P,
            inertias=(
                *kane.gyrostat(*rear[:2], v_rear, frame.omega, spins[0], axes[0], thetaR_dot),
                *kane.gyrostat(*front[:2], v_front, omega, spins[1], axes[1], thetaF_dot),
            ),
            loads=loads(
                bike.g,
                torques,
                u,
                Carried(rear.mass, v_rear, down_E),
                Carried(front.mass, v_front, down),
            ),
        ),
        slip=slip,
        W_to_C=W_to_C,
        C_to_N=frame.to_N @ C_to_E,
        closure=depth_S + ca.dot(down, hub) + bike.rF * in_plane,
        potential=-bike.g * (rear.mass * depth_rear + front.mass * depth_front),
        path_rate=speed * ca.vertcat(cos(psi), sin(psi)),
        speed=speed,
    )


def _rear_frame(bike: Bicycle, q: SX, u: SX, v_P: SX) -> _Frame:
    phi, _, _, psi, theta, _ = ca.vertsplit(q)
    phi_dot, thetaR_dot, _, psi_dot, theta_dot, _ = ca.vertsplit(u)
    angles = ca.vertcat(psi, phi, theta + bike.tilt)
    to_N, omega = rotations.body_fixed((3, 1, 2), angles, ca.vertcat(psi_dot, phi_dot, theta_dot))
    # The wheel turns about P: v = omega_A x (P to axle), in H, whose axis 2 is that of E
    v_axle = ca.vertcat(-bike.rR * (omega[1] + thetaR_dot), bike.rR * phi_dot, 0)
    E_to_H = rotations.about(2, theta + bike.tilt)
    return _Frame(to_N, omega, E_to_H.T @ v_axle + to_N.T @ v_P)


def _welded(a: Body, b: Body) -> Body:
    """Return two bodies as one (parallel axes theorem)."""
    mass = a.mass + b.mass
    center = (a.mass * a.center + b.mass * b.center) / mass
    inertia = a.inertia + b.inertia
    for part in (a, b):
        r = part.center - center
        inertia += part.mass * (ca.dot(r, r) * SX.eye(3) - r @ r.T)
    return Body(mass, inertia, center)


def _turned(body: Body, turn: SX, origin: SX) -> Body:
    """Return a body with its center measured from another origin, resolved in other axes."""
    return Body(body.mass, turn @ body.inertia @ turn.T, turn @ (body.center - origin))
