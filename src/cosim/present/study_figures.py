"""Figures of studies: eigenvalues, sensitivities, extreme cases."""

import re
from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from cosim.colors import CURVES, MARKERS
from cosim.colors import OUTCOMES as OUTCOME_COLORS
from cosim.plotting import LINES, STYLE, Picture
from cosim.study.extremes.campaign import CaseFinding
from cosim.study.extremes.oracles import OUTCOMES
from cosim.study.linearize.linearize import EigenvalueSweep
from cosim.study.sensitivity.result import Sensitivity

_NOTHING = 1e-9  # parts of eigenvalues below this share of the largest count as zero
_CLOSE = 0.2  # share of the axis; texts of crossings with less between them stand higher in turn


def draw_eigenvalues(sweep: EigenvalueSweep) -> Figure:
    """Draw eigenvalues over a parameter, shade where all are stable, and name the crossings."""
    size = float(abs(sweep.eigenvalues).max()) or 1.0
    looks: dict[str, dict[str, Any]] = {}
    with matplotlib.rc_context(STYLE):
        figure = Picture(figsize=(7.0, 4.8), layout="constrained")
        axis = figure.subplots()
        for j, (column, mode) in enumerate(zip(sweep.eigenvalues.T, sweep.modes, strict=True)):
            if abs(column).max() <= _NOTHING * size:
                continue
            i, label = len(looks), None if mode in looks else mode or None
            color, marker = CURVES[i % len(CURVES)], MARKERS[i % len(MARKERS)]
            new = {"color": color, "marker": marker, "markevery": 0.1, "markersize": 4}
            look = looks.setdefault(mode or f"column {j}", new)
            axis.plot(sweep.values, column.real, label=label, **look)
            if abs(column.imag).max() > _NOTHING * size:
                axis.plot(sweep.values, abs(column.imag), "--", **look)
        axis.plot([], [], color="0.3", label="real part")
        axis.plot([], [], "--", color="0.3", label="imaginary part")
        axis.axhline(0.0, color="black", linewidth=0.6)
        stable = (sweep.eigenvalues.real < _NOTHING * size).all(axis=1)
        band: Any = {"transform": axis.get_xaxis_transform(), "color": "0.9", "zorder": 0}
        axis.fill_between(sweep.values, 0, 1, where=stable, label="stable", **band)
        axis.margins(x=0)
        axis.set(xlabel=f"{sweep.name} [{sweep.unit}]", ylabel="eigenvalue [1/s]")
        close, labels, previous, higher = _CLOSE * float(np.ptp(sweep.values)), [], -np.inf, False
        for crossing in sweep.crossings:
            axis.axvline(crossing.value, color="0.5", linewidth=0.8)
            higher = crossing.value - previous < close and not higher
            outputs = [f"{n} {v:.4g} {sweep.units[n]}" for n, v in crossing.outputs.items()][:1]
            lines = [crossing.mode, f"{crossing.value:.4g} {sweep.unit}", *outputs]
            labels.append("\n".join(lines + [""] * len(lines) * higher))
            previous = crossing.value
        axis.secondary_xaxis("top").set_xticks([c.value for c in sweep.crossings], labels)
        figure.legend(loc="outside lower center", ncols=6)
        figure.suptitle(f"{sweep.points[0].model}: eigenvalues", fontsize=11)
    return figure


MOST_PANELS, MOST_CURVES = 8, 6


def draw_sensitivity(found: Sensitivity) -> Figure:
    """Draw derivatives of outputs over time, scaled by the sizes of output and target."""
    names, scaled = found.run.names[:MOST_PANELS], found.scaled
    heaviest = np.argsort(-np.abs(scaled).max(axis=(0, 1)), kind="stable")
    looks: dict[int, dict[str, Any]] = {
        int(j): {"color": CURVES[i % len(CURVES)], "linestyle": LINES[i % len(LINES)], "zorder": 3}
        for i, j in enumerate(heaviest)
    }
    with matplotlib.rc_context(STYLE):
        figure = Picture(figsize=(7.5, 1.0 + 1.9 * len(names)), layout="constrained")
        axes = figure.subplots(len(names), 1, sharex=True, squeeze=False).ravel()
        for i, (axis, name) in enumerate(zip(axes, names, strict=True)):
            order = np.argsort(-np.abs(scaled[:, i, :]).max(axis=0), kind="stable")
            for rank, j in enumerate(order):
                label: str | None = found.targets[j].name
                look = looks[int(j)]
                if rank >= MOST_CURVES:
                    label = "others" if rank == MOST_CURVES else None
                    look = {"color": "0.8", "linewidth": 0.6, "zorder": 1}
                axis.plot(found.run.time, scaled[:, i, j], label=label, **look)
            axis.set_ylabel(f"change of {name}\n[nominal values]")
            axis.margins(x=0)
            axis.legend(title="changed value", loc="center left", bbox_to_anchor=(1.0, 0.5))
        axes[-1].set_xlabel("time [s]")
        title = f"{found.run.model}: change of outputs, to first order, if a value changes by 100 %"
        figure.suptitle(title, fontsize=11)
    return figure


