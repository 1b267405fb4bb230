"""Accelerations of the double pendulum from sources that share no equation with the product.

An oracle is made for one set of parameters and called with rotations R1, R2 (3, 3) from link to
world, the link along its -z, and angular velocities w1, w2 (3,) in the links, rad/s; it returns
their time derivatives in the links, rad/s2.
"""

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

Array = NDArray[np.float64]
Oracle = Callable[[Array, Array, Array, Array], tuple[Array, Array]]
UP = np.array([0.0, 0.0, 1.0])


def lagrange(length: float, m: float, diameter: float, g: float) -> Oracle:
    """Lagrange's equations in body-fixed 1-2-3 angles of both links, derived by SymPy."""
    mass, force, rate_matrix, rate_drift = _lagrange_functions()

    def oracle(R1: Array, R2: Array, w1: Array, w2: Array) -> tuple[Array, Array]:
        angles = np.concatenate([_angles_123(R1), _angles_123(R2)])
        to_rates = np.array(rate_matrix(*angles))
        angles_dot = np.linalg.solve(to_rates, np.concatenate([w1, w2]))
        known = (*angles, *angles_dot)
        acceleration = np.linalg.solve(
            np.array(mass(*known, length, m, diameter, g)),
            np.array(force(*known, length, m, diameter, g)).ravel(),
        )
        w_dot = to_rates @ acceleration + np.array(rate_drift(*known)).ravel()
        return w_dot[:3], w_dot[3:]

    return oracle


def pinocchio(length: float, m: float, diameter: float, g: float) -> Oracle:
    """Articulated-body algorithm of the package pinocchio, two spherical joints."""
    pin = pytest.importorskip("pinocchio", reason="needs `pip install pin`")
    center, below = -length / 2 * UP, pin.SE3(np.eye(3), -length * UP)
    link = pin.Inertia(m, center, np.diag(_moments(length, m, diameter)))
    model = pin.Model()
    model.gravity.linear = -g * UP
    first = model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "O")
    second = model.addJoint(first, pin.JointModelSpherical(), below, "A")
    for joint in (first, second):
        model.appendBodyToJoint(joint, link, pin.SE3.Identity())
    data = model.createData()

    def chain(quaternions: list[Array], v: Array) -> Array:
        q = np.concatenate([[x, y, z, w] for w, x, y, z in quaternions])
        return np.array(pin.aba(model, data, q, v, np.zeros(6)))

    return _chained(chain)


def mujoco(length: float, m: float, diameter: float, g: float) -> Oracle:
    """Forward dynamics of the package MuJoCo, two ball joints."""
    mj = pytest.importorskip("mujoco", reason="needs `pip install mujoco`")
    moments = " ".join(f"{value!r}" for value in _moments(length, m, diameter).tolist())
    body = '<body pos="0 0 {0!r}"><joint type="ball"/><inertial pos="0 0 {1!r}" mass="{2!r}" '
    body += f'diaginertia="{moments}"/>'
    links = body.format(0.0, -length / 2, m) + body.format(-length, -length / 2, m)
    world = f'<option gravity="0 0 {-g!r}"/><worldbody>{links}</body></body></worldbody>'
    model = mj.MjModel.from_xml_string(f"<mujoco>{world}</mujoco>")
    data = mj.MjData(model)

    def chain(quaternions: list[Array], v: Array) -> Array:
        data.qpos[:], data.qvel[:] = np.concatenate(quaternions), v
        mj.mj_forward(model, data)
        return np.array(data.qacc)

    return _chained(chain)


def _moments(length: float, m: float, diameter: float) -> Array:
    return np.array([m * length**2 / 12, m * length**2 / 12, m * diameter**2 / 8])


def _chained(accelerations: Callable[[list[Array], Array], Array]) -> Oracle:
    """Convert from the relative motion of a chain of ball joints."""

    def oracle(R1: Array, R2: Array, w1: Array, w2: Array) -> tuple[Array, Array]:
        to_2 = R2.T @ R1
        relative = w2 - to_2 @ w1
        quaternions = [_quaternion(R1), _quaternion(to_2.T)]
        w_dot = accelerations(quaternions, np.concatenate([w1, relative]))
        carried = to_2 @ w_dot[:3] - np.cross(relative, to_2 @ w1)
        return w_dot[:3], w_dot[3:] + carried

    return oracle


def _quaternion(R: Array) -> Array:
    """Return (w, x, y, z) from the eigenvector of Bar-Itzhack's matrix."""
    K = np.array(
        [
            [np.trace(R), R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]],
            [0, R[0, 0] - R[1, 1] - R[2, 2], R[0, 1] + R[1, 0], R[0, 2] + R[2, 0]],
            [0, 0, R[1, 1] - R[0, 0] - R[2, 2], R[1, 2] + R[2, 1]],
            [0, 0, 0, R[2, 2] - R[0, 0] - R[1, 1]],
        ]
    )
    vector: Array = np.linalg.eigh(K, UPLO="U")[1][:, -1]
    return vector


def _angles_123(R: Array) -> Array:
    return np.array(
        [np.arctan2(-R[1, 2], R[2, 2]), np.arcsin(R[0, 2]), np.arctan2(-R[0, 1], R[0, 0])]
    )


@cache
def _lagrange_functions() -> list[Callable[..., list[list[float]]]]:
    import sympy as sp

    length, m, diameter, g = sp.symbols("length m diameter g")
    angles, rates = sp.Matrix(sp.symbols("a:6")), sp.Matrix(sp.symbols("b:6"))
    moments = sp.diag(m * length**2 / 12, m * length**2 / 12, m * diameter**2 / 8)
    joint, kinetic, potential, omegas = sp.zeros(3, 1), 0, 0, []
    for k in (0, 3):
        a, b, c = angles[k : k + 3]
        # sp.rot_axis turns the other way round
        R = sp.rot_axis1(-a) * sp.rot_axis2(-b) * sp.rot_axis3(-c)
        spin = R.T * sum((R.diff(angles[k + i]) * rates[k + i] for i in range(3)), sp.zeros(3))
        omega = sp.Matrix([spin[2, 1], spin[0, 2], spin[1, 0]]).applyfunc(sp.trigsimp)
        center = joint - R[:, 2] * length / 2
        velocity = center.jacobian(angles) * rates
        kinetic += (m * velocity.dot(velocity) + omega.dot(moments * omega)) / 2
        potential += m * g * center[2]
        joint -= R[:, 2] * length
        omegas.append(omega)
    momenta = sp.Matrix([kinetic.diff(v) for v in rates])
    force = sp.Matrix([(kinetic - potential).diff(x) for x in angles])
    omega = sp.Matrix.vstack(*omegas)
    matrix = omega.jacobian(rates)
    state, data = [*angles, *rates], [length, m, diameter, g]
    return [
        sp.lambdify([*state, *data], momenta.jacobian(rates), cse=True),
        sp.lambdify([*state, *data], force - momenta.jacobian(angles) * rates, cse=True),
        sp.lambdify([*angles], matrix, cse=True),
        sp.lambdify(state, omega.jacobian(angles) * rates, cse=True),
    ]
