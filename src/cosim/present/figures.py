"""Figures of runs: all variables, those of a scene, two runs with their difference, an overlay."""

from collections.abc import Collection, Sequence
from dataclasses import replace
from itertools import chain, product
from math import ceil
from textwrap import fill
from typing import Any

import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.layout_engine import ConstrainedLayoutEngine

from casadi_models.units import parse_unit
from cosim.arrays import Vector
from cosim.colors import CURVES, INVALID, SECOND
from cosim.errors import UsageError
from cosim.plotting import LINES, STYLE, Picture, keep_constant_flat, reject_formulas, shade_invalid
from cosim.scene.scene import FigureSpec
from cosim.text import axis_label, moment
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
    lines = head.count("\n") + 2 * bool(run.validity[1])  # below the panels
    with matplotlib.rc_context(STYLE):
        figure = Picture(figsize=(width, 2.3 * down + 0.4 + 0.18 * lines), layout="constrained")
        axes = figure.subplots(down, across, squeeze=False, sharex=True).ravel()
        for i, (axis, column) in enumerate(zip(axes, run.columns, strict=False)):
            values = _displayed(run, column.name)
            axis.plot(run.time, values, linewidth=1.2, color=CURVES[0], marker=_mark(run))
            axis.set_title(fill(column.meaning or column.name, 52), fontsize=9)
            axis.set_ylabel(axis_label(column.name, column.shown_unit))
            axis.set_xlabel("time [s]" if i >= len(run.names) - across else "")
            axis.tick_params(labelbottom=True)
            axis.margins(x=0)
            keep_constant_flat(axis, values, _displayed_nominal(column))
    for axis in axes[len(run.names) :]:
        axis.set_visible(False)
    figure.suptitle(head, fontsize=11)
    _name_invalid(figure, [*axes[: len(run.names)]], [run], [run.model])
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
        remaining = _limited(spec, common)
        if remaining.panels:
            shared.append(remaining)
    if not shared:
        models = " and ".join(dict.fromkeys(run.model for run in runs))
        raise UsageError(f"{models}: these runs have no variable in common that could be drawn")
    names = ", ".join(dict.fromkeys(gone))
    return tuple(shared), (f"not drawn, as not every run has it: {names}",) if gone else ()


def _limited(spec: FigureSpec, names: Collection[str]) -> FigureSpec:
    """Return a figure with those of its curves alone that have some names."""
    panels, labels, legends = [], [], []
    for k, panel in enumerate(spec.panels):
        places = [i for i, name in enumerate(panel) if name in names]
        if not places:
            continue
        panels.append(tuple(panel[i] for i in places))
        if spec.labels:
            labels.append(spec.labels[k])
        if spec.legends:
            legends.append(tuple(spec.legends[k][i] for i in places))
    return replace(spec, panels=tuple(panels), labels=tuple(labels), legends=tuple(legends))


def draw_overlay(
    specs: Sequence[FigureSpec], runs: Sequence[Trajectory], *, differences: bool = False
) -> list[Figure]:
    """Draw the curves of one or more runs over each other, in display units; see `shared_specs`.

    `differences` adds a panel with each further run minus the first one, if all runs have the same
    output times.
    Output times may differ. A variable without a unit, as in a file whose header has none, is in SI
    units and gets those of the other runs.
    """
    differences = differences and all(apart(runs[0], other) is None for other in runs[1:])
    known = {c.name: c for run in reversed(runs) for c in run.columns if c.unit != "1"}

    def shared(own: Column) -> Column:
        other = known.get(own.name, own)
        return other if own.unit in ("1", other.unit) else own

    runs = [replace(run, columns=tuple(map(shared, run.columns))) for run in runs]
    if not differences:
        runs = [run.with_events() for run in runs]
    with matplotlib.rc_context(STYLE):
        return [_figure(spec, runs, differences) for spec in specs]


