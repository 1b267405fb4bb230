"""Figures of runs: all variables, those of a scene, two runs with their difference, an overlay."""

from collections.abc import Collection, Sequence
from dataclasses import replace
from math import ceil
from textwrap import fill
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from casadi_models.units import parse_unit
from cosim.arrays import Vector
from cosim.colors import CURVES, INVALID, SECOND
from cosim.errors import UsageError
from cosim.plotting import LINES, STYLE, Picture, invalid_text, keep_constant_flat, shade_invalid
from cosim.scene.scene import FigureSpec
from cosim.trajectory import Column, Trajectory
from cosim.verify.comparison import apart, reject_other_times

_WIDTH = 6.4  # inches


def draw_panels(run: Trajectory) -> Figure:
    """Draw the variables of a run over time in their display units, a panel each."""
    if not run.names:
        raise UsageError(f"{run.model}: there is nothing to plot; name at least one variable")
    run = run.with_events()
    across = min(3, len(run.names))
    down = ceil(len(run.names) / across)
    width = 4.2 * across
    suffix = "" if run.complete else f" ({run.status})"
    head = fill(f"{run.model}{suffix}", int(width * 11))
    invalid_from, reasons = run.validity
    caption = invalid_text(invalid_from, reasons, width)
    lines = head.count("\n") + bool(caption) * (caption.count("\n") + 1)
    with matplotlib.rc_context(STYLE):
        figure = Picture(figsize=(width, 2.3 * down + 0.4 + 0.18 * lines), layout="constrained")
        axes = figure.subplots(down, across, squeeze=False, sharex=True).ravel()
        for i, (axis, column) in enumerate(zip(axes, run.columns, strict=False)):
            values = _displayed(run, column.name)
            axis.plot(run.time, values, linewidth=1.2, color=CURVES[0])
            axis.set_title(fill(column.meaning or column.name, 52), fontsize=9)
            axis.set_ylabel(f"{column.name} [{column.shown_unit}]")
            axis.set_xlabel("time [s]" if i >= len(run.names) - across else "")
            axis.tick_params(labelbottom=True)
            axis.margins(x=0)
            keep_constant_flat(axis, values, _displayed_nominal(column))
            shade_invalid(axis, run.time, invalid_from)
    for axis in axes[len(run.names) :]:
        axis.set_visible(False)
    figure.suptitle(head, fontsize=11)
    if caption:
        figure.supxlabel(caption, fontsize=8, color=INVALID)
    return figure


def shared_specs(
    specs: Sequence[FigureSpec], runs: Sequence[Trajectory]
) -> tuple[tuple[FigureSpec, ...], tuple[str, ...]]:
    """Return the figures reduced to the variables of every run, and a note on what is left out.

    Without figures, those of all common variables.

    Raises:
        UsageError: The runs have no variable in common.
    """
    common = set(runs[0].names).intersection(*(run.names for run in runs[1:]))
    candidates = specs or figures_of([name for name in runs[0].names if name in common])
    shared, gone = [], []
    for spec in candidates:
        if spec.x != "time" and spec.x not in common:
            gone.append(f"figure '{spec.title}' (over {spec.x})")
            continue
        gone += [name for panel in spec.panels for name in panel if name not in common]
        found = [[i for i, name in enumerate(panel) if name in common] for panel in spec.panels]
        rows = [(k, places) for k, places in enumerate(found) if places]
        if rows:
            panels, legends = (
                tuple(tuple(texts[k][i] for i in places) for k, places in rows) if texts else ()
                for texts in (spec.panels, spec.legends)
            )
            labels = tuple(spec.labels[k] for k, _ in rows) if spec.labels else ()
            shared.append(replace(spec, panels=panels, labels=labels, legends=legends))
    if not shared:
        models = " and ".join(dict.fromkeys(run.model for run in runs))
        raise UsageError(f"{models}: these runs have no variable in common that could be drawn")
    names = ", ".join(dict.fromkeys(gone))
    return tuple(shared), (f"not drawn, as not every run has it: {names}",) if gone else ()


