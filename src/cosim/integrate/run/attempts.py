"""A solver from a start over a grid, and what is tried where that fails or may be better."""

from dataclasses import dataclass, replace

import numpy as np

from cosim.arrays import Vector
from cosim.codegen.functions import equations
from cosim.integrate.engine import Engine, Problem
from cosim.integrate.nominal import Nominal, measured
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
        return call(engine_of(problem, solver), start.x, start.z, *_constants(start)), ""
    nominal = Nominal.declared(dae)
    found = solver.absolute_tolerance is None  # a given one counts in what the model says
    if found:
        nominal = nominal.from_start(dae, start.z)
    engine, reached = _run(problem, solver, start, nominal)
    if reached.reason == INTERRUPTED:
        return reached, ""
    if found:
        sizes = nominal.from_failure if reached.reason else nominal.from_run
        other = sizes(dae, reached.states, reached.algebraics)
        if other != nominal:
            _, again = _run(problem, solver, start, other)
            if not again.reason:
                values = ", ".join(f"{n} {v:.1g}" for n, v in nominal.unlike(dae, other).items())
                return _after(reached, again), f"with nominal values found from the run: {values}"
    lenient = engine.fallback(reached.reason) if reached.reason and engine.fallback else None
    if lenient is not None:
        again = _scaled_call(lenient, problem, start, nominal)
        if not again.reason:
            note = f"without errors of algebraic unknowns, with which: {reached.reason}"
            return _after(reached, again), note
    return reached, ""


def _after(first: Reached, second: Reached) -> Reached:
    """Return the second of two runs with the time of both."""
    return replace(second, solve_time=first.solve_time + second.solve_time)


def _run(
    problem: Problem, solver: Solver, start: Start, nominal: Nominal
) -> tuple[Engine, Reached]:
    engine, sizes = _counting_engine(problem, solver, nominal)
    return engine, _scaled_call(engine, problem, start, sizes)


@kept_per_thread(32)
def _counting_engine(problem: Problem, solver: Solver, nominal: Nominal) -> tuple[Engine, Nominal]:
    """Return the engine that counts in nominal values, and what its unknowns are divided by."""
    counted, sizes = measured(problem, solver, nominal)
    return engine_of(counted, solver), sizes


def _scaled_call(engine: Engine, problem: Problem, start: Start, nominal: Nominal) -> Reached:
    """Call an engine that counts in nominal values; once more where a consistent start fails."""
    x, z = nominal.columns
    numbers = (start.x / x.ravel(), start.z / z.ravel(), *_constants(start))
    reached = call(engine, *numbers)
    started = reached.states.shape[1] > 0 or reached.reason in ("", INTERRUPTED)
    if engine.restart is not None and not started:
        rates = _rates(problem, start) / x.ravel()
        reached = _after(reached, call(engine.restart(rates), *numbers))
    if nominal.in_si:
        return reached
    return replace(reached, states=reached.states * x, algebraics=reached.algebraics * z)


def _constants(start: Start) -> tuple[Vector, Vector]:
    return start.values.p, start.values.u


def _rates(problem: Problem, start: Start) -> Vector:
    """Return dx/dt at a consistent start, (nx,)."""
    t, values = problem.grid[0], start.values
    ode, _ = equations(problem.dae)(t, start.x, start.z, values.u, values.p)
    return np.array(ode).ravel()