LOOKS = dict(zip(OUTCOMES, OUTCOME_COLORS, strict=True))
# For print without color; accurate cases have none, severe ones a capital
LETTERS = dict(zip(OUTCOMES, ("", "r", "f", "S", "u", "H", "C"), strict=True))
_TEXTS = ("accurate", "refused (r) before the run", "failed (f): stopped or reported as invalid",
          "silent (S): wrong, not reported", "unverified (u)", "hang (H)", "crash (C)")  # fmt: skip

_CELL, _HEAD = 0.165, 0.85  # heights of a row and of the space around a panel, inches
_WIDE, _ROOM, _LETTER = 5.5, 3.2, 0.065  # widths of a column, its axes and a letter, inches
# Parameter, separator, number and unit in the name of a case
_VALUE = re.compile(r"(.*?)( = | x | at | |)([-+.e\d]*\d|nan)( \D+)?")


def draw_map(findings: Sequence[CaseFinding]) -> Figure:
    """Draw a panel for each family of cases: parameter values across, solvers down."""
    families: dict[str, list[CaseFinding]] = {}
    for finding in findings:
        families.setdefault(finding.case.family, []).append(finding)
    rows = {name: len({row for row, _ in _places(found)[1]}) for name, found in families.items()}
    columns: list[list[str]] = [[], []]
    heights = [0.0, 0.0]
    for family in families:
        shorter = heights.index(min(heights))
        columns[shorter].append(family)
        heights[shorter] += _HEAD + _CELL * rows[family]
    used = [names for names in columns if names]
    with matplotlib.rc_context(STYLE | {"axes.grid": False}):
        figure = Picture(figsize=(_WIDE * len(used), max(heights) + 1.0), layout="constrained")
        parts = figure.subfigures(1, len(used), squeeze=False)[0]
        for part, names in zip(parts, used, strict=True):
            ratios = [rows[name] for name in names]
            axes = part.subplots(len(names), 1, squeeze=False, height_ratios=ratios).ravel()
            for axis, name in zip(axes, names, strict=True):
                _family_panel(axis, name, families[name])
        everyone = [finding.verdict.outcome for finding in findings]
        handles = [
            Line2D(
                [], [], marker="s", linestyle="", color=look, label=f"{text}: {everyone.count(o)}"
            )
            for (o, look), text in zip(LOOKS.items(), _TEXTS, strict=True)
        ]
        figure.legend(handles=handles, loc="outside lower center", ncols=2 * len(used))
        figure.suptitle(f"{len(findings)} extreme cases and their outcomes", fontsize=11)
    return figure


def _family_panel(axis: Axes, family: str, findings: Sequence[CaseFinding]) -> None:
    label, places = _places(findings)
    rows, points = sorted({row for row, _ in places}), list(dict.fromkeys(p for _, p in places))
    for finding, (row, point) in zip(findings, places, strict=True):
        x, y, outcome = points.index(point), rows.index(row), finding.verdict.outcome
        axis.plot(x, y, "s", color=LOOKS[outcome], markersize=9, markeredgewidth=0)
        if letter := LETTERS[outcome]:
            style: Any = {"fontsize": 7, "fontweight": "bold", "color": "white"}
            axis.text(x, y, letter, ha="center", va="center_baseline", **style)
    axis.set_title(f"{family} ({len(findings)})", fontsize=9, loc="left")
    across = max(len(points), 8)
    crowded = across * max(map(len, points)) * _LETTER > _ROOM
    axis.set_xticks(range(len(points)), points, rotation=90 if crowded else 0, fontsize=7.5)
    axis.set_yticks(range(len(rows)), rows)
    axis.set(xlabel=label, xlim=(-0.8, across - 0.2), ylim=(len(rows) - 0.4, -0.6))
    axis.tick_params(length=0)


def _places(findings: Sequence[CaseFinding]) -> tuple[str, list[tuple[str, str]]]:
    """Return the label of a panel's horizontal axis, and the row and column of each case.

    A row is a formulation and a solver, with the parameter if there are several.
    """
    cases = [finding.case for finding in findings]
    names = [case.name.removesuffix(f", {case.solver}") for case in cases]
    parts = [m.groups("") if (m := _VALUE.fullmatch(n)) else ("", "", n, "") for n in names]
    several = len({case.model.partition("/")[0] for case in cases}) > 1
    models = [c.model if several else c.model.rpartition("/")[2] for c in cases]
    runners = [", ".join(filter(None, (m, c.solver))) for m, c in zip(models, cases, strict=True)]
    pairs = {(runner, part[0]) for runner, part in zip(runners, parts, strict=True)}
    ambiguous = [sum(runner == known for known, _ in pairs) > 1 for runner in runners]
    parameters, units = ({part[i] for part in parts} - {""} for i in (0, 3))
    places = [
        (f"{runner}, {p}" if more else runner, number + unit * (len(units) > 1))
        for runner, (p, _, text, unit), more in zip(runners, parts, ambiguous, strict=True)
        for number in [re.sub(r"e\+?(-?)0+(?=\d)", r"e\1", text)]
    ]
    label = [*parameters] * (len(parameters) == 1) + ["factor"] * (parts[0][1] == " x ")
    return " ".join(label + [f"[{unit.strip()}]" for unit in units if len(units) == 1]), places
