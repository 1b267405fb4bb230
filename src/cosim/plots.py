"""Pictures of runs in the units that the book prints."""

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from casadi_models.units import UNITS
from cosim.trajectory import Column, Trajectory

MOST_PANELS = 24


def plot_trajectory(run: Trajectory, names: Sequence[str] | None = None) -> Figure:
    """Draw every variable over time in its display unit, one panel each.

    Args:
        run: What to draw.
        names: Which variables, at most 24; the first 24 when None.

    Raises:
        UnknownName: A variable was not recorded.
    """
    shown = run.select(names if names is not None else run.names[:MOST_PANELS])
    across = min(3, len(shown.columns))
    down = math.ceil(len(shown.columns) / across)
    figure = Figure(figsize=(4.2 * across, 2.3 * down + 0.4), layout="constrained")
    axes = figure.subplots(down, across, squeeze=False, sharex=True).ravel()
    for axis, column in zip(axes, shown.columns, strict=False):
        values = in_display_unit(shown[column.name], column)
        axis.plot(shown.time, values, linewidth=1.2)
        axis.set_title(column.meaning or column.name, fontsize=9)
        axis.set_ylabel(f"{column.name} [{column.display_unit or column.unit}]", fontsize=9)
        axis.grid(alpha=0.4)
        axis.tick_params(labelsize=8, labelbottom=True)
        keep_constant_flat(axis, values, float(in_display_unit(np.array(column.nominal), column)))
    for axis in axes[len(shown.columns) :]:
        axis.set_visible(False)
    for axis in axes[max(0, len(shown.columns) - across) : len(shown.columns)]:
        axis.set_xlabel("time [s]", fontsize=9)
    suffix = "" if run.complete else f" ({run.status})"
    figure.suptitle(f"{run.model}{suffix}", fontsize=11)
    return figure


def in_display_unit(values: np.ndarray, column: Column) -> np.ndarray:
    """Convert SI values of a variable to its display unit."""
    if column.display_unit is None or column.unit not in UNITS:
        return values
    return values * UNITS[column.unit].factor / UNITS[column.display_unit].factor


def keep_constant_flat(axis: Axes, values: np.ndarray, nominal: float) -> None:
    """Widen the range around constant curves, whose numerical errors would fill the panel.

    Args:
        axis: Where they are drawn.
        values: What is drawn, (n,) or (n, curves), in the unit of the axis.
        nominal: Typical size, in the same unit.
    """
    if np.ptp(values) < max(1e-9 * nominal, 1e-6 * float(np.abs(values).max())):
        middle = float(values.flat[0])
        margin = 0.1 * abs(middle) if abs(middle) > 1e-9 * nominal else nominal
        axis.set_ylim(middle - margin, middle + margin)
