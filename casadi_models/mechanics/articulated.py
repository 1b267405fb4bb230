"""Open chains and trees of hinged bodies by recursion: operations grow with the bodies, not faster.

`kane` solves for all accelerations at once, which costs the cube of their number. Here every body
takes what hangs on it as an articulated inertia, from the tips to the ground, and hands back
accelerations. Vectors are spatial, [angular, linear], at the body's hinge and in its axes.

Source  Featherstone, Rigid Body Dynamics Algorithms, 2008, section 7.3.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
from casadi import SX


@dataclass(frozen=True, eq=False)  # CasADi's == builds an expression
class Link:
    """A body on a hinge.

    Attributes:
        parent: Position of the body that carries it, before it in the list; -1 for the ground.
        place: Of the hinge, from the parent's hinge, in the parent's axes, (3, 1), m.
        rotation: R of the body in its parent, the hinge's angle in it, (3, 3).
        axis: Of the hinge, a unit vector in the body's axes, (3, 1).
        mass: kg.
        center: Mass center from the hinge, in the body's axes, (3, 1), m.
        inertia: About the mass center, in the body's axes, (3, 3), kg.m2.
    """

    parent: int
    place: SX
    rotation: SX
    axis: SX
    mass: SX | float
    center: SX
    inertia: SX


def accelerations(links: Sequence[Link], rates: SX, torques: SX, gravity: SX) -> SX:
    """Return the angular accelerations of the hinges, (n, 1), rad/s2.

    Args:
        links: Every one after its parent.
        rates: Of the hinges, (n, 1), rad/s.
        torques: About the hinges, of the parent on the body, (n, 1), N.m.
        gravity: Acceleration of free fall, in the ground's axes, (3, 1), m/s2.

    Raises:
        ValueError: A parent does not stand before its body, or the numbers differ.
    """
    n = len(links)
    if not rates.numel() == torques.numel() == n:
        raise ValueError(f"{n} links, {rates.numel()} rates, {torques.numel()} torques")
    for i, link in enumerate(links):
        if not -1 <= link.parent < i:
            raise ValueError(f"link {i} has parent {link.parent}; name one before it, or -1")

    moves = [_move(link) for link in links]
    hinges = [ca.vertcat(SX(link.axis), SX(3, 1)) for link in links]
    twists: list[SX] = []  # velocity of each body
    drifts: list[SX] = []  # acceleration without that of its own hinge
    for i, link in enumerate(links):
        own = hinges[i] * rates[i]
        carried = moves[i] @ twists[link.parent] if link.parent >= 0 else SX(6, 1)
        twists.append(carried + own)
        drifts.append(_crossed(twists[i], own))

    inertias = [_spatial_inertia(link) for link in links]
    biases = [_crossed_dual(v, I @ v) for v, I in zip(twists, inertias, strict=True)]  # noqa: E741
    hinge_inertia, needed, spare = [SX()] * n, [SX()] * n, [SX()] * n
    for i in reversed(range(n)):
        hinge_inertia[i] = inertias[i] @ hinges[i]
        needed[i] = ca.dot(hinges[i], hinge_inertia[i])
        spare[i] = torques[i] - ca.dot(hinges[i], biases[i])
        parent = links[i].parent
        if parent >= 0:
            share = hinge_inertia[i] / needed[i]
            passed = inertias[i] - share @ hinge_inertia[i].T
            bias = biases[i] + passed @ drifts[i] + share * spare[i]
            inertias[parent] += _symmetric(moves[i].T @ _symmetric(passed) @ moves[i])
            biases[parent] += moves[i].T @ bias

    ground = ca.vertcat(SX(3, 1), -SX(gravity))
    total, found = list[SX](), list[SX]()
    for i, link in enumerate(links):
        carried = moves[i] @ (total[link.parent] if link.parent >= 0 else ground) + drifts[i]
        found.append((spare[i] - ca.dot(hinge_inertia[i], carried)) / needed[i])
        total.append(carried + hinges[i] * found[i])
    return ca.vertcat(SX(0, 1), *found)


def _move(link: Link) -> SX:
    """Return the transformation of a twist from the parent's hinge to the body's, (6, 6)."""
    turn = SX(link.rotation).T
    return ca.blockcat([[turn, SX(3, 3)], [-turn @ _skew(link.place), turn]])


def _spatial_inertia(link: Link) -> SX:
    arm = _skew(link.center)
    return ca.blockcat(
        [
            [SX(link.inertia) - link.mass * arm @ arm, link.mass * arm],
            [-link.mass * arm, link.mass * SX.eye(3)],
        ]
    )


def _skew(vector: SX) -> SX:
    return ca.sparsify(ca.skew(SX(vector)))


def _crossed(a: SX, b: SX) -> SX:
    """Return the cross product of two twists."""
    return ca.vertcat(ca.cross(a[:3], b[:3]), ca.cross(a[:3], b[3:]) + ca.cross(a[3:], b[:3]))


def _crossed_dual(a: SX, f: SX) -> SX:
    """Return the cross product of a twist and a momentum."""
    return ca.vertcat(ca.cross(a[:3], f[:3]) + ca.cross(a[3:], f[3:]), ca.cross(a[:3], f[3:]))


def _symmetric(matrix: SX) -> SX:
    """Return a matrix known to be symmetric from its upper half: the lower one costs nothing."""
    return ca.triu2symm(ca.triu(matrix))
