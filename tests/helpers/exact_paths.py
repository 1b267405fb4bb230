"""Laws and conditions of an argument with boundaries at whole numbers, and paths of it.

A law is integrated along a path, and a condition counted: how often it becomes true.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import casadi as ca
import numpy as np

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(3)


def _sign(value: float) -> int:
    return (value > 0) - (value < 0)


# Each law as CasADi builds it, and as Python computes it
LAWS: dict[str, tuple[Callable, Callable[[float], float]]] = {
    "<": (lambda u: ca.if_else(u < 1, 1, 0), lambda u: u < 1),
    "<=": (lambda u: ca.if_else(u <= 1, 1, 0), lambda u: u <= 1),
    ">": (lambda u: ca.if_else(u > 1, 1, 0), lambda u: u > 1),
    ">=": (lambda u: ca.if_else(u >= 1, 1, 0), lambda u: u >= 1),
    "sign": (lambda u: ca.sign(u - 1), lambda u: _sign(u - 1)),
    "floor": (ca.floor, math.floor),
    "ceil": (ca.ceil, math.ceil),
    "fmod": (lambda u: ca.fmod(u, 1), lambda u: math.fmod(u, 1)),
    "fmin": (lambda u: ca.if_else(ca.fmin(u, 1) >= 1, 1, 0), lambda u: min(u, 1) >= 1),
    "fmax": (lambda u: ca.if_else(ca.fmax(u, 1) <= 1, 1, 0), lambda u: max(u, 1) <= 1),
    "fabs": (lambda u: ca.if_else(ca.fabs(u - 1) > 0, 1, 0), lambda u: abs(u - 1) > 0),
    "sign of fmax": (lambda u: ca.sign(ca.fmax(u - 1, 0)), lambda u: _sign(max(u - 1, 0))),
}

# The same of conditions
CONDITIONS: dict[str, tuple[Callable, Callable[[float], bool]]] = {
    "<": (lambda u: u < 1, lambda u: u < 1),
    "<=": (lambda u: u <= 1, lambda u: u <= 1),
    ">": (lambda u: u > 1, lambda u: u > 1),
    ">=": (lambda u: u >= 1, lambda u: u >= 1),
    "sign >": (lambda u: ca.sign(u - 1) > 0, lambda u: u > 1),
    "sign >=": (lambda u: ca.sign(u - 1) >= 0, lambda u: u >= 1),
    "sign <": (lambda u: ca.sign(u - 1) < 0, lambda u: u < 1),
    "floor <": (lambda u: ca.floor(u) < 1, lambda u: u < 1),
    "ceil >": (lambda u: ca.ceil(u) > 1, lambda u: u > 1),
    "fmod >=": (lambda u: ca.fmod(u, 2) >= 1, lambda u: math.fmod(u, 2) >= 1),
    "fmin <": (lambda u: ca.fmin(u, 1) < 1, lambda u: u < 1),
    "fmax <=": (lambda u: ca.fmax(u, 1) <= 1, lambda u: u <= 1),
    "fabs <=": (lambda u: ca.fabs(u - 1) <= 0, lambda u: u == 1),
    "fabs >": (lambda u: ca.fabs(u - 1) > 0, lambda u: u != 1),
    "both": (lambda u: ca.logic_and(u >= 1, u <= 1), lambda u: u == 1),
}


@dataclass(frozen=True)
class Path:
    """An argument over time, polynomial of at most degree 2 between breaks.

    At a break it jumps, rests, sets off, or passes a whole number: laws do not change in between.
    What is `beyond` its end, if it differs, makes an event of the end.
    """

    pieces: tuple[tuple[float, float, Callable[[float], float]], ...]
    beyond: float | None = None

    def integral(self, law: str) -> float:
        """Return the integral of a law of this argument, by Gauss's rule on each piece."""
        compute = LAWS[law][1]
        total = 0.0
        for start, end, value in self.pieces:
            points = (start + end) / 2 + (end - start) / 2 * _NODES
            values = [compute(value(float(t))) for t in points]
            total += (end - start) / 2 * float(np.dot(_WEIGHTS, values))
        return total

    def rises(self, condition: str) -> int:
        """Return how often a condition becomes true, at the start and at the end, too.

        At the start, that is what is false by value there, and what the motion makes true.
        """
        start, _, first = self.pieces[0]
        values = [first(start), *(value((begin + end) / 2) for begin, end, value in self.pieces)]
        if self.beyond is not None:
            values.append(self.beyond)
        true = [CONDITIONS[condition][1](u) for u in values]
        return sum(now and not before for before, now in pairwise(true))


def through(*points: tuple[float, float], beyond: float | None = None) -> Path:
    """Return the lines through points (time, argument); two of one time are a jump."""
    pieces = []
    for (t0, u0), (t1, u1) in pairwise(points):
        if t1 == t0:
            continue
        low, high = sorted((u0, u1))
        whole = [u for u in range(math.floor(low), math.ceil(high) + 1) if low < u < high]
        times = sorted({t0, t1, *(t0 + (u - u0) * (t1 - t0) / (u1 - u0) for u in whole)})
        line = _line(t0, u0, t1, u1)
        pieces += [(start, end, line) for start, end in pairwise(times)]
    return Path(tuple(pieces), beyond)


def curve(value: Callable[[float], float], *breaks: float) -> Path:
    """Return a curve of degree 2 that is whole at no time between the given ones."""
    return Path(tuple((start, end, value) for start, end in pairwise(breaks)))


def _line(t0: float, u0: float, t1: float, u1: float) -> Callable[[float], float]:
    if u0 == u1:
        return lambda t: u0
    return lambda t: u0 + (u1 - u0) * (t - t0) / (t1 - t0)
