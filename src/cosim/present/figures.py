"""The figures that a scene asks for, of one run or of two with their difference."""

from collections.abc import Collection, Sequence
from textwrap import fill
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from cosim.errors import UsageError
from cosim.plotting import (
    COLOURS,
    INVALID,
    LINES,
    STYLE,
    Picture,
    invalid_text,
    keep_constant_flat,
    shade_invalid,
)
from cosim.scene.scene import FigureSpec
from cosim.trajectory import Trajectory
from cosim.verify.comparison import refuse_other_times

_SECOND: Any = {"color": "black", "linewidth": 0.9, "linestyle": (0, (4, 4))}
_WIDTH, _PAD = 6.4, 0.07  # inches
VARIABLES_PER_FIGURE = 3  # where nobody says how to group them


def draw_figures(
    specs: Sequence[FigureSpec], run: Trajectory, other: Trajectory | None = None
) -> list[Figure]:
    """Draw a scene's figures in display units.

    Args:
        specs: What stands in each figure.
        run: Has every variable of the figures.
        other: A second run, dashed over the first one; a panel below shows second minus first.

    Raises:
        UnknownName: A run lacks a variable.
        UsageError: The two runs have other output times.

    Example:
        >>> import cosim
        >>> scene = cosim.read_scene("crank_torque.toml")
        >>> len(draw_figures(scene.figures, cosim.run_scene(scene)))
        1
    """
    for each in (run, other):
        if not isinstance(each, Trajectory | None) or run is None:
            raise UsageError.of_type("draw_figures", each, "results of simulate or simulate_fmu")
    if isinstance(specs, FigureSpec | str) or not isinstance(specs, Collection):
        raise UsageError.of_type("draw_figures", specs, "a list of figures, as a scene has")
    if other is not None:
        refuse_other_times(run, other)
    with matplotlib.rc_context(STYLE):
        return [_figure(spec, run, other) for spec in specs]


def figures_of(names: Sequence[str]) -> tuple[FigureSpec, ...]:
    """Return figures of these variables, a few in each, a panel each."""
    size = VARIABLES_PER_FIGURE
    groups = [names[i : i + size] for i in range(0, len(names), size)]
    return tuple(FigureSpec(", ".join(g), tuple((name,) for name in g)) for g in groups)


def _figure(spec: FigureSpec, run: Trajectory, other: Trajectory | None) -> Figure:
    count, below = len(spec.panels), other is not None
    ratios = [2.0, 1.0] * count if below else [1.0] * count
    height = 0.7 + (5.0 if spec.equal else 3.1 if count == 1 else 1.75) * count
    height += 1.3 * count * below
    figure = Picture(
        figsize=(_WIDTH, height), layout=ConstrainedLayoutEngine(h_pad=_PAD, w_pad=_PAD)
    )
    rows = [*figure.subplots(len(ratios), 1, squeeze=False, height_ratios=ratios).ravel()]
    figure.suptitle(fill(spec.title, 70), fontsize=11)
    mains = rows[::2] if below else rows
    for index, axis in enumerate(mains):
        _panel(axis, spec, index, run, other)
    origin = "; dashed: ".join(_run_label(each) for each in (run, other) if each is not None)
    mains[0].set_title(origin, fontsize=7, color="0.4", loc="right")
    if other is not None:
        for index, axis in enumerate(rows[1::2]):
            names = spec.panels[index]
            legends = spec.legends[index] if spec.legends else names
            if spec.x != "time":
                names, legends = (spec.x, *names), (spec.x, *legends)
            _difference(axis, names, legends, run, other)
    if spec.x == "time":
        _share_time(rows)
    _name_invalid(figure, rows if spec.x == "time" else [], run, other)
    figure.align_ylabels(rows)
    return figure


