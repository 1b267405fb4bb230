"""The recursion against Kane's equations solved at once, and how its operations grow."""

from time import process_time

import casadi as ca
import numpy as np
import pytest
from casadi import SX
from helpers.chains import crossed_chain

from casadi_models.mechanics import kane, rotations
from casadi_models.mechanics.articulated import Link, accelerations

RNG = np.random.default_rng(11)
PARENTS = {"chain": (-1, 0, 1, 2, 3), "tree": (-1, 0, 0, 1, 1, 2), "two roots": (-1, -1, 0, 1)}


def tree(parents, q):
    """Return links of random mass, shape and axis."""
    links = []
    for i, parent in enumerate(parents):
        half = RNG.normal(size=(3, 3))
        axis = int(RNG.integers(1, 4))
        fixed = ca.DM(np.linalg.qr(RNG.normal(size=(3, 3)))[0])
        fixed *= float(np.sign(np.linalg.det(fixed.full())))
        links.append(
            Link(
                parent,
                SX(RNG.normal(size=3).tolist()),
                SX(fixed) @ rotations.about(axis, q[i]),
                rotations.unit(axis),
                float(RNG.uniform(0.5, 2)),
                SX(RNG.normal(size=3).tolist()),
                SX(ca.DM(half @ half.T + np.eye(3))),
            )
        )
    return links


def by_kane(links, q, u, torques, gravity):
    """Return the same from velocities in the bodies' axes."""
    omegas, velocities, turns, terms, loads = [], [], [], [], []
    for i, link in enumerate(links):
        if link.parent < 0:
            omega, velocity, turn = SX(3, 1), SX(3, 1), SX.eye(3)
        else:
            omega, velocity, turn = (c[link.parent] for c in (omegas, velocities, turns))
        velocities.append(link.rotation.T @ (velocity + ca.cross(omega, link.place)))
        omegas.append(link.rotation.T @ omega + link.axis * u[i])
        turns.append(turn @ link.rotation)
        center = velocities[i] + ca.cross(omegas[i], link.center)
        terms += kane.body(link.mass, link.inertia, center, omegas[i])
        loads.append(kane.Load(center, link.mass * turns[i].T @ gravity))
        loads.append(kane.Load(u[i], torques[i]))
    system = kane.System(q=q, q_dot=u, free=u, inertias=tuple(terms), loads=tuple(loads))
    return kane.accelerations(system).free


@pytest.mark.parametrize("parents", PARENTS.values(), ids=PARENTS)
def test_recursion_gives_what_kane_gives(parents):
    n = len(parents)
    q, u, torques = SX.sym("q", n), SX.sym("u", n), SX.sym("torque", n)
    gravity = SX([0.3, -9.81, 1.0])
    links = tree(parents, q)
    both = [
        ca.Function("a", [q, u, torques], [law])
        for law in (
            accelerations(links, u, torques, gravity),
            by_kane(links, q, u, torques, gravity),
        )
    ]
    for _ in range(5):
        at = [RNG.uniform(-3, 3, n) for _ in range(3)]
        found, expected = (f(*at).full().ravel() for f in both)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


def test_operations_grow_with_the_number_of_links():
    began = process_time()
    sizes = {n: crossed_chain(n).n_instructions() for n in (8, 16, 32)}
    assert process_time() - began < 5.0
    per_link = [(sizes[16] - sizes[8]) / 8, (sizes[32] - sizes[16]) / 16]
    assert per_link[1] == pytest.approx(per_link[0], rel=0.02)
    assert per_link[1] < 350  # measured 317


def test_refusals():
    link = chain_link()
    with pytest.raises(ValueError, match="link 0 has parent 0"):
        accelerations([link(0)], SX(1, 1), SX(1, 1), SX(3, 1))
    with pytest.raises(ValueError, match="1 links, 2 rates, 1 torques"):
        accelerations([link(-1)], SX(2, 1), SX(1, 1), SX(3, 1))


def chain_link():
    eye = SX.eye(3)
    return lambda parent: Link(parent, SX(3, 1), eye, rotations.unit(1), 1.0, SX(3, 1), eye)
