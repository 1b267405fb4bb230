"""Curves of arrays over time, and figures as files."""

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cosim.arrays import Vector

DPI = 120
UNDATED = {"png": {}, "svg": {"Date": None}, "pdf": {"CreationDate": None}}


@dataclass(frozen=True)
class Panel:
    """One variable over time.

    Attributes:
        title: What it means.
        label: Its name and unit.
        values: (n,), in that unit.
        nominal: Its typical size, in that unit.
    """

    title: str
    label: str
    values: Vector
    nominal: float


def draw_panels(title: str, time: Vector, panels: Sequence[Panel]) -> Figure:
    """Draw variables over time, a panel each."""
    across = min(3, len(panels))
    down = math.ceil(len(panels) / across)
    figure = Figure(figsize=(4.2 * across, 2.3 * down + 0.4), layout="constrained")
    axes = figure.subplots(down, across, squeeze=False, sharex=True).ravel()
    for axis, panel in zip(axes, panels, strict=False):
        axis.plot(time, panel.values, linewidth=1.2)
        axis.set_title(panel.title, fontsize=9)
        axis.set_ylabel(panel.label, fontsize=9)
        axis.grid(alpha=0.4)
        axis.tick_params(labelsize=8, labelbottom=True)
        keep_constant_flat(axis, panel.values, panel.nominal)
    for axis in axes[len(panels) :]:
        axis.set_visible(False)
    for axis in axes[max(0, len(panels) - across) : len(panels)]:
        axis.set_xlabel("time [s]", fontsize=9)
    figure.suptitle(title, fontsize=11)
    return figure


def keep_constant_flat(axis: Axes, values: Vector, nominal: float) -> None:
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


def picture(figure: Figure, kind: str, dpi: int = DPI) -> bytes:
    """Return the content of a picture file; same figure, same bytes."""
    content = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "cosim"}):
        figure.savefig(content, format=kind, dpi=dpi, metadata=UNDATED[kind])
    return content.getvalue()