def _panel(
    axis: Axes, spec: FigureSpec, index: int, run: Trajectory, other: Trajectory | None
) -> None:
    names = spec.panels[index]
    columns = [run.column(name) for name in names]
    meanings = [f"{column.name}: {column.meaning or column.name}" for column in columns]
    legends = spec.legends[index] if spec.legends else meanings
    for i, (column, legend) in enumerate(zip(columns, legends, strict=True)):
        colour = COLOURS[i % len(COLOURS)]
        line = LINES[i % len(LINES)]
        over, values = _displayed(run, spec.x), _displayed(run, column.name)
        axis.plot(over, values, color=colour, linestyle=line, label=legend)
        bad = run.time >= run.validity[0]
        if spec.x != "time" and bad.any():
            axis.plot(over[bad], values[bad], color=INVALID, linewidth=2.2, alpha=0.4)
        if other is not None:
            axis.plot(_displayed(other, spec.x), _displayed(other, column.name), **_SECOND)
    label = spec.labels[index] if spec.labels else ", ".join(names)
    axis.set_ylabel(
        _beside(label, columns[0].shown_unit, 34 if spec.equal or len(spec.panels) == 1 else 19)
    )
    if len(names) > 1:
        axis.legend()
    if spec.x != "time":
        axis.set_xlabel(f"{spec.x_label or spec.x} [{run.column(spec.x).shown_unit}]")
    if spec.equal:
        axis.set_aspect("equal", adjustable="datalim")
    else:
        drawn = np.column_stack([_displayed(run, name) for name in names])
        nominal = max(float(c.shown(np.array([c.nominal]))[0]) for c in columns)
        keep_constant_flat(axis, drawn, nominal)


def _difference(
    axis: Axes, names: Sequence[str], legends: Sequence[str], run: Trajectory, other: Trajectory
) -> None:
    zero = True
    for i, (name, legend) in enumerate(zip(names, legends, strict=True)):
        gap = _displayed(other, name) - _displayed(run, name)
        line = LINES[i % len(LINES)]
        colour = COLOURS[i % len(COLOURS)]
        axis.plot(run.time, gap, color=colour, linestyle=line, linewidth=0.9, label=legend)
        zero = zero and not gap.any()
    axis.set_ylabel(_beside("difference", run.column(names[0]).shown_unit, 16))
    if zero:
        axis.set_ylim(-1, 1)
        axis.set_yticks([0.0])
        axis.text(0.5, 0.75, "exactly zero", transform=axis.transAxes, ha="center", fontsize=8)
    else:
        axis.ticklabel_format(axis="y", scilimits=(-2, 3), useOffset=False)
    axis.set_xlabel("time [s]")
    axis.margins(x=0)
    if len(names) > 1:
        axis.legend()


def _name_invalid(
    figure: Figure, rows: Sequence[Axes], run: Trajectory, other: Trajectory | None
) -> None:
    """Shade the spans in which the runs are outside their models, and say why."""
    told = []
    for each in (run, other) if other is not None else (run,):
        assert each is not None
        start, reasons = each.validity
        for axis in rows:
            shade_invalid(axis, each.time, start)
        if text := invalid_text(start, reasons, _WIDTH):
            told.append(f"{_run_label(each)}, {text}" if other is not None else text)
    if told:
        lines = (fill(text, 95, max_lines=4, placeholder=" ...") for text in told)
        figure.supxlabel("\n".join(lines), fontsize=7, color=INVALID)


def _beside(label: str, unit: str, room: int) -> str:
    """Return the text of a vertical axis, in lines of so many letters that it keeps its panel."""
    text = f"{label} [{unit}]"
    return text if len(text) <= room else f"{fill(label, room)}\n[{unit}]"


def _share_time(rows: Sequence[Axes]) -> None:
    """Let all panels show the same span; the lowest one carries its numbers."""
    for axis in rows:
        if axis is not rows[0]:
            axis.sharex(rows[0])
        axis.margins(x=0)
        axis.set_xlabel("")
        axis.tick_params(labelbottom=axis is rows[-1])
    rows[-1].set_xlabel("time [s]")


def _displayed(run: Trajectory, name: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    return run.time if name == "time" else run.column(name).shown(run[name])


def _run_label(run: Trajectory) -> str:
    suffix = "" if run.complete else f" ({run.status.partition(':')[0]})"
    return f"{run.model}, {run.stats.get('solver', '')}{suffix}"
