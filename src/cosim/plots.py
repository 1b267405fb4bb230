"""Pictures of runs in the units that the book prints."""

import math
from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from casadi_models.units import UNITS
from cosim.errors import UnknownName
from cosim.files import write_atomically
from cosim.trajectory import Column, Trajectory

FORMATS = ("png", "svg", "pdf")
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
        axis.plot(shown.time, in_display_unit(shown[column.name], column), linewidth=1.2)
        axis.set_title(column.meaning or column.name, fontsize=9)
        axis.set_ylabel(f"{column.name} [{column.display_unit or column.unit}]", fontsize=9)
        axis.grid(alpha=0.4)
        axis.tick_params(labelsize=8, labelbottom=True)
        _keep_constant_lines_flat(axis, shown[column.name], column)
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


def save(figure: Figure, target: str) -> None:
    """Write a figure as PNG, SVG or PDF, by the ending of the name; whole or not at all.

    Raises:
        UnknownName: The ending is another one.
        ExportError: The file cannot be written.
    """
    import io

    kind = Path(target).suffix.lstrip(".").lower()
    if kind not in FORMATS:
        raise UnknownName.among(target, "picture format", kind, FORMATS)
    content = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "cosim"}):
        figure.savefig(content, format=kind, dpi=120)
    write_atomically(target, content.getvalue())


def show(figure: Figure) -> None:
    """Show a figure in a window until it is closed."""
    import matplotlib.pyplot as plt

    window = plt.figure(figsize=figure.get_size_inches())
    manager = window.canvas.manager
    if manager is not None:
        figure.set_canvas(manager.canvas)
        manager.canvas.figure = figure
    plt.show()


def _keep_constant_lines_flat(axis: object, values: np.ndarray, column: Column) -> None:
    """Widen the range around a constant, whose rounding errors would fill the panel."""
    span = float(np.ptp(values))
    if span < 1e-9 * max(column.nominal, float(np.abs(values).max())):
        middle = float(in_display_unit(values[:1], column)[0])
        margin = 0.1 * abs(middle) or 1.0
        axis.set_ylim(middle - margin, middle + margin)  # type: ignore[attr-defined]
