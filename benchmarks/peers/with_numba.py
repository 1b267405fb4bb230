"""The right-hand side through numba, for scipy and scikit-sundae."""

import math
from collections.abc import Callable, Iterator
from typing import Any

import numba
import numpy as np
from entries import Evaluation
from problem import Problem

PACKAGES = ("numba",)

# no test of every divisor, and fused multiplication and addition: the fastest that is still IEEE
compiled = numba.njit(error_model="numpy", fastmath={"contract"})


def rhs(problem: Problem) -> Callable[..., Any]:
    """Return `rhs(t, x, dx)`, which fills dx."""
    values, n = compiled(problem.python(vars(math))), problem.size

    @compiled
    def fill(t, x, dx):
        y = values(t, x)
        for i in range(n):
            dx[i] = y[i]

    return fill


def rhs_of_new(problem: Problem) -> Callable[..., Any]:
    """Return `rhs(t, x) -> dx`."""
    fill, n = rhs(problem), problem.size

    @compiled
    def new(t, x):
        dx = np.empty(n)
        fill(t, x, dx)
        return dx

    return new


def jacobian(problem: Problem) -> Callable[..., Any]:
    """Return `jacobian(t, x) -> (nx, nx)`."""
    values, n = compiled(problem.python(vars(math), "jacobian")), problem.size

    @compiled
    def matrix(t, x):
        y, result = values(t, x), np.empty((n, n))
        for i in range(n):
            for j in range(n):
                result[i, j] = y[i * n + j]
        return result

    return matrix


def evaluations(problem: Problem) -> Iterator[Evaluation]:
    values, fill, n = compiled(problem.python(vars(math))), rhs(problem), problem.size
    x, dx = problem.states, np.empty_like(problem.states)

    @compiled
    def many(x, dx):
        for i in range(len(x)):
            y = values(0.0, x[i])
            for j in range(n):
                dx[i, j] = y[j]

    yield Evaluation("numba", lambda: many(x, dx), len(x))
    first, rates = x[0].copy(), dx[0].copy()
    yield Evaluation("numba", lambda: fill(0.0, first, rates), one=True)
