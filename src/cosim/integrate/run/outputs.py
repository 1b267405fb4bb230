"""From states to everything that a run records."""

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.codegen.casadi_library import cache_key, external
from cosim.codegen.functions import CALL, symbols_like
from cosim.codegen.initialization import algebraic_function
from cosim.codegen.runge_kutta.lane_library import Watched, lane_outputs, processor_lanes
from cosim.errors import UsageError
from cosim.integrate.run.call import call_on_arrays, finite_rows
from cosim.memo import kept_per_thread
from cosim.model.catalogue import no_such_output
from cosim.model.values import listed
from cosim.trajectory import Column

_WORTHWHILE = 8  # times; for fewer, other code is at hand


@dataclass(frozen=True)
class Solved:
    """A run as its solver leaves it, over n times.

    Attributes:
        time: s, (n,).
        states, guesses: Of states and algebraic unknowns, (nx, n) and (nz, n).
        u: Inputs, (nu, n), or (nu, 1) where they are constant.
        p: Parameters.
    """

    time: Vector
    states: Vector
    guesses: Vector
    u: Vector
    p: Vector


@dataclass(frozen=True)
class Observed:
    """What a run records, and where it is left by what it should keep to.

    Attributes:
        table: One row per time, a column per name.
        unknowns: Algebraic unknowns, (n, nz).
        lost: Position of the first time at which a state, an unknown, or what is recorded is not
            finite; n where there is none.
        left: Of each limit, position of the first time at which its margin is not positive; n
            where there is none.
        margins: Of the limits, (n, number of limits), where they are asked for.
    """

    table: Vector
    unknowns: Vector
    lost: int
    left: tuple[int, ...]
    margins: Vector


def observe(
    dae: Dae,
    solved: Solved,
    places: tuple[int, ...],
    *,
    limits: bool,
    margins: bool,
    compiled: bool,
) -> Observed:
    """Evaluate what is recorded of a run, and the limits.

    Args:
        dae: The model.
        solved: The run.
        places: Of what is recorded among `all_columns`.
        limits: Whether to look at the limits.
        margins: Whether their margins are asked for.
        compiled: Whether by machine code.
    """
    n, nx = len(solved.time), len(dae.states)
    if not n:
        sizes = len(places), len(dae.algebraics), len(dae.limits)
        table, unknowns, none = (np.empty((0, size)) for size in sizes)
        return Observed(table, unknowns, 0, (0,) * len(dae.limits), none)
    computed = max(places, default=0) >= nx
    if not (computed or limits or dae.algebraics):
        return _states_alone(solved, places)
    several = compiled and n >= _WORTHWHILE
    if several and (library := _lane_library(dae, limits_only=not computed)) is not None:
        return _in_lanes(library, dae, solved, places, margins=margins)
    return _one_by_one(dae, solved, places, limits=limits, compiled=compiled)


def _states_alone(solved: Solved, places: tuple[int, ...]) -> Observed:
    """Return what `observe` does where there is nothing to evaluate."""
    rows = solved.states.T  # as solvers write them
    table, none = rows.take(_as_array(places), axis=1), np.empty((len(rows), 0))
    return Observed(table, none, finite_rows(rows), (), none)


def _one_by_one(
    dae: Dae, solved: Solved, places: tuple[int, ...], *, limits: bool, compiled: bool
) -> Observed:
    """Return what `observe` does, for any model."""
    n, known = len(solved.time), len(dae.states) + len(dae.algebraics)
    function = _observer(dae, n, compiled)
    rows = np.empty((n, function.size1_out(0)))
    u = np.broadcast_to(solved.u, (len(solved.u), n))
    arguments = (solved.time, solved.states.T, solved.guesses.T, u.T, solved.p)
    call_on_arrays(function, arguments, (rows,))
    every = np.hstack((solved.states.T, rows))
    looked_at = every[:, sorted({*range(known), *places})]
    lost = _first(~np.isfinite(looked_at).all(axis=1))
    margins = every[:, every.shape[1] - len(dae.limits) :] if limits else np.empty((n, 0))
    left = tuple(_first(~(margin > 0)) for margin in margins.T)  # what is no number is outside
    return Observed(every[:, places], every[:, len(dae.states) : known], lost, left, margins)


