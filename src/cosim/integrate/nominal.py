"""Unknowns scaled by nominal values, so that one absolute tolerance fits all of them.

The co-simulation solver of FMUs scales in the same way. Scales are powers of two: dividing by one
and multiplying again changes no bit.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from math import log2

import casadi as ca
import numpy as np
from casadi import DM, SX

from casadi_models.dae import Dae, Variable
from cosim.arrays import Vector
from cosim.codegen.functions import equations
from cosim.integrate.call import INTERRUPTED, Reached, call
from cosim.integrate.engine import Engine, Left, Problem
from cosim.integrate.families.fixed_step import FixedStep
from cosim.integrate.solvers import engine_of
from cosim.memo import cached_per_thread
from cosim.model.solver import AdaptiveSolver, Solver
from cosim.model.values import Values, own_sizes
from cosim.series.samples import NOT_GIVEN

_ROUNDING = 1e-14  # relative, of numbers that large unknowns make
_SAME_TIMES = 64  # units in the last place of a time
_OF_FIXED_STEPS = 1e-12  # relative error that a method without error control may have
_CLOSE_SHARES = 1e-8  # CasADi's SUNDIALS interfaces pass output times within 1e-9 of the present


@dataclass(frozen=True)
class Nominal:
    """Nominal values for the error control of a run, SI: powers of two.

    Attributes:
        x: Of the states, (nx,).
        z: Of the algebraic unknowns, (nz,).
    """

    x: tuple[float, ...]
    z: tuple[float, ...]

    @staticmethod
    @cached_per_thread(16)
    def declared(dae: Dae) -> "Nominal":
        """Return the nominal values that a model declares."""
        x, z = (tuple(power(v.nominal) for v in group) for group in (dae.states, dae.algebraics))
        return Nominal(x, z)

    @staticmethod
    @cached_per_thread(16)
    def none(dae: Dae) -> "Nominal":
        """Return nominal values of 1, for solvers without error control."""
        return Nominal((1.0,) * len(dae.states), (1.0,) * len(dae.algebraics))

    @cached_property
    def in_si(self) -> bool:
        """Whether every nominal value is 1, in SI units."""
        return {*self.x, *self.z} <= {1.0}

    @cached_property
    def columns(self) -> tuple[Vector, Vector]:
        """Nominal values of states and algebraic unknowns as columns, (nx, 1) and (nz, 1)."""
        return np.array(self.x).reshape(-1, 1), np.array(self.z).reshape(-1, 1)

    def from_start(self, dae: Dae, x0: Vector, z0: Vector, absolute: float) -> "Nominal":
        """Return nominal values in which those that the model omits follow from initial values.

        A small nonzero initial value of a state becomes its nominal value, so that its relative
        accuracy is the same as for an initial value of 1, unless it is so small that it may be a
        rounding error of another one. A large initial value of an algebraic
        unknown becomes its nominal value. An initial value of 0 does not show the size of an
        algebraic unknown: its absolute tolerance is at least the rounding error of the largest
        unknown with the same unit.

        Args:
            dae: The model.
            x0, z0: Initial values of states and algebraic unknowns, SI, (nx,) and (nz,).
            absolute: Absolute tolerance of the solver, in nominal values.
        """
        x, z = map(power, own_sizes(dae, x0)), list(self.z)
        sizes = np.abs(z0)
        largest: dict[str, float] = {}
        for variable, size in zip(dae.algebraics, sizes, strict=True):
            largest[variable.unit] = max(largest.get(variable.unit, 0.0), size)
        for i, (variable, size) in enumerate(zip(dae.algebraics, sizes, strict=True)):
            if variable.nominal == NOT_GIVEN:
                z[i] = power(max(z[i], size, _ROUNDING * largest[variable.unit] / absolute))
        return Nominal(tuple(x), tuple(z))


def power(size: float) -> float:
    """Return the power of two nearest to a positive number."""
    return float(2.0 ** round(log2(size)))


def in_nominal_values(
    problem: Problem, solver: Solver, nominal: Nominal
) -> tuple[Problem, Nominal]:
    """Return the problem in scaled unknowns, and the nominal values to divide by.

    A solver with `takes_nominal_values` gets the original equations: since dividing by powers of
    two changes no bit, its steps are those of the scaled equations.
    """
    if solver.takes_nominal_values:
        return replace(problem, nominal=nominal.x), Nominal.none(problem.dae)
    return replace(problem, dae=scaled(problem.dae, nominal)), nominal


@cached_per_thread(32)
def _scaled_engine(
    problem: Problem, solver: Solver, nominal: Nominal
) -> tuple[Engine, Nominal, Vector]:
    """Return an engine in scaled unknowns, their nominal values, and its further parameters.

    These parameters are the nominal values that follow from initial values, so that one compiled
    library serves all initial values.
    """
    dae = problem.dae
    x = tuple(i for i, n in enumerate(Nominal.declared(dae).x) if nominal.x[i] != n)
    z = tuple(i for i, v in enumerate(dae.algebraics) if v.nominal == NOT_GIVEN)
    if solver.takes_nominal_values or not (x or z):
        problem, nominal = in_nominal_values(problem, solver, nominal)
        return engine_of(problem, solver), nominal, np.empty(0)
    known = Nominal(_one_at(nominal.x, x), _one_at(nominal.z, z))
    sized = _sized(scaled(dae, known), x, z)
    sizes = [*(nominal.x[i] for i in x), *(nominal.z[i] for i in z)]
    return engine_of(replace(problem, dae=sized), solver), nominal, np.array(sizes)


def _one_at(sizes: tuple[float, ...], which: tuple[int, ...]) -> tuple[float, ...]:
    return tuple(1.0 if i in which else size for i, size in enumerate(sizes))


@cached_per_thread(16)
def _sized(dae: Dae, x_rows: tuple[int, ...], z_rows: tuple[int, ...]) -> Dae:
    """Return a model in which further parameters scale some of the unknowns."""
    sizes = SX.sym("size", len(x_rows) + len(z_rows))
    of_x, of_z = ca.vertsplit(sizes, [0, len(x_rows), len(x_rows) + len(z_rows)])
    x, z = SX.ones(dae.x.numel()), SX.ones(dae.z.numel())
    for every, rows, own in ((x, x_rows, of_x), (z, z_rows, of_z)):
        if rows:
            every[list(rows)] = own
    more = (
        Variable(f"size_{i}", "1", "nominal value of an unknown", 1.0) for i in range(sizes.numel())
    )
    parameters = (*dae.parameters, *more)
    return replace(_divided(dae, x, z), p=ca.vertcat(dae.p, sizes), parameters=parameters)


@cached_per_thread(16)
def scaled(dae: Dae, nominal: Nominal) -> Dae:
    """Return a model whose states and algebraic unknowns are scaled by nominal values.

    Equations and invariants, which solvers use, are rewritten; outputs, validity conditions and
    initial values are not.
    """
    return dae if nominal.in_si else _divided(dae, SX(DM(nominal.x)), SX(DM(nominal.z)))


def _divided(dae: Dae, x: SX, z: SX) -> Dae:
    def rewritten(*expressions: SX) -> list[SX]:
        return ca.substitute([*expressions], [dae.x, dae.z], [x * dae.x, z * dae.z])

    ode, alg = rewritten(dae.ode, dae.alg)
    invariants = []
    for invariant in dae.invariants:
        residual, sizes = rewritten(invariant.residual, invariant.sizes)
        scaled_sizes = sizes / x[list(invariant.states)]
        invariants.append(replace(invariant, residual=residual, sizes=scaled_sizes))
    return replace(dae, ode=ode / x, alg=alg, invariants=tuple(invariants))


@dataclass(frozen=True)
class InitialState:
    """Consistent values at which an integration begins, SI.

    Attributes:
        x: States, (nx,).
        z: Algebraic unknowns, (nz,).
        values: Parameters, and the inputs at that time.
        began: States at which the run began, (nx,), if this is a jump of an input; None if not.
        left: What past events have left, for engines that go through further ones.
    """

    x: Vector
    z: Vector
    values: Values
    began: Vector | None = None
    left: Left | None = None


def scaled_call(
    problem: Problem, solver: Solver, start: InitialState, *, in_pieces: bool = False
) -> Reached:
    """Call the engine of a solver over a grid, its unknowns scaled by nominal values.

    If a solver with error control has no absolute tolerance, nominal values that the model does not
    set follow from the initial values.

    Args:
        problem, solver, start: What to integrate.
        in_pieces: Whether this is one of many pieces of a run, which share engines.

    Raises:
        UsageError, ParameterError, MissingTool: See `engine_of`.
    """
    t, span = problem.grid[0], tuple[float, ...]()
    late = abs(t) > np.ptp(problem.grid)
    if in_pieces or late:
        problem, solver, span = in_own_time(problem, solver, in_pieces=in_pieces)
    p = start.values.p
    if not isinstance(solver, AdaptiveSolver):
        numbers = start.x, start.z, np.append(p, span), start.values.u
        return call(engine_of(problem, solver), *numbers, start.left, *span)
    nominal = Nominal.declared(problem.dae)
    if solver.absolute_tolerance is None:
        x0 = start.x if start.began is None else start.began
        nominal = nominal.from_start(problem.dae, x0, start.z, solver.tolerance.pair[1])
    shares, problem = problem.shares, replace(problem, shares=())
    if shares and solver.takes_nominal_values:
        pairs = zip(nominal.x, shares, strict=True)
        nominal = replace(nominal, x=tuple(power(size * share) for size, share in pairs))
    elif shares:  # equations of very different scales would lose digits in linear solutions
        solver = replace(solver, absolute_tolerance=solver.tolerance.pair[1] * min(shares))
    engine, sizes, more = _scaled_engine(problem, solver, nominal)
    x, z = sizes.columns
    p = np.concatenate((p, more, span))
    numbers = start.x / x.ravel(), start.z / z.ravel(), p, start.values.u
    reached = call(engine, *numbers, start.left, *span)
    started = reached.states.shape[1] > 0 or reached.reason in ("", INTERRUPTED)
    if engine.restart is not None and not started:
        values = start.values
        ode, _ = equations(problem.dae)(t, start.x, start.z, values.u, values.p)
        slopes = np.array(ode).ravel() / x.ravel() * (span[1] if span else 1.0)
        again = call(engine.restart(slopes), *numbers, None, *span)
        reached = replace(again, solve_time=reached.solve_time + again.solve_time)
    if sizes.in_si:
        return reached
    return replace(reached, states=reached.states * x, algebraics=reached.algebraics * z)


def in_own_time(
    problem: Problem, solver: Solver, *, in_pieces: bool
) -> tuple[Problem, Solver, tuple[float, ...]]:
    """Return a problem over times from 0 to 1, its solver, and its start and length, s.

    Pieces of a run whose lengths differ by rounding are then equal problems, with one engine; and
    no step is rounded as a late time is. The last item is empty, and nothing changes, where an
    engine for other times is cheap, or times are too close for SUNDIALS.
    """
    grid = problem.grid
    begin, end = grid[[0, -1]].tolist()
    length = end - begin
    unit = power(_SAME_TIMES * np.spacing(max(-begin, end)) / length)
    shares = (grid - begin) / length
    error = solver.tolerance.pair[0] if isinstance(solver, AdaptiveSolver) else _OF_FIXED_STEPS
    if in_pieces and unit <= error:
        shares = np.round(shares / unit) * unit
    cheap = problem.compiled and solver.takes_times
    if cheap or np.diff(shares).min() <= _CLOSE_SHARES:
        return problem, solver, ()

    def share(step: float, towards: float) -> float:
        return float(np.nextafter(np.float32(step / length), np.float32(towards)))

    # in single precision, so that rounding makes no difference
    if isinstance(solver, FixedStep) and solver.step_size is not None:
        solver = replace(solver, step_size=share(solver.step_size, np.inf))
    elif isinstance(solver, AdaptiveSolver):
        longest = problem.longest(solver.max_step)
        if longest is not None:
            longest = share(longest, 0) if longest < length else None
        if longest != solver.max_step:
            solver = replace(solver, max_step=longest)
    return replace(problem, times=shares.tobytes(), in_own_time=True), solver, (begin, length)
