"""Rooted trees and their order conditions (Hairer, Norsett, Wanner, II.2)."""

from fractions import Fraction
from functools import cache
from math import prod


@cache
def trees(nodes):
    """Return every rooted tree of so many nodes, each as the sorted tuple of its branches."""
    if nodes == 1:
        return [()]
    return sorted({tuple(sorted(branches)) for branches in forests(nodes - 1)})


def forests(nodes):
    if nodes == 0:
        yield ()
    for first in range(1, nodes + 1):
        for tree in trees(first):
            for rest in forests(nodes - first):
                yield (tree, *rest)


def size(tree):
    return 1 + sum(map(size, tree))


def density(tree):
    return size(tree) * prod(map(density, tree))


def stage_weights(tree, a):
    """Return Phi_i(t) for every stage i, in rational numbers."""
    branches = [stage_weights(branch, a) for branch in tree]
    inner = [[sum(x * y for x, y in zip(row, w, strict=False)) for row in a] for w in branches]
    return [prod((w[i] for w in inner), start=Fraction(1)) for i in range(len(a))]