def run_labels(runs: Sequence[Trajectory]) -> list[str]:
    """Return a label for each run: those of model, solver and values that differ between runs.

    A run that stopped early has its status behind that.
    """
    facts = [
        (r.model, str(r.stats.get("solver", "")), str(r.stats.get("variation", ""))) for r in runs
    ]
    columns = [column for column in zip(*facts, strict=True) if len(set(column)) > 1]
    found = [", ".join(filter(None, row)) for row in zip(*columns, strict=True)] or [
        run.model for run in runs
    ]
    numbers = [f" ({i})" if found.count(label) > 1 else "" for i, label in enumerate(found, 1)]
    return [
        f"{label}{number}{_ended_early(run)}"
        for label, number, run in zip(found, numbers, runs, strict=True)
    ]


def _scale(axis: Axes, spec: FigureSpec, panel: Sequence[str], runs: Sequence[Trajectory]) -> None:
    """Give both axes the same scale if requested; keep constant curves flat otherwise."""
    if spec.equal:
        axis.set_aspect("equal", adjustable="datalim")
        return
    columns = [runs[0].column(name) for name in panel]
    nominal = max(map(_displayed_nominal, columns))
    drawn = np.concatenate([_displayed(run, name) for run in runs for name in panel])
    keep_constant_flat(axis, drawn, nominal)


_POINTS: Any = {"color": SECOND, "linestyle": "none", "marker": ".", "markersize": 4}
_RECORDS_ACROSS = 3  # in a figure of a fit; further records stand below
_PAD = 0.07  # inches
VARIABLES_PER_FIGURE = 3  # in figures that no scene declares


