"""An FMU as the subject of a sweep: one instance per process, reset before each run."""

import atexit
from collections.abc import Mapping, Sequence
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from cosim.arrays import Vector
from cosim.errors import FmuError, ParameterError, UsageError
from cosim.fmi.run.opened import OpenedFmu
from cosim.integrate.ensemble.ensemble import Ensemble, RunState
from cosim.study.sweep.samples import digest_of
from cosim.study.sweep.store import Watch
from cosim.study.sweep.subjects.subject import Rows
from cosim.trajectory import Column

_TAKEN = ("start_time", "stop_time", "output_interval", "relative_tolerance")


class FmuSubject:
    """An FMU file that is unpacked and instantiated once."""

    def __init__(self, path: str) -> None:
        self._fmu = OpenedFmu(path)
        atexit.register(self._fmu.close)
        self.name = str(self._fmu.description.modelName)
        self.digest = digest_of([Path(path).read_bytes()])

    def columns(self, outputs: Sequence[str] | None) -> tuple[Column, ...]:
        """Return what is recorded."""
        return self._fmu.columns(outputs)

    def unit(self, name: str) -> str | None:
        """Return None: numbers are in the FMU's own units."""
        return None

    def prepare(self, names: Sequence[str], settings: Mapping[str, Any]) -> str:
        """Refuse what cannot be set; say how the runs are computed."""
        self._fmu.settable(dict.fromkeys(names, 0.0))
        for name in settings:
            if name not in (*_TAKEN, "outputs"):
                raise UsageError(
                    f"{self._fmu.path}: a sweep of an FMU takes no {name}; "
                    f"give {', '.join(_TAKEN)} or outputs"
                )
        return f"fmpy {self._fmu.kind}"

    def run(self, rows: Rows, watch: Watch) -> Ensemble:
        """Run every row, one by one."""
        began = perf_counter()
        runs, given, outputs = len(rows), rows.given, rows.outputs
        states, reasons, notes = [RunState.FAILED] * runs, dict[int, str](), dict[int, str]()
        found: dict[int, Vector] = {}
        taken = {name: value for name, value in rows.settings.items() if name in _TAKEN}
        time = self._fmu.times(*(taken.get(name) for name in _TAKEN[:3]))
        for i in range(runs):
            watch(i)
            row = {name: float(column[i]) for name, column in given.items()}
            try:
                run = self._fmu.simulate(row, outputs=outputs, **taken)
            except ParameterError as error:
                states[i], reasons[i] = RunState.REFUSED, str(error)
            except FmuError as error:
                reasons[i] = str(error)
            else:
                if len(run) == len(time):
                    states[i], found[i] = RunState.COMPLETE, run.values
                    if "note" in run.stats:
                        notes[i] = run.stats["note"]
                else:
                    reasons[i] = f"it recorded {len(run)} of {len(time)} output times"
        values = np.full((runs, len(time), len(outputs)), np.nan)
        for i, table in found.items():
            values[i] = table
        counts = np.zeros(runs, dtype=np.int64)
        return Ensemble(
            self.name,
            time,
            self.columns(outputs),
            values,
            given,
            tuple(states),
            reasons,
            notes,
            reached=np.where([i in found for i in range(runs)], len(time), 0),
            steps=counts,
            rhs_calls=counts,
            error=np.full(runs, np.nan),
            stats={"solver": f"fmpy {self._fmu.kind}", "wall_time": perf_counter() - began},
        )