def draw_overlay(
    specs: Sequence[FigureSpec], runs: Sequence[Trajectory], *, differences: bool = False
) -> list[Figure]:
    """Draw the curves of several runs over each other, in display units; see `shared_specs`.

    `differences` adds a panel with each further run minus the first one, if all runs have the same
    output times.
    Output times may differ. A variable without a unit, as in a file whose header has none, is in SI
    units and gets those of the other runs.
    """
    labels = run_labels(runs)
    differences = differences and all(apart(runs[0], other) is None for other in runs[1:])
    known = {c.name: c for run in reversed(runs) for c in run.columns if c.unit != "1"}

    def shared(own: Column) -> Column:
        other = known.get(own.name, own)
        return other if own.unit in ("1", other.unit) else own

    runs = [replace(run, columns=tuple(map(shared, run.columns))) for run in runs]
    with matplotlib.rc_context(STYLE):
        return [_overlaid_figure(spec, runs, labels, differences) for spec in specs]


def run_labels(runs: Sequence[Trajectory]) -> list[str]:
    """Return a label for each run: those of model, solver and values that differ between runs."""
    facts = [
        (r.model, str(r.stats.get("solver", "")), str(r.stats.get("variation", ""))) for r in runs
    ]
    columns = [column for column in zip(*facts, strict=True) if len(set(column)) > 1]
    found = [", ".join(filter(None, row)) for row in zip(*columns, strict=True)] or [
        run.model for run in runs
    ]
    return [
        f"{label} ({i})" if found.count(label) > 1 else label for i, label in enumerate(found, 1)
    ]


