"""Curves of arrays over time, and figures as files."""

import io
import math
from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from textwrap import fill
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cosim.arrays import Vector

DPI = 120
# Okabe and Ito's colours, which colour-blind readers can tell apart, and lines for printers
# without colour
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
LINES: tuple[Any, ...] = ("-", (0, (6, 2)), (0, (3, 1, 1, 1)), (0, (1, 1)), "-.", "--")
STYLE: Any = {  # matplotlib types its keys one by one
    "font.size": 9,
    "axes.axisbelow": True,
    "axes.grid": True,
    "axes.labelsize": 9,
    "axes.linewidth": 0.6,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlesize": 10,
    "grid.alpha": 0.35,
    "grid.linewidth": 0.5,
    "legend.fontsize": 8,
    "legend.framealpha": 0.8,
    "lines.linewidth": 1.3,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
}
INVALID = "#A02020"
UNDATED = {"png": {}, "svg": {"Date": None}, "pdf": {"CreationDate": None}}


class Picture(Figure):
    """A figure that a notebook shows without further ado."""

    def _repr_png_(self) -> bytes:
        return picture(self, "png")


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


def draw_panels(
    title: str,
    time: Vector,
    panels: Sequence[Panel],
    *,
    invalid_from: float = math.inf,
    reasons: Sequence[str] = (),
) -> Figure:
    """Draw variables over time, a panel each.

    Args:
        title: Stands above them; broken into lines where it is long.
        time: s, (n,).
        panels: What is drawn, (n,) values each.
        invalid_from: From when on the values say nothing, s: that span is shaded.
        reasons: Why, a sentence each.
    """
    across = min(3, len(panels))
    down = math.ceil(len(panels) / across)
    width = 4.2 * across
    head = fill(title, int(width * 11))
    told = invalid_text(invalid_from, reasons, width)
    lines = head.count("\n") + bool(told) * (told.count("\n") + 1)
    with matplotlib.rc_context(STYLE):
        figure = Picture(figsize=(width, 2.3 * down + 0.4 + 0.18 * lines), layout="constrained")
        axes = figure.subplots(down, across, squeeze=False, sharex=True).ravel()
        for axis, panel in zip(axes, panels, strict=False):
            axis.plot(time, panel.values, linewidth=1.2, color=COLOURS[0])
            axis.set_title(fill(panel.title, 52), fontsize=9)
            axis.set_ylabel(panel.label, fontsize=9)
            axis.tick_params(labelbottom=True)
            axis.margins(x=0)
            keep_constant_flat(axis, panel.values, panel.nominal)
            shade_invalid(axis, time, invalid_from)
    for axis in axes[len(panels) :]:
        axis.set_visible(False)
    for axis in axes[max(0, len(panels) - across) : len(panels)]:
        axis.set_xlabel("time [s]", fontsize=9)
    figure.suptitle(head, fontsize=11)
    if told:
        figure.supxlabel(told, fontsize=8, color=INVALID)
    return figure


def draw_costs(
    title: str, labels: tuple[str, str], points: Mapping[str, Sequence[tuple[float, float]]]
) -> Figure:
    """Draw points on logarithmic axes, a line for each name.

    Args:
        title: Stands above them.
        labels: Of the horizontal and the vertical axis.
        points: (x, y) by name, positive.
    """
    with matplotlib.rc_context(STYLE):
        figure = Picture(figsize=(5.6, 3.6), layout="constrained")
        axis = figure.subplots()
        axis.set_xscale("log")
        axis.set_yscale("log")
        for i, (name, pairs) in enumerate(points.items()):
            look = {"color": COLOURS[i % len(COLOURS)], "linestyle": LINES[i % len(LINES)]}
            axis.plot(
                *zip(*sorted(pairs), strict=True), marker="o", markersize=3, label=name, **look
            )
        axis.set_xlabel(labels[0])
        axis.set_ylabel(labels[1])
        axis.set_title(title)
        if points:
            axis.legend()
    return figure


def shade_invalid(axis: Axes, time: Vector, invalid_from: float) -> None:
    """Shade the span of a time axis in which a run is outside its model."""
    if not len(time) or invalid_from > time[-1]:
        return
    end = max(float(time[-1]), invalid_from)
    axis.axvspan(invalid_from, end, color=INVALID, alpha=0.12, linewidth=0, zorder=0)
    axis.axvline(invalid_from, color=INVALID, linewidth=0.8, zorder=1)


def invalid_text(invalid_from: float, reasons: Sequence[str], width: float) -> str:
    """Return what a picture says of an invalid span, in lines for a width in inches."""
    if not reasons:
        return ""
    plain = [reason.removeprefix(f"from {invalid_from:g} s on ") for reason in reasons]
    more = f" (and {len(plain) - 1} more)" if len(plain) > 1 else ""
    text = f"shaded: INVALID from {invalid_from:g} s on: {plain[0]}{more}"
    return fill(text, int(width * 14), max_lines=5, placeholder=" ...")


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


def embedded(figure: Figure, alt: str) -> str:
    """Return a figure as HTML that needs no file."""
    content = b64encode(picture(figure, "png", dpi=60)).decode()
    return f'<img alt="{alt}" src="data:image/png;base64,{content}"/>'


def picture(figure: Figure, kind: str, dpi: int = DPI) -> bytes:
    """Return the content of a picture file; same figure, same bytes."""
    content = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "cosim"}):
        figure.savefig(content, format=kind, dpi=dpi, metadata=UNDATED[kind])
    return content.getvalue()
