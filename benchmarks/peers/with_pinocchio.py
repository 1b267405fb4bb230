"""pinocchio: the articulated-body algorithm, two spherical joints.

A call computes the joint accelerations and nothing else.
"""

from collections.abc import Iterator

import numpy as np
import pinocchio as pin
from chain import UP, chain
from entries import Evaluation
from problem import Problem

PACKAGES = ("pin",)


def accelerations(problem: Problem) -> Iterator[Evaluation]:
    known = chain(problem)
    link = pin.Inertia(known.m, -known.length / 2 * UP, np.diag(known.moments))
    below = pin.SE3(np.eye(3), -known.length * UP)
    model = pin.Model()
    model.gravity.linear = -known.g * UP
    first = model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "O")
    second = model.addJoint(first, pin.JointModelSpherical(), below, "A")
    for joint in (first, second):
        model.appendBodyToJoint(joint, link, pin.SE3.Identity())
    data, pool = model.createData(), pin.ModelPool(model, 1)
    order = [1, 2, 3, 0, 5, 6, 7, 4]  # x y z w
    q = np.asfortranarray(known.quaternions[:, order].T)
    v, load = np.asfortranarray(known.rates.T), np.zeros(6)
    loads, results = np.zeros_like(v), np.zeros_like(v)
    pin.abaInParallel(1, pool, q, v, loads, results)
    print(f"pinocchio: {known.difference(results.T):.0e} from the equations")
    yield Evaluation(
        "pinocchio aba",
        lambda: pin.abaInParallel(1, pool, q, v, loads, results),
        q.shape[1],
    )
    q0, v0 = q[:, 0].copy(), v[:, 0].copy()
    yield Evaluation("pinocchio aba", lambda: pin.aba(model, data, q0, v0, load), one=True)
