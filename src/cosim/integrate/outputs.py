"""`observe`: evaluate everything that a run records from its states; `derivatives_at`."""

import ctypes
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.codegen.casadi_library import cache_key, external
from cosim.codegen.functions import CALL, symbols_like
from cosim.codegen.initialization import algebraic_function
from cosim.codegen.runge_kutta.lane_library import Watched, lane_outputs, processor_lanes
from cosim.errors import UsageError
from cosim.integrate.call import call_on_arrays, finite_rows
from cosim.integrate.motion import Motion
from cosim.memo import cached_per_thread
from cosim.trajectory import Column

_FEWEST_IN_LANES = 8  # times; for fewer, a library for lanes is not worth compiling


@dataclass(frozen=True)
class Observed:
    """Recorded values of a run, and the first time at which they are not finite.

    Attributes:
        table: Recorded values, SI, one row per time, one column per variable.
        unknowns: Algebraic unknowns, SI, (n, nz).
        first_not_finite: Position of the first time at which a state, an algebraic unknown, or a
            recorded value is not finite; n if there is none.
        margins: Margins of the validity conditions, (n, conditions), if they are requested.
    """

    table: Vector
    unknowns: Vector
    first_not_finite: int
    margins: Vector


def observe(motion: Motion, places: tuple[int, ...], *, margins: bool, compiled: bool) -> Observed:
    """Evaluate the recorded variables of a run, and its validity conditions.

    Args:
        motion: Its motion; the algebraic unknowns are guesses for their equations.
        places: Positions of the recorded variables among `all_columns`.
        margins: Whether to evaluate the margins of the validity conditions.
        compiled: Whether the equations are compiled.
    """
    dae, n, nx = motion.dae, len(motion.time), len(motion.dae.states)
    if not n:
        sizes = len(places), len(dae.algebraics), len(dae.limits)
        table, unknowns, none = (np.empty((0, size)) for size in sizes)
        return Observed(table, unknowns, 0, none)
    computed = max(places, default=0) >= nx
    if not (computed or margins or dae.algebraics):
        return _states_alone(motion, places)
    several = compiled and n >= _FEWEST_IN_LANES
    if several and (library := _lane_library(dae, limits_only=not computed)) is not None:
        return _in_lanes(library, motion, places, margins=margins)
    return _one_by_one(motion, places, margins=margins, compiled=compiled)


def _states_alone(motion: Motion, places: tuple[int, ...]) -> Observed:
    """Return the result of `observe` for recorded states, where nothing has to be evaluated."""
    rows = motion.states.T  # C-ordered, as solvers write them
    table, none = rows.take(np.array(places, dtype=np.int64), axis=1), np.empty((len(rows), 0))
    return Observed(table, none, finite_rows(rows), none)


def _one_by_one(
    motion: Motion, places: tuple[int, ...], *, margins: bool, compiled: bool
) -> Observed:
    """Return the result of `observe`, for any model."""
    dae, n = motion.dae, len(motion.time)
    known = len(dae.states) + len(dae.algebraics)
    function = _observer(dae, n, compiled)
    rows = np.empty((n, function.size1_out(0)))
    u = np.broadcast_to(motion.u, (len(motion.u), n))
    arguments = (motion.time, motion.states.T, motion.algebraics.T, u.T, motion.p)
    if not call_on_arrays(function.buffer(), arguments, (rows,)):  # one singular row stops all
        _evaluate_rows(_observer(dae, 1, compiled), arguments, rows)
    every = np.hstack((motion.states.T, rows))
    checked = every[:, sorted({*range(known), *places})]
    not_finite = _first(~np.isfinite(checked).all(axis=1))
    own = every[:, every.shape[1] - len(dae.limits) :] if margins else np.empty((n, 0))
    unknowns = every[:, len(dae.states) : known]
    return Observed(every[:, places], unknowns, not_finite, own)


def _evaluate_rows(function: ca.Function, arguments: tuple[Vector, ...], rows: Vector) -> None:
    """Evaluate a function for every time on its own; a row that has no value becomes NaN."""
    *columns, p = arguments
    buffer = function.buffer()
    for k, row in enumerate(rows):
        if not call_on_arrays(buffer, [*(column[k] for column in columns), p], [row]):
            row.fill(np.nan)


def _first(where: ArrayLike) -> int:
    """Return the first position that is true; the length if none is."""
    found = np.flatnonzero(where)
    return int(found[0]) if found.size else np.size(where)


@cached_per_thread(16)
def _lane_library(dae: Dae, *, limits_only: bool) -> ctypes.CDLL | None:
    """Return the library that evaluates outputs in SIMD lanes; None if it cannot exist."""
    if dae.algebraics or not dae.states:
        return None
    try:
        return lane_outputs(dae, processor_lanes(), limits_only=limits_only)
    except UsageError:  # an operation that lanes do not support
        return None