def _first(where: ArrayLike) -> int:
    """Return the first place that is true; the length where none is."""
    found = np.flatnonzero(where)
    return int(found[0]) if found.size else np.size(where)


@kept_per_thread(16)
def _lane_library(dae: Dae, *, limits_only: bool) -> ctypes.CDLL | None:
    """Return the outputs of an explicit form for several times at once, where lanes have them."""
    if dae.algebraics or not dae.states:
        return None
    try:
        return lane_outputs(dae, processor_lanes(), limits_only=limits_only)
    except UsageError:  # an operation that lanes do not have
        return None


def _in_lanes(
    library: ctypes.CDLL, dae: Dae, solved: Solved, places: tuple[int, ...], *, margins: bool
) -> Observed:
    """Return what `observe` does, for explicit forms."""
    n = len(solved.time)
    table, first = np.empty((n, len(places))), np.empty(1 + len(dae.limits), dtype=np.int64)
    given = [solved.time, solved.states.T, solved.u.T, solved.p]
    held = [*map(np.ascontiguousarray, given)]
    found = np.empty((n, len(dae.limits) if margins else 0))
    recorded = _as_array(places)
    library.lanes_outputs(
        Watched(
            n,
            len(held[2]),
            *(part.ctypes.data for part in held),
            len(places),
            *(part.ctypes.data for part in (recorded, table, first)),
            found.ctypes.data if margins else None,
        )
    )
    lost, *left = first.tolist()
    return Observed(table, np.empty((n, 0)), lost, tuple(left), found)


@kept_per_thread(16)
def _as_array(places: tuple[int, ...]) -> NDArray[np.int64]:
    return np.array(places, dtype=np.int64)


@kept_per_thread(64)
def all_columns(dae: Dae) -> tuple[Column, ...]:
    """Return the columns of everything observable: states, algebraic unknowns, outputs."""
    return tuple(
        Column(v.name, v.unit, v.display_unit, v.nominal, v.meaning)
        for v in (*dae.states, *dae.algebraics, *dae.output_variables)
    )


@kept_per_thread(16)
def recorded_columns(
    dae: Dae, names: tuple[str, ...]
) -> tuple[tuple[Column, ...], tuple[int, ...]]:
    """Return the columns of these names, and their places among `all_columns`."""
    every = all_columns(dae)
    place = {column.name: i for i, column in enumerate(every)}
    places = tuple(place[name] for name in names)
    return tuple(every[i] for i in places), places


@kept_per_thread(8)
def watching(dae: Dae, names: tuple[str, ...]) -> Dae:
    """Return the DAE with those of its monitors among the outputs that are named."""
    return dae.watching(names)


def recording(dae: Dae, outputs: Sequence[str] | None) -> tuple[Dae, tuple[str, ...]]:
    """Return the DAE with the monitors that are named, and the names to record.

    Raises:
        UnknownName: The model has no such output.
        UsageError: It is named twice, or these are no names.
    """
    if outputs is None:
        return dae, dae.observed
    names = listed(f"{dae.full_name}: outputs", outputs)
    dae = watching(dae, names)
    available = {column.name for column in all_columns(dae)}
    for name in names:
        if name not in available:
            raise no_such_output(dae, name)
        if names.count(name) > 1:
            raise UsageError(f"{dae.full_name}: output '{name}' is named twice; name it once")
    return dae, names


@kept_per_thread(16)
def _observer(dae: Dae, n: int, compiled: bool) -> ca.Function:
    """Return `observe(t, x, z, u, p) -> rows` for n times, a column each."""
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
