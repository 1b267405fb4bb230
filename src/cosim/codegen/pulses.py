"""`pulse_times`: where equations change in a time that a solver may step over.

A term of the equations that depends on time alone, such as exp(-((t - 5)/1e-3)**2), has no effect
on a solver whose stages all lie beside it. Such terms are sampled before a run. Where one of them
rests for a part of the longest step and changes in the rest of it, steps end so closely that none
spans more than a part of the change.
"""

import casadi as ca
import numpy as np
from casadi import SX

from casadi_models.dae import Dae
from casadi_models.dae.single_terms import time_terms
from cosim.arrays import Vector
from cosim.memo import cached_per_thread

SAMPLES = 100_000  # of a run; a shorter pulse may lie between two of them
_CLOSER = 1_000  # of a place in which a term changes
_LARGE = 0.1  # least change of a term in a step, as a share of its range in the run
_BLOCKS = 24  # parts of a step in which a term rests or changes
_RESTS = 0.01  # change of a resting term in such a part, as a share of all its changes in the step
_MOST_CHANGING = 2 / 3  # part of a step; a term that changes for longer meets a stage of every step
_PARTS = 8  # of the range of a term and of the time of a pulse, at whose ends a step ends
_MOST_ENDS = SAMPLES // 10  # of steps; more of them show a term that the samples do not resolve
_ENDS = 1e-5  # change before and after a pulse, as a share of the range


def pulse_times(dae: Dae, p: Vector, begin: float, end: float, longest: float) -> Vector:
    """Return the times at which steps must end for a solver to see all terms of time, s.

    Args:
        dae: The model, with frozen relations.
        p: Parameters.
        begin, end: Times of the run, s.
        longest: Longest step of the solver, s.
    """
    terms, rows = _terms(dae)
    if not terms.numel() or not longest > 0:
        return np.empty(0)
    return _pulse_times(dae, p[list(rows)].tobytes(), begin, end, longest)


def pulse_within_a_step(dae: Dae, p: Vector, begin: float, end: float, longest: float) -> bool:
    """Return whether a whole pulse may lie within a step of a solver; see `pulse_times`."""
    times = pulse_times(dae, p, begin, end, longest)
    pulses = np.split(times, np.flatnonzero(np.diff(times) > longest) + 1)
    return any(0 < np.ptp(pulse) < longest for pulse in pulses if len(pulse))


def pulse_parameters(dae: Dae) -> tuple[str, ...]:
    """Return the parameters on which the terms of time depend."""
    return tuple(dae.parameters[i].name for i in _terms(dae)[1])


@cached_per_thread(64)
def _terms(dae: Dae) -> tuple[SX, tuple[int, ...]]:
    """Return the terms of time, and the positions of the parameters on which they depend."""
    terms = time_terms(dae)
    which = ca.which_depends(terms, dae.p, 1, False) if terms.numel() and dae.p.numel() else []
    return terms, tuple(i for i, depends in enumerate(which) if depends)


@cached_per_thread(32)
def _sampler(dae: Dae, count: int) -> ca.Function:
    terms, rows = _terms(dae)
    function = ca.Function("terms", [dae.t, dae.p[list(rows)]], [terms], {"cse": True})
    return function.map("sampled", "serial", count, [1], [])


@cached_per_thread(64)
def _pulse_times(dae: Dae, p: bytes, begin: float, end: float, longest: float) -> Vector:
    t, values = _sampled(dae, p, begin, end, SAMPLES)
    count = min(max(1, round(longest / (end - begin) * SAMPLES)), SAMPLES)
    found = list[Vector]()
    for i, column in enumerate(values.T):
        size = float(np.ptp(column))
        if not (np.isfinite(size) and size > 0):
            continue
        for first, last in _places(column, _LARGE * size, count):
            near, fine = _sampled(dae, p, float(t[first]), float(t[last]), _CLOSER)
            found.append(parted(near, fine[:, i], size))
    times = np.unique(np.concatenate([np.empty(0), *found]))
    if len(times) > _MOST_ENDS:
        times = np.empty(0)
    times.setflags(write=False)
    return times


def parted(t: Vector, values: Vector, size: float) -> Vector:
    """Return times that divide a pulse into parts of little change and equal parts of time.

    The values are those of the term at the times, and the size is its range in the run.
    """
    size = max(size, float(np.ptp(values)))
    if not size:
        return t[[0, -1]]
    change = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(values))))) / size
    first, last = np.interp([_ENDS, change[-1] - _ENDS], change, t)
    way = change + np.clip((t - first) / max(last - first, np.spacing(last)), 0, 1)
    begin, end = np.interp([first, last], t, way)
    ends: Vector = np.interp(np.linspace(begin, end, int((end - begin) * _PARTS) + 2), way, t)
    return ends


@cached_per_thread(2)
def _sampled(dae: Dae, p: bytes, begin: float, end: float, count: int) -> tuple[Vector, Vector]:
    """Return equidistant times and the terms there, (count,) and (count, n)."""
    t = np.linspace(begin, end, count)
    return t, np.array(_sampler(dae, count)(t[None], np.frombuffer(p))).T


def _places(values: Vector, large: float, count: int) -> list[tuple[int, int]]:
    """Return where a term changes for a small part of some samples: first and last sample.

    A change matters if it is large; `count` samples are in the longest step.
    """
    size = max(1, count // _BLOCKS)
    width = min(max(3, round(count / size)), (len(values) - 1) // size)
    change = np.abs(np.diff(values))[: (len(values) - 1) // size * size]
    blocks = change.reshape(-1, size).sum(axis=1)
    starts = np.unique(np.append(np.arange(0, len(blocks) - width, max(1, width // 4)),
                                 len(blocks) - width))  # fmt: skip
    total = np.concatenate(([0.0], np.cumsum(blocks)))
    whole = total[starts + width] - total[starts]
    starts, whole = starts[whole > large], whole[whole > large]
    steps = starts[:, None] + np.arange(width)
    moves = blocks[steps] > _RESTS * whole[:, None]
    narrow = moves.mean(axis=1) < _MOST_CHANGING
    marked = np.zeros(len(blocks) + 2, dtype=int)
    marked[1 + steps[narrow][moves[narrow]]] = 1
    edges = np.flatnonzero(np.diff(marked)).reshape(-1, 2) * size
    around = edges + np.outer(edges[:, 1] - edges[:, 0], [-1, 1])
    return [(int(a), int(b)) for a, b in np.clip(around, 0, len(values) - 1)]