def draw_figures(
    specs: Sequence[FigureSpec], run: Trajectory, other: Trajectory | None = None
) -> list[Figure]:
    """Draw a scene's figures in display units.

    Args:
        specs: The figures.
        run: A run that has every variable of the figures.
        other: A second run; a panel below shows the second minus the first.

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
    if other is None:
        return draw_overlay(specs, [run])
    reject_other_times(run, other)
    return draw_overlay(specs, [run, other], differences=True)


def draw_residuals(*compared: Sequence[Trajectory]) -> Figure:
    """Draw runs as lines, others as points, and the residuals below each variable.

    Args:
        compared: Residuals, run and other run of each record; records stand side by side, and
            from the fourth on below the others.
    """
    shown = tuple(dict.fromkeys(c.name for residuals, *_ in compared for c in residuals.columns))
    across = min(_RECORDS_ACROSS, len(compared))
    blocks = -(-len(compared) // across)
    count = len(shown) * blocks
    with matplotlib.rc_context(STYLE):
        figure = Picture(
            figsize=(_WIDTH * (0.4 + 0.6 * across), 1.0 + 3.0 * count), layout="constrained"
        )
        grid = figure.subplots(
            2 * count, across, sharey="row", squeeze=False, height_ratios=[2, 1] * count
        )
        for axis in grid.flat:
            axis.set_axis_off()  # until a record fills it
        for place, one in enumerate(compared):
            block, across_at = divmod(place, across)
            top = 2 * len(shown) * block
            rows = list(grid[top : top + 2 * len(shown), across_at])
            _residual_panels(rows, shown, *one)
            _name_invalid(figure, [axis for axis in rows if axis.axison], [one[1]], [one[1].model])
            if len(compared) > 1:
                rows[0].set_title(fill(f"record {place + 1}: {one[2].model}", 40), fontsize=9)
        _, run, other = compared[0]
        second = other.model if len(compared) == 1 else "measured"
        next(axis for axis in grid[:, 0] if axis.axison).legend(labels=[run.model, second])
        for row in grid:
            for axis in [axis for axis in row if axis.axison][1:]:
                axis.set_ylabel("")  # the first one names the variable of the row
        what = other.model if len(compared) == 1 else f"{len(compared)} records"
        figure.suptitle(fill(f"{run.model} and {what}", 70), fontsize=11)
    return figure


def _residual_panels(
    rows: Sequence[Axes],
    names: Sequence[str],
    residuals: Trajectory,
    run: Trajectory,
    other: Trajectory,
) -> None:
    """Draw a record in a column of panels: two for each variable that was measured."""
    other, measured = replace(other, columns=run.columns), {c.name for c in residuals.columns}
    last = None
    for name, above, below in zip(names, rows[::2], rows[1::2], strict=True):
        if name not in measured:
            continue
        column = residuals.column(name)
        for axis in (above, below):
            axis.set_axis_on()
            if axis is not rows[0]:
                axis.sharex(rows[0])
            axis.tick_params(labelbottom=False)
        above.plot(run.time, _displayed(run, name), color=CURVES[0], label=run.model)
        above.plot(other.time, _displayed(other, name), **_POINTS, label=other.model)
        gaps = column.shown(residuals[name], difference=True)
        below.plot(residuals.time, gaps, **_POINTS)
        above.set_ylabel(axis_label(name, column.shown_unit, 19))
        below.set_ylabel(axis_label("residual", column.shown_unit, 16))
        last = below
    if last is not None:
        last.tick_params(labelbottom=True)
        last.set_xlabel("time [s]")


def figures_of(names: Sequence[str]) -> tuple[FigureSpec, ...]:
    """Return figures of these variables: a panel each, three panels in a figure."""
    size = VARIABLES_PER_FIGURE
    groups = [names[i : i + size] for i in range(0, len(names), size)]
    return tuple(FigureSpec(", ".join(g), tuple((name,) for name in g)) for g in groups)


def _figure(spec: FigureSpec, runs: Sequence[Trajectory], differences: bool) -> Figure:
    """Draw a figure of one or more runs; every second panel shows differences if requested."""
    reject_formulas((spec.title, spec.x_label, *spec.labels, *chain(*spec.legends)))
    count, several, over_time = len(spec.panels), len(runs) > 1, spec.x == "time"
    ratios = [2.0, 1.0] * count if differences else [1.0] * count
    height = 0.7 + (5.0 if spec.equal else 3.1 if count == 1 else 1.75) * count
    height += 1.3 * count * differences + 0.3 * several
    figure = Picture(
        figsize=(_WIDTH, height), layout=ConstrainedLayoutEngine(h_pad=_PAD, w_pad=_PAD)
    )
    grid = figure.subplots(len(ratios), 1, squeeze=False, sharex=over_time, height_ratios=ratios)
    rows = [*grid.ravel()]
    figure.suptitle(fill(spec.title, 70), fontsize=11)
    solver = runs[0].stats.get("solver", "")
    alone = f"{runs[0].model}, {solver}{_ended_early(runs[0])}"
    labels = run_labels(runs) if several else [alone]
    mains = rows[:: 1 + differences]
    for index, axis in enumerate(mains):
        _panel(axis, spec, index, runs)
    for index, axis in enumerate(rows[1::2] if differences else ()):
        _difference_panel(axis, spec, index, runs)
    if several:
        curves = len(spec.panels[0])
        _name_runs(figure, mains[0].lines[: curves * len(runs) : curves], labels)
    else:
        mains[0].set_title(labels[0], fontsize=7, color="0.4", loc="right")
    if over_time:
        rows[-1].set_xlabel("time [s]")
        for axis in rows:
            axis.margins(x=0)
            axis.label_outer()
    _name_invalid(figure, rows if over_time else [], runs, labels)
    figure.align_ylabels(rows)
    return figure


def _name_runs(figure: Figure, handles: Sequence[Artist], labels: Sequence[str]) -> None:
    """Add the legend of several runs below the panels."""
    letters = max(map(len, labels)) + 8  # of a name with its line
    across = max(1, min(3, len(labels), int(_WIDTH * 14) // letters))
    names = [fill(label, int(_WIDTH * 14)) for label in labels]
    figure.legend(handles, names, loc="outside lower center", ncols=across, fontsize=8)


def _look(curve: int, curves: int, run: int, runs: int) -> dict[str, Any]:
    """Return color and line of one of some curves of one of some runs, distinct without color."""
    color, line = curve if curves > 1 else run, run if runs > 1 else curve
    return {"color": CURVES[color % len(CURVES)], "linestyle": LINES[line % len(LINES)]}


def _panel(axis: Axes, spec: FigureSpec, index: int, runs: Sequence[Trajectory]) -> None:
    names = spec.panels[index]
    columns = [runs[0].column(name) for name in names]
    meanings = [f"{column.name}: {column.meaning or column.name}" for column in columns]
    legends = spec.legends[index] if spec.legends else meanings
    for k, run in enumerate(runs):
        for i, (name, legend) in enumerate(zip(names, legends, strict=True)):
            over, values = _displayed(run, spec.x), _displayed(run, name, columns[0])
            look = _look(i, len(names), k, len(runs))
            if k < len(runs) - 1:  # what is drawn over it stays visible
                look |= {"linewidth": 2.2, "alpha": 0.5}
            axis.plot(over, values, label="" if k else legend, marker=_mark(run), **look)
    if spec.x != "time":
        for run, name in product(runs, names):
            bad = run.time >= run.validity[0]
            over, values = _displayed(run, spec.x), _displayed(run, name, columns[0])
            axis.plot(over[bad], values[bad], color=INVALID, linewidth=2.2, alpha=0.4)
        axis.set_xlabel(axis_label(spec.x_label or spec.x, runs[0].column(spec.x).shown_unit))
    label = spec.labels[index] if spec.labels else ", ".join(names)
    letters = 34 if spec.equal or len(spec.panels) == 1 else 19
    axis.set_ylabel(axis_label(label, columns[0].shown_unit, letters))
    if len(names) > 1:
        axis.legend()
    _scale(axis, spec, names, runs)


def _difference_panel(axis: Axes, spec: FigureSpec, index: int, runs: Sequence[Trajectory]) -> None:
    """Draw each further run minus the first one, of a path both coordinates; name what is zero."""
    names = spec.panels[index]
    legends = spec.legends[index] if spec.legends else names
    if spec.x != "time":
        names, legends = (spec.x, *names), (spec.x, *legends)
    first = runs[0].column(names[0])
    for k, other in enumerate(runs[1:], start=1):
        for i, (name, legend) in enumerate(zip(names, legends, strict=True)):
            with np.errstate(invalid="ignore"):  # infinity less infinity
                gap = _displayed(other, name, first) - _displayed(runs[0], name, first)
            look = _look(i, len(names), k, len(runs))
            look |= {"label": legend if k == 1 else "", "marker": _mark(other)}
            axis.plot(runs[0].time, gap, linewidth=0.9, **look)
    axis.set_ylabel(axis_label("difference", first.shown_unit, 16))
    drawn = np.hstack([np.asarray(line.get_ydata(), dtype=float) for line in axis.lines])
    if np.isfinite(drawn).any() and not np.any(drawn, where=np.isfinite(drawn)):
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
    figure: Figure, rows: Sequence[Axes], runs: Sequence[Trajectory], labels: Sequence[str]
) -> None:
    """Shade the spans in which the runs are outside their validity ranges, and say why."""
    captions = []
    for run, label in zip(runs, labels, strict=True):
        start, reasons = run.validity
        for axis in rows:
            shade_invalid(axis, run.time, start)
        if reasons:
            more = f" (and {len(reasons) - 1} more)" if len(reasons) > 1 else ""
            text = f"shaded: invalid from {moment(start)} s: {reasons[0]}{more}"
            text = f"{label}, {text}" if len(runs) > 1 else text
            letters = int(figure.get_figwidth() * 15)
            captions.append(fill(text, letters, max_lines=4, placeholder=" ..."))
    if captions and figure.legends:  # the layout would place both at the lower edge
        figure.legends[0].set_title("\n".join(captions), prop=FontProperties(size=7))
        figure.legends[0].get_title().set_color(INVALID)
    elif captions:
        figure.supxlabel("\n".join(captions), fontsize=7, color=INVALID)


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


def _mark(run: Trajectory) -> str:
    return "." if len(run) < 2 else ""  # a single point makes no line


def _displayed_nominal(column: Column) -> float:
    return float(column.shown(np.array(column.nominal), difference=True))


def _ended_early(run: Trajectory) -> str:
    return "" if run.complete else f" ({run.status.partition(':')[0]})"