def _in_lanes(
    library: ctypes.CDLL, motion: Motion, places: tuple[int, ...], *, margins: bool
) -> Observed:
    """Return the result of `observe`, for explicit formulations."""
    n = len(motion.time)
    table, first = np.empty((n, len(places))), np.empty(1, dtype=np.int64)
    arguments = [motion.time, motion.states.T, motion.u.T, motion.p]
    arrays = [*map(np.ascontiguousarray, arguments)]  # a library has their addresses only
    margin_table = np.empty((n, len(motion.dae.limits) if margins else 0))
    recorded = np.array(places, dtype=np.int64)
    library.lanes_outputs(
        Watched(
            n,
            len(arrays[2]),
            *(part.ctypes.data for part in arrays),
            len(places),
            *(part.ctypes.data for part in (recorded, table, first)),
            margin_table.ctypes.data if margins else None,
        )
    )
    return Observed(table, np.empty((n, 0)), int(first[0]), margin_table)


@cached_per_thread(64)
def all_columns(dae: Dae) -> tuple[Column, ...]:
    """Return the columns of all variables: states, algebraic unknowns, outputs."""
    n = len(dae.states)
    return tuple(
        Column(v.name, v.unit, v.display_unit, v.nominal, v.meaning, is_state=i < n)
        for i, v in enumerate((*dae.states, *dae.algebraics, *dae.output_variables))
    )


@cached_per_thread(16)
def recorded_columns(
    dae: Dae, names: tuple[str, ...]
) -> tuple[tuple[Column, ...], tuple[int, ...]]:
    """Return the columns of some variables, and their positions among `all_columns`."""
    every = all_columns(dae)
    place = {column.name: i for i, column in enumerate(every)}
    places = tuple(place[name] for name in names)
    return tuple(every[i] for i in places), places


@cached_per_thread(8)
def watching(dae: Dae, names: tuple[str, ...]) -> Dae:
    """Return the DAE with the named monitors among its outputs."""
    return dae.watching(names)


@cached_per_thread(16)
def _observer(dae: Dae, n: int, compiled: bool) -> ca.Function:
    """Return `observe(t, x, z, u, p) -> rows` for n times, one column per time."""
    shown = ca.vertcat(dae.outputs, dae.margins)
    outputs = ca.Function("outputs", dae.arguments, [shown], {"cse": True})
    t, x, z, u, p = symbols_like(dae)
    solved = algebraic_function(dae)(t, x, z, u, p)
    rows = ca.densify(ca.vertcat(solved, outputs(t, x, solved, u, p)))  # cse makes zeros sparse
    function = ca.Function("observe", [t, x, z, u, p], [rows], CALL, ["rows"])
    if n == 1:
        return function
    if compiled:
        (function,) = external([function], cache_key("observe", function), ["observe"])
    return function.map("every", "serial", n, [4], [])


def derivatives_at(
    dae: Dae, names: tuple[str, ...], t: float, x: Vector, z: Vector, u: Vector, p: Vector
) -> tuple[Vector, Vector, Vector]:
    """Return rates and outputs at a state, and their derivatives by states and inputs.

    Args:
        dae: The model; its algebraic unknowns follow what the derivatives are by.
        names: The outputs.
        t, x, z, u, p: The state, where the algebraic equations hold.

    Returns:
        (nx,), (ny,) and (nx + ny, nx + nu).

    Raises:
        LinAlgError: The algebraic equations are singular.
    """
    found = _jacobians(dae, names).call([t, x, z, u, p])
    rates, outputs, by_xu, by_z, alg_xu, alg_z = (np.array(block) for block in found)
    if len(z):
        by_xu = by_xu - by_z @ np.linalg.solve(alg_z, alg_xu)
    return rates.ravel(), outputs.ravel(), by_xu


@cached_per_thread(8)
def _jacobians(dae: Dae, names: tuple[str, ...]) -> ca.Function:
    """Return the function of rates, outputs, and the partial derivatives of both and of alg."""
    dae = dae.watching(names)
    _, places = recorded_columns(dae, names)
    chosen = ca.densify(ca.vertcat(dae.x, dae.z, dae.outputs)[list(places), :])
    xu = ca.vertcat(dae.x, dae.u)
    both = ca.vertcat(dae.ode, chosen)
    blocks = [ca.jacobian(rows, by) for rows in (both, dae.alg) for by in (xu, dae.z)]
    return ca.Function(
        "jacobians", dae.arguments, [dae.ode, chosen, *map(ca.densify, blocks)], {"cse": True}
    )
