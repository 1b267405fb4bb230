"""Several runs in one figure: colours tell variables apart, lines tell runs apart."""

from collections.abc import Sequence
from dataclasses import replace
from textwrap import fill

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

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
from cosim.present.figures import figures_of
from cosim.scene.scene import FigureSpec
from cosim.trajectory import Trajectory

_WIDTH = 6.4  # inches


def shared_specs(
    specs: Sequence[FigureSpec], runs: Sequence[Trajectory]
) -> tuple[tuple[FigureSpec, ...], tuple[str, ...]]:
    """Return what of some figures every run has, and a sentence for what is left out.

    Raises:
        UsageError: The runs have no variable in common.
    """
    common = set(runs[0].names).intersection(*(run.names for run in runs[1:]))
    wanted = specs or figures_of([name for name in runs[0].names if name in common])
    kept, gone = [], []
    for spec in wanted:
        if spec.x != "time" and spec.x not in common:
            gone.append(f"figure '{spec.title}' (over {spec.x})")
            continue
        chosen = [[i for i, name in enumerate(panel) if name in common] for panel in spec.panels]
        gone += [n for panel in spec.panels for n in panel if n not in common]
        rows = [k for k, positions in enumerate(chosen) if positions]
        if rows:
            kept.append(
                replace(
                    spec,
                    panels=tuple(tuple(spec.panels[k][i] for i in chosen[k]) for k in rows),
                    labels=tuple(spec.labels[k] for k in rows) if spec.labels else (),
                    legends=tuple(tuple(spec.legends[k][i] for i in chosen[k]) for k in rows)
                    if spec.legends
                    else (),
                )
            )
    if not kept:
        models = " and ".join(dict.fromkeys(run.model for run in runs))
        raise UsageError(f"{models}: these runs have no variable in common that could be drawn")
    names = ", ".join(dict.fromkeys(gone))
    return tuple(kept), (f"not drawn, as not every run has it: {names}",) if gone else ()


def draw_overlay(specs: Sequence[FigureSpec], runs: Sequence[Trajectory]) -> list[Figure]:
    """Draw the curves of several runs over each other, in display units.

    Args:
        specs: What stands in each figure; every run has all of it: see `shared_specs`.
        runs: Two or more, with output times of their own.
    """
    labels = run_labels(runs)
    with matplotlib.rc_context(STYLE):
        return [_overlaid_figure(spec, runs, labels) for spec in specs]


def run_labels(runs: Sequence[Trajectory]) -> list[str]:
    """Return what tells the runs apart: of model, solver and values what is not always the same."""
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


def _overlaid_figure(spec: FigureSpec, runs: Sequence[Trajectory], labels: Sequence[str]) -> Figure:
    count = len(spec.panels)
    height = 1.0 + (4.4 if spec.equal else 2.6 if count == 1 else 1.9) * count
    figure = Picture(figsize=(_WIDTH, height), layout="constrained")
    rows = figure.subplots(count, 1, squeeze=False, sharex=spec.x == "time").ravel()
    figure.suptitle(fill(spec.title, 70), fontsize=11)
    told = []
    for axis, panel in zip(rows, spec.panels, strict=True):
        _overlaid_panel(axis, spec, panel, runs, labels)
    for run, label in zip(runs, labels, strict=True):
        start, reasons = run.validity
        if text := invalid_text(start, reasons, _WIDTH):
            told.append(fill(f"{label}, {text}", 95, max_lines=3, placeholder=" ..."))
            for axis in rows if spec.x == "time" else ():
                shade_invalid(axis, run.time, start)
    handles, names = rows[0].get_legend_handles_labels()
    if len(spec.panels) > 1 and all(len(panel) == 1 for panel in spec.panels):
        names = list(labels)
    figure.legend(handles, names, loc="outside lower center", ncols=min(3, len(names)), fontsize=8)
    if told:
        figure.supxlabel("\n".join(told), fontsize=7, color=INVALID)
    return figure


def _overlaid_panel(
    axis: Axes,
    spec: FigureSpec,
    panel: Sequence[str],
    runs: Sequence[Trajectory],
    labels: Sequence[str],
) -> None:
    several = len(panel) > 1
    for i, name in enumerate(panel):
        for k, (run, label) in enumerate(zip(runs, labels, strict=True)):
            column = run.column(name)
            over = run.time if spec.x == "time" else run.column(spec.x).shown(run[spec.x])
            axis.plot(
                over,
                column.shown(run[name]),
                color=COLOURS[(i if several else k) % len(COLOURS)],
                linestyle=LINES[k % len(LINES)],
                linewidth=1.6 - 0.25 * min(k, 3),
                label=f"{name}, {label}" if several else label,
            )
    first = runs[0].column(panel[0])
    axis.set_ylabel(fill(f"{', '.join(panel)} [{first.shown_unit}]", 24))
    unit = "s" if spec.x == "time" else runs[0].column(spec.x).shown_unit
    axis.set_xlabel(f"{spec.x_label or spec.x} [{unit}]")
    axis.label_outer()
    if spec.equal:
        axis.set_aspect("equal", adjustable="datalim")
    else:
        everything = np.concatenate([run.column(n).shown(run[n]) for run in runs for n in panel])
        keep_constant_flat(axis, everything, float(first.shown(np.array([first.nominal]))[0]))
