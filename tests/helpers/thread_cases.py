"""Threads that share a system, drawn with a seed: each does what it would do alone, or is told why.

Some of them ask for what is wrong, and some own a session of the same system.
"""

import pickle
import random
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier
from typing import Any

import numpy as np

import cosim
from cosim.coupling.system import System
from cosim.errors import CosimError

_STOP, _STEP = 0.2, 0.02
_METHODS = ("jacobi", "gauss_seidel", "extrapolated", "iterated")
_WRONG = ({"macro_step": -1.0}, {"outputs": ["b.q"]}, {"start_values": {"a.q": 1.0}})


def _way(method: str) -> dict[str, Any]:
    return {"macro_step": _STEP, "method": method, "stop_time": _STOP}


def _run(system: System, method: str) -> np.ndarray:
    return system.simulate(**_way(method)).values[-1]


def _session(system: System, method: str) -> np.ndarray:
    with cosim.open(system, **_way(method)) as session:
        for k in range(1, round(_STOP / _STEP) + 1):
            session.advance(to=k * _STEP)
        return session.get()


def _copy(system: System, method: str) -> np.ndarray:
    return _run(pickle.loads(pickle.dumps(system)), method)


def faults_of_threads(
    seed: int, new: Callable[[], System], known: dict[str, np.ndarray]
) -> Counter[str]:
    """Return how many threads ended badly, by kind; `known` holds runs alone, by method."""
    draw = random.Random(seed)
    shared, method = new(), draw.choice(_METHODS)
    expected = known[method] = known[method] if method in known else _run(new(), method)
    # the session of a system of models has no macro steps
    kinds = (_run, _copy, None) if shared.is_model else (_run, _copy, None, _session)
    tasks = [draw.choice(kinds) for _ in range(draw.randint(2, 8))]
    wrong = [draw.choice(_WRONG) for _ in tasks]
    start = Barrier(len(tasks))

    def end(number: int) -> str:
        task = tasks[number]
        start.wait()
        try:
            if task is None:
                shared.simulate(**{**_way(method), **wrong[number]})
                return "silent"
            found = task(shared, method)
        except CosimError:
            return "" if task is None else "other"
        except Exception:
            return "traceback"
        if not np.isfinite(found).all():
            return "nan"
        return "" if np.array_equal(found, expected) else "silent"

    with ThreadPoolExecutor(len(tasks)) as pool:
        ends = [*pool.map(end, range(len(tasks)))]
    return Counter(filter(None, ends))


def systems(folder: Path, fmu: Path) -> dict[str, Callable[[], System]]:
    """Return functions that make the systems: of models, with a file, and from an SSP file."""
    wires = {"b.T2": "a.T"}

    def of_models() -> System:
        return cosim.couple({"a": "crank_shaft", "b": "bar_on_frame"}, wires)

    def with_file() -> System:
        return cosim.couple({"a": fmu, "b": "bar_on_frame"}, wires)

    ssp = with_file().write_ssp(folder / "pair.ssp")
    return {"models": of_models, "file": with_file, "ssp": lambda: cosim.read_ssp(ssp)}
