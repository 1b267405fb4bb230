"""Output times as a caller asks for them, and a run at other times than it was asked for."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.errors import UsageError
from cosim.integrate.plan import Times
from cosim.integrate.simulate import simulate
from cosim.model.time_grid import checked_grid
from cosim.model.values import number
from cosim.trajectory import Trajectory


class AskedTimes:
    """Output times: begin, end and interval, or an array of one's own."""

    def __init__(
        self,
        dae: Dae,
        start: float,
        stop: float | None,
        interval: float | None,
        own: ArrayLike | None,
    ) -> None:
        self.dae = dae
        if interval is not None:
            interval = number("run", "output_interval", interval, positive=True)
        self.given: dict[str, Any] = {
            "start_time": start,
            "stop_time": stop,
            "output_interval": interval,
        }
        self.led = False  # by a start that nobody asked for
        if own is None:
            return
        for name in ("stop_time", "output_interval"):
            if self.given[name] is not None:
                raise UsageError(f"{dae.full_name}: output_times say it all; leave {name} out")
        try:
            wanted = np.atleast_1d(np.array(own, dtype=float))
        except (TypeError, ValueError):
            raise UsageError.of_type("output_times", own, "times in s, (n,)") from None
        self.led = bool(wanted.ndim == 1 and wanted.size and wanted[0] != start)
        if wanted.size == 1 and not self.led:
            self.given["stop_time"] = start
            return
        grid = np.concatenate(([start], wanted)) if self.led else wanted
        self.given["output_interval"] = checked_grid(grid)

    def grid(self) -> Vector:
        """Return all of them, s, (n,)."""
        return Times(*self.given.values()).grid(self.dae)

    def asked(self, run: Trajectory) -> Trajectory:
        """Return a run without the start that nobody asked for."""
        return replace(run, time=run.time[1:], values=run.values[1:]) if self.led else run


def again(dae: Dae, run: Mapping[str, Any], begin: float, end: float, times: Vector) -> Trajectory:
    """Compute a run at other times; where it begins and ends stays, so that its steps do, too."""
    grid = np.unique(np.concatenate(([begin], times, [end])))
    if len(grid) < 2:
        grid = np.array([begin, np.nextafter(begin, np.inf)])
    found = simulate(dae, output_interval=grid, **run)
    rows = np.searchsorted(found.time, times)
    return replace(found, time=found.time[rows], values=found.values[rows])
