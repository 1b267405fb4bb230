"""diffrax on the processor, in double precision."""

from collections.abc import Callable, Iterator
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import walk
from entries import Evaluation, Run, Solver
from problem import Problem

PACKAGES = ("diffrax", "jax")
MOST_STEPS = 100_000
jax.config.update("jax_enable_x64", True)


def solvers(problem: Problem) -> Iterator[Solver]:
    term = diffrax.ODETerm(_rhs(problem))
    x0, grid = jnp.asarray(problem.start["x0"]), jnp.asarray(problem.grid)

    def prepared(method: type[diffrax.AbstractSolver]) -> Solver:
        @jax.jit
        def solve(start: jax.Array, tolerance: float) -> jax.Array:
            control = diffrax.PIDController(rtol=tolerance, atol=1e-2 * tolerance)
            saved = diffrax.SaveAt(ts=grid)
            span = (grid[0], grid[-1], None)
            options = {"stepsize_controller": control, "max_steps": MOST_STEPS, "throw": False}
            return diffrax.diffeqsolve(term, method(), *span, start, saveat=saved, **options).ys

        def prepare(tolerance: float) -> Run:
            return lambda: np.asarray(solve(x0, tolerance))

        return Solver(f"diffrax {method.__name__}", prepare)

    yield prepared(diffrax.Dopri8)
    yield prepared(diffrax.Tsit5)


def evaluations(problem: Problem) -> Iterator[Evaluation]:
    rhs = _rhs(problem)
    x = jnp.asarray(problem.states)
    many = jax.jit(jax.vmap(lambda state: rhs(0.0, state, None)))
    one, first = jax.jit(lambda state: rhs(0.0, state, None)), x[0]
    yield Evaluation("jax vmap", lambda: many(x).block_until_ready(), len(x))
    yield Evaluation("jax jit", lambda: one(first).block_until_ready(), one=True)


def _rhs(problem: Problem) -> Callable[..., jax.Array]:
    values = problem.python({name: getattr(jnp, name) for name in walk.FUNCTIONS})

    def rhs(t: Any, x: jax.Array, _: None) -> jax.Array:
        return jnp.stack([jnp.asarray(value, x.dtype) for value in values(t, x)])

    return rhs
