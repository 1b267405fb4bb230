"""Rows of an FMU's run in a file of its process, which stay when the process is ended."""

import pickle
from pathlib import Path

import numpy as np

from cosim.arrays import Vector
from cosim.fmi.run.request import FmuRequest
from cosim.host.last_call import noted_in
from cosim.trajectory import Trajectory

_FACTS, _ROWS = "facts.pickle", "rows"
_BLOCK = 1000  # rows that are looked at together


def new_rows(request: FmuRequest) -> Vector:
    """Return an array for the outputs of a run, (n, outputs).

    Within `calls_noted_in`, that of the first run is shared with the parent process.
    """
    folder, shape = noted_in(), (len(request.points), len(request.recorded))
    if folder is None or (folder / _ROWS).exists() or not min(shape):
        return np.empty(shape)
    facts = request.description.modelName, request.points, request.columns
    (folder / _FACTS).write_bytes(pickle.dumps(facts))
    rows: Vector = np.memmap(folder / _ROWS, np.float64, "w+", shape=shape).view(np.ndarray)
    rows[:] = np.nan
    return rows


def kept_run(folder: Path, status: str) -> Trajectory | None:
    """Return what a child process has recorded of its first run; None if there is nothing."""
    try:
        name, times, columns = pickle.loads((folder / _FACTS).read_bytes())
        mapped = np.memmap(folder / _ROWS, np.float64, "r").reshape(-1, len(columns))
    except (OSError, ValueError, EOFError, pickle.UnpicklingError):
        return None
    count, more = 0, _BLOCK
    while more == _BLOCK:  # most of a file may be empty
        complete = np.isfinite(mapped[count : count + _BLOCK]).all(axis=1)
        more = int(np.append(complete, False).argmin())
        count += more
    rows = np.array(mapped[:count])
    return Trajectory(name, times[:count], columns, rows, status=status) if count else None
