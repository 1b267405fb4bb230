"""The double pendulum's states as those of a chain of two ball joints, for packages of bodies.

Their coordinates are the first link's quaternion and rates and those of the second relative to it;
the equations' states are absolute. Converting is not timed.
"""

from dataclasses import dataclass

import numpy as np
from entries import Vector
from problem import Problem

UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Chain:
    """Link's numbers and states of the chain, N of them.

    Attributes:
        length, m, g: m, kg, m/s2.
        moments: Of a link about its center, along its axes, kg.m2, (3,).
        quaternions: (w, x, y, z) of both joints, (N, 8).
        rates: Both angular velocities in the links' axes, rad/s, (N, 6).
        expected: Their time derivatives from the model's equations, (N, 6).
    """

    length: float
    m: float
    g: float
    moments: Vector
    quaternions: Vector
    rates: Vector
    expected: Vector

    def difference(self, accelerations: Vector) -> float:
        """Return how far accelerations are from those of the equations, relative to the largest."""
        return float(np.abs(accelerations - self.expected).max() / np.abs(self.expected).max())


def chain(problem: Problem) -> Chain:
    """Return the chain at the problem's states, quaternions made unit ones."""
    known = dict(
        zip((v.name for v in problem.dae.parameters), problem.start["p"].tolist(), strict=True)
    )
    names = [v.name for v in problem.dae.states]
    x = problem.states.copy()

    def columns(prefix: str, parts: str) -> list[int]:
        return [names.index(f"{prefix}_{part}") for part in parts]

    for body in (1, 2):
        where = columns(f"q{body}", "wxyz")
        x[:, where] /= np.linalg.norm(x[:, where], axis=1)[:, None]
    rates = np.array(problem.rhs.map(len(x))(0.0, x.T)).T
    w1, w2 = (x[:, columns(f"w{body}", "xyz")] for body in (1, 2))
    dw1, dw2 = (rates[:, columns(f"w{body}", "xyz")] for body in (1, 2))
    q1, q2 = (x[:, columns(f"q{body}", "wxyz")] for body in (1, 2))
    relative = _product(q1 * [1.0, -1.0, -1.0, -1.0], q2)  # link 2 to link 1
    carried = _resolved(relative, w1)
    joint_rates = w2 - carried
    joint_acceleration = dw2 - _resolved(relative, dw1) + np.cross(joint_rates, carried)
    length, m = known["length"], known["m"]
    across = m * length**2 / 12
    return Chain(
        length,
        m,
        known["g"],
        np.array([across, across, m * known["diameter"] ** 2 / 8]),
        np.hstack((q1, relative)),
        np.hstack((w1, joint_rates)),
        np.hstack((dw1, joint_acceleration)),
    )


def _product(a: Vector, b: Vector) -> Vector:
    scalar = a[:, 0] * b[:, 0] - (a[:, 1:] * b[:, 1:]).sum(axis=1)
    vector = a[:, :1] * b[:, 1:] + b[:, :1] * a[:, 1:] + np.cross(a[:, 1:], b[:, 1:])
    return np.column_stack((scalar, vector))


def _resolved(q: Vector, v: Vector) -> Vector:
    """Return vectors in the axes that the quaternions lead from."""
    twice = 2 * np.cross(-q[:, 1:], v)
    return v + q[:, :1] * twice + np.cross(-q[:, 1:], twice)