def _overlaid_figure(
    spec: FigureSpec, runs: Sequence[Trajectory], labels: Sequence[str], differences: bool
) -> Figure:
    count, sharing = len(spec.panels), spec.x == "time"
    if not differences:
        runs = [run.with_events() for run in runs]
    height = 1.0 + (4.4 if spec.equal else 2.6 if count == 1 else 1.9) * count
    height += 1.1 * count * differences
    figure = Picture(figsize=(_WIDTH, height), layout="constrained")
    ratios = [2.0, 1.0] * count if differences else [1.0] * count
    grid = figure.subplots(len(ratios), 1, squeeze=False, sharex=sharing, height_ratios=ratios)
    rows = [*grid.ravel()]
    figure.suptitle(fill(spec.title, 70), fontsize=11)
    for axis, panel in zip(rows[:: 1 + differences], spec.panels, strict=True):
        _overlaid_panel(axis, spec, panel, [*zip(runs, labels, strict=True)])
    for axis, panel in zip(rows[1::2] if differences else (), spec.panels, strict=False):
        for k, other in enumerate(runs[1:], start=1):
            look = CURVES[k % len(CURVES)], LINES[k % len(LINES)]
            _differences(axis, panel, panel, (runs[0], other), look)
        _difference_axis(axis, runs[0].column(panel[0]).shown_unit)
        if sharing:
            axis.label_outer()
    _name_invalid(figure, rows if spec.x == "time" else [], runs, labels)
    handles, names = rows[0].get_legend_handles_labels()
    if len(spec.panels) > 1 and all(len(panel) == 1 for panel in spec.panels):
        names = list(labels)
    letters = max(map(len, names)) + 8  # of a name with its line
    across = max(1, min(3, len(names), int(_WIDTH * 14) // letters))
    names = [fill(name, int(_WIDTH * 14)) for name in names]
    figure.legend(handles, names, loc="outside lower center", ncols=across, fontsize=8)
    return figure


def _overlaid_panel(
    axis: Axes, spec: FigureSpec, panel: Sequence[str], labelled: Sequence[tuple[Trajectory, str]]
) -> None:
    several, runs = len(panel) > 1, [run for run, _ in labelled]
    first = runs[0].column(panel[0])
    for i, name in enumerate(panel):
        for k, (run, label) in enumerate(labelled):
            axis.plot(
                _displayed(run, spec.x),
                _displayed(run, name, first),
                color=CURVES[(i if several else k) % len(CURVES)],
                linestyle=LINES[k % len(LINES)],
                linewidth=1.6 - 0.25 * min(k, 3),
                label=f"{name}, {label}" if several else label,
            )
    axis.set_ylabel(fill(f"{', '.join(panel)} [{first.shown_unit}]", 24))
    over = "s" if spec.x == "time" else runs[0].column(spec.x).shown_unit
    axis.set_xlabel(f"{spec.x_label or spec.x} [{over}]")
    axis.label_outer()
    _scale(axis, spec, panel, runs)


def _scale(axis: Axes, spec: FigureSpec, panel: Sequence[str], runs: Sequence[Trajectory]) -> None:
    """Give both axes the same scale if requested; keep constant curves flat otherwise."""
    if spec.equal:
        axis.set_aspect("equal", adjustable="datalim")
        return
    columns = [runs[0].column(name) for name in panel]
    nominal = max(map(_displayed_nominal, columns))
    drawn = np.concatenate([_displayed(run, name) for run in runs for name in panel])
    keep_constant_flat(axis, drawn, nominal)


_SECOND_RUN: Any = {"color": SECOND, "linewidth": 0.9, "linestyle": (0, (4, 4))}
_POINTS: Any = {"color": SECOND, "linestyle": "none", "marker": ".", "markersize": 4}
_PAD = 0.07  # inches
VARIABLES_PER_FIGURE = 3  # in figures that no scene declares


def draw_figures(
    specs: Sequence[FigureSpec], run: Trajectory, other: Trajectory | None = None
) -> list[Figure]:
    """Draw a scene's figures in display units.

    Args:
        specs: The figures.
        run: A run that has every variable of the figures.
        other: A second run, drawn dashed; a panel below shows the second minus the first.

    Raises:
        UnknownName: A run lacks a variable.
        UsageError: The two runs have different output times.

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
        reject_other_times(run, other)
    else:
        run = run.with_events()
    with matplotlib.rc_context(STYLE):
        return [_figure(spec, run, other) for spec in specs]


def draw_residuals(residuals: Trajectory, run: Trajectory, other: Trajectory) -> Figure:
    """Draw a run as lines, another one as points, and the residuals below each variable."""
    count, other = len(residuals.columns), replace(other, columns=run.columns)
    with matplotlib.rc_context(STYLE):
        figure = Picture(figsize=(_WIDTH, 1.0 + 3.0 * count), layout="constrained")
        axes = figure.subplots(2 * count, 1, sharex=True, height_ratios=[2, 1] * count)
        for column, above, below in zip(residuals.columns, axes[::2], axes[1::2], strict=True):
            above.plot(run.time, _displayed(run, column.name), color=CURVES[0], label=run.model)
            points = _displayed(other, column.name)
            above.plot(other.time, points, **_POINTS, label=other.model)
            gaps = column.shown(residuals[column.name], difference=True)
            below.plot(residuals.time, gaps, **_POINTS)
            above.set_ylabel(_beside(column.name, column.shown_unit, 19))
            below.set_ylabel(_beside("residual", column.shown_unit, 16))
        axes[0].legend()
        axes[-1].set_xlabel("time [s]")
        figure.suptitle(fill(residuals.model, 70), fontsize=11)
        _name_invalid(figure, axes, [run], [run.model])
    return figure


def figures_of(names: Sequence[str]) -> tuple[FigureSpec, ...]:
    """Return figures of these variables: a panel each, three panels in a figure."""
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
    sharing = spec.x == "time"
    grid = figure.subplots(len(ratios), 1, squeeze=False, sharex=sharing, height_ratios=ratios)
    rows = [*grid.ravel()]
    figure.suptitle(fill(spec.title, 70), fontsize=11)
    mains = rows[::2] if below else rows
    for index, axis in enumerate(mains):
        _panel(axis, spec, index, run, other)
    runs = [each for each in (run, other) if each is not None]
    labels = [_run_label(each) for each in runs]
    mains[0].set_title("; dashed: ".join(labels), fontsize=7, color="0.4", loc="right")
    if other is not None:
        for index, axis in enumerate(rows[1::2]):
            names = spec.panels[index]
            legends = spec.legends[index] if spec.legends else names
            if spec.x != "time":
                names, legends = (spec.x, *names), (spec.x, *legends)
            _difference(axis, names, legends, run, other)
    if spec.x == "time":
        rows[-1].set_xlabel("time [s]")
        for axis in rows:
            axis.margins(x=0)
            axis.label_outer()
    _name_invalid(figure, rows if spec.x == "time" else [], runs, labels)
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
        color, line = CURVES[i % len(CURVES)], LINES[i % len(LINES)]
        over, values = _displayed(run, spec.x), _displayed(run, column.name, columns[0])
        axis.plot(over, values, color=color, linestyle=line, label=legend)
        bad = run.time >= run.validity[0]
        if spec.x != "time" and bad.any():
            axis.plot(over[bad], values[bad], color=INVALID, linewidth=2.2, alpha=0.4)
        if other is not None:
            second = _displayed(other, column.name, columns[0])
            axis.plot(_displayed(other, spec.x), second, **_SECOND_RUN)
    label = spec.labels[index] if spec.labels else ", ".join(names)
    letters = 34 if spec.equal or len(spec.panels) == 1 else 19
    axis.set_ylabel(_beside(label, columns[0].shown_unit, letters))
    if len(names) > 1:
        axis.legend()
    if spec.x != "time":
        axis.set_xlabel(f"{spec.x_label or spec.x} [{run.column(spec.x).shown_unit}]")
    _scale(axis, spec, names, [run])


def _difference(
    axis: Axes, names: Sequence[str], legends: Sequence[str], run: Trajectory, other: Trajectory
) -> None:
    _differences(axis, names, legends, (run, other))
    _difference_axis(axis, run.column(names[0]).shown_unit)
    if len(names) > 1:
        axis.legend()


def _differences(
    axis: Axes,
    names: Sequence[str],
    legends: Sequence[str],
    runs: tuple[Trajectory, Trajectory],
    look: tuple[str, Any] | None = None,
) -> None:
    """Draw the second run minus the first one; each variable has its own look if None is given."""
    run, other = runs
    first = run.column(names[0])
    for i, (name, legend) in enumerate(zip(names, legends, strict=True)):
        gap = _displayed(other, name, first) - _displayed(run, name, first)
        color, line = look or (CURVES[i % len(CURVES)], LINES[i % len(LINES)])
        axis.plot(run.time, gap, color=color, linestyle=line, linewidth=0.9, label=legend)


def _difference_axis(axis: Axes, unit: str) -> None:
    """Label an axis with differences; name those that are zero."""
    axis.set_ylabel(_beside("difference", unit, 16))
    if not any(np.any(line.get_ydata()) for line in axis.lines):
        axis.set_ylim(-1, 1)
        axis.set_yticks([0.0])
        axis.text(0.5, 0.75, "exactly zero", transform=axis.transAxes, ha="center", fontsize=8)
    else:
        axis.ticklabel_format(axis="y", scilimits=(-2, 3), useOffset=False)
    axis.set_xlabel("time [s]")
    axis.margins(x=0)


def _name_invalid(
    figure: Figure, rows: Sequence[Axes], runs: Sequence[Trajectory], labels: Sequence[str]
) -> None:
    """Shade the spans in which the runs are outside their validity ranges, and say why."""
    captions = []
    for run, label in zip(runs, labels, strict=True):
        start, reasons = run.validity
        for axis in rows:
            shade_invalid(axis, run.time, start)
        if text := invalid_text(start, reasons, _WIDTH):
            text = f"{label}, {text}" if len(runs) > 1 else text
            captions.append(fill(text, 95, max_lines=4, placeholder=" ..."))
    if captions:
        figure.supxlabel("\n".join(captions), fontsize=7, color=INVALID)


def _beside(label: str, unit: str, letters: int) -> str:
    """Return the label of a vertical axis, in lines of at most so many letters."""
    text = f"{label} [{unit}]"
    return text if len(text) <= letters else f"{fill(label, letters)}\n[{unit}]"


def _displayed(run: Trajectory, name: str, like: Column | None = None) -> Vector:
    """Return a variable in the unit of the first one on its axis if it converts, else in its own.

    Args:
        run: The run.
        name: The variable.
        like: The first variable on the axis.
    """
    if name == "time":
        return run.time
    column = run.column(name)
    if like is not None and like.shown_unit != column.shown_unit:
        own, other = parse_unit(column.unit), parse_unit(like.shown_unit)
        if own is not None and other is not None and own.measures_like(other):
            column = replace(column, display_unit=like.shown_unit, display_factor=None)
    return column.shown(run[name])


def _displayed_nominal(column: Column) -> float:
    return float(column.shown(np.array(column.nominal), difference=True))


def _run_label(run: Trajectory) -> str:
    suffix = "" if run.complete else f" ({run.status.partition(':')[0]})"
    return f"{run.model}, {run.stats.get('solver', '')}{suffix}"
