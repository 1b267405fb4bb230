"""From states to everything that a run records."""

import ctypes

import casadi as ca
import numpy as np
from casadi import MX

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.codegen.casadi_library import cache_key, external
from cosim.codegen.initialization import algebraic_function
from cosim.codegen.runge_kutta.lane_library import lane_outputs, processor_lanes
from cosim.errors import UsageError
from cosim.integrate.run.call import call_on_arrays
from cosim.memo import kept_per_thread
from cosim.model.catalogue import no_such_output
from cosim.trajectory import Column

_WORTHWHILE = 8  # times; for fewer, other code is at hand


def observe(
    dae: Dae, time: Vector, states: Vector, guesses: Vector, u: Vector, p: Vector, compiled: bool
) -> tuple[Vector, Vector]:
    """Evaluate algebraic unknowns, outputs and limits from the states.

    Args:
        dae: The model.
        time: s, (n,).
        states, guesses, u: At these times: states, algebraic unknowns, inputs; n columns each.
        p: Parameters.
        compiled: Whether by machine code.

    Returns:
        What `all_columns` names, and the margins of the limits; one row per time each.
    """
    n, known = len(time), len(all_columns(dae))
    if not n:
        return np.empty((0, known)), np.empty((0, len(dae.limits)))
    if compiled and n >= _WORTHWHILE and (library := _lane_library(dae)) is not None:
        return _in_lanes(library, dae, time, states, u, p)
    function = _observer(dae, n, compiled)
    rows = np.empty((n, function.size1_out(0)))
    call_on_arrays(function, (time, states.T, guesses.T, u.T, p), (rows,))
    every = np.hstack((states.T, rows))
    every.setflags(write=False)  # a trajectory of it need not copy
    return every[:, :known], every[:, known:]


@kept_per_thread(16)
def _lane_library(dae: Dae) -> ctypes.CDLL | None:
    """Return the outputs of an explicit form for several times at once, where lanes have them."""
    if dae.algebraics or not dae.states:
        return None
    try:
        return lane_outputs(dae, processor_lanes())
    except UsageError:  # an operation that lanes do not have
        return None


def _in_lanes(
    library: ctypes.CDLL, dae: Dae, time: Vector, states: Vector, u: Vector, p: Vector
) -> tuple[Vector, Vector]:
    """Return what `observe` does, for explicit forms."""
    n, nx, known = len(time), len(states), len(all_columns(dae))
    rows = np.empty((n, known + len(dae.limits)))
    rows[:, :nx] = states.T
    held = [np.ascontiguousarray(part, dtype=float) for part in (time, states.T, u.T, p)]
    place = rows.ctypes.data + nx * rows.itemsize
    library.lanes_outputs(n, *(part.ctypes.data for part in held), place, rows.shape[1])
    rows.setflags(write=False)
    return rows[:, :known], rows[:, known:]


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


def wanted_names(dae: Dae, outputs: tuple[str, ...] | None) -> tuple[str, ...]:
    """Return the names to record.

    Raises:
        UnknownName: The model has no such output.
        UsageError: It is named twice.
    """
    if outputs is None:
        return dae.observed
    available = {column.name for column in all_columns(dae)}
    for name in outputs:
        if name not in available:
            raise no_such_output(dae, name)
        if outputs.count(name) > 1:
            raise UsageError(f"{dae.full_name}: output '{name}' is named twice; name it once")
    return outputs


@kept_per_thread(16)
def _observer(dae: Dae, n: int, compiled: bool) -> ca.Function:
    """Return `observe(t, x, z, u, p) -> rows` for n times, a column each."""
    names = ["t", "x", "z", "u", "p"]
    symbols = [dae.t, dae.x, dae.z, dae.u, dae.p]
    margins = (margin for margin, _ in dae.limits)
    outputs = ca.Function("outputs", symbols, [ca.vertcat(dae.outputs, *margins)], {"cse": True})
    t, x, z, u, p = (MX.sym(n, s.numel()) for n, s in zip(names, symbols, strict=True))
    solved = algebraic_function(dae)(t, x, z, u, p)
    rows = ca.densify(ca.vertcat(solved, outputs(t, x, solved, u, p)))  # cse makes zeros sparse
    function = ca.Function("observe", [t, x, z, u, p], [rows], names, ["rows"])
    if n == 1:
        return function
    if compiled:
        (function,) = external([function], cache_key("observe", function), ["observe"])
    return function.map("every", "serial", n, [4], [])
