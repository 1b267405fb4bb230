"""A solver from a start over a grid, and what is tried where that fails or may be better."""

from dataclasses import dataclass, replace

import numpy as np

from cosim.arrays import Vector
from cosim.codegen.functions import equations
from cosim.integrate.engine import Engine, Problem
from cosim.integrate.nominal import Nominal, in_values_of_a_run
from cosim.integrate.run.call import INTERRUPTED, Reached, call
from cosim.integrate.solver import AdaptiveSolver, Solver
from cosim.integrate.solvers import engine_of
from cosim.memo import kept_per_thread
from cosim.model.values import Values


@dataclass(frozen=True)
class Start:
    """Where a run begins: states (nx,), consistent algebraic unknowns (nz,), inputs in `values`."""

    x: Vector
    z: Vector
    values: Values


def integrated(problem: Problem, solver: Solver, start: Start) -> tuple[Reached, str]:
    """Integrate over the grid of a problem, once more where other settings promise better.

    Returns:
        What was reached, and what was done for it that was not asked for.

    Raises:
        CosimError: See `simulate`.
    """
    dae = problem.dae
    if not isinstance(solver, AdaptiveSolver):
        numbers = start.x, start.z, start.values.p, start.values.u
        return call(engine_of(problem, solver), *numbers), ""
    nominal = Nominal.declared(dae)
    found = solver.absolute_tolerance is None  # a given one counts in what the model says
    if found:
        nominal = nominal.from_start(dae, start.z)
    own = _counting_engine(problem, solver, nominal)
    reached = _scaled_call(own, problem, start)
    if reached.reason == INTERRUPTED:
        return reached, ""
    if found:
        sizes = nominal.from_failure if reached.reason else nominal.from_run
        other = sizes(dae, reached.states, reached.algebraics)
        if other != nominal:
            again = _scaled_call(_counting_engine(problem, solver, other), problem, start)
            if not again.reason:
                values = ", ".join(f"{n} {v:.1g}" for n, v in nominal.unlike(dae, other).items())
                return _after(reached, again), f"with nominal values found from the run: {values}"
    fallback = own.engine.fallback if reached.reason else None
    lenient = fallback(reached.reason) if fallback else None
    if lenient is not None:
        again = _scaled_call(replace(own, engine=lenient), problem, start)
        if not again.reason:
            note = f"without errors of algebraic unknowns, with which: {reached.reason}"
            return _after(reached, again), note
    return reached, ""


def _after(first: Reached, second: Reached) -> Reached:
    """Return the second of two runs with the time of both."""
    return replace(second, solve_time=first.solve_time + second.solve_time)


@dataclass(frozen=True)
class _Counting:
    """An engine that counts in nominal values.

    Attributes:
        engine: Takes parameters of its own behind the model's.
        sizes: What its unknowns are divided by.
        more: Those parameters.
    """

    engine: Engine
    sizes: Nominal
    more: Vector


@kept_per_thread(32)
def _counting_engine(problem: Problem, solver: Solver, nominal: Nominal) -> _Counting:
    counted, sizes, more = in_values_of_a_run(problem, solver, nominal)
    return _Counting(engine_of(counted, solver), sizes, more)


def _scaled_call(own: _Counting, problem: Problem, start: Start) -> Reached:
    """Call an engine that counts in nominal values; once more where a consistent start fails."""
    engine, (x, z) = own.engine, own.sizes.columns
    p = np.concatenate((start.values.p, own.more)) if own.more.size else start.values.p
    numbers = (start.x / x.ravel(), start.z / z.ravel(), p, start.values.u)
    reached = call(engine, *numbers)
    started = reached.states.shape[1] > 0 or reached.reason in ("", INTERRUPTED)
    if engine.restart is not None and not started:
        rates = _rates(problem, start) / x.ravel()
        reached = _after(reached, call(engine.restart(rates), *numbers))
    if own.sizes.in_si:
        return reached
    return replace(reached, states=reached.states * x, algebraics=reached.algebraics * z)


def _rates(problem: Problem, start: Start) -> Vector:
    """Return dx/dt at a consistent start, (nx,)."""
    t, values = problem.grid[0], start.values
    ode, _ = equations(problem.dae)(t, start.x, start.z, values.u, values.p)
    return np.array(ode).ravel()
