"""Figures of studies: eigenvalues, sensitivities, extreme cases."""

from collections.abc import Sequence

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from casadi_models.extreme_cases import Case
from cosim.colors import CURVES
from cosim.colors import OUTCOMES as OUTCOME_COLORS
from cosim.plotting import STYLE, Picture
from cosim.study.extremes.campaign import CaseFinding
from cosim.study.extremes.oracles import OUTCOMES
from cosim.study.linearize.linearize import EigenvalueSweep
from cosim.study.sensitivity.result import Sensitivity

_NOTHING = 1e-9  # parts of eigenvalues below this share of the largest count as zero


def draw_eigenvalues(sweep: EigenvalueSweep) -> Figure:
    """Draw eigenvalues over a parameter: real parts solid, imaginary dashed; shade where stable."""
    figure = Figure(figsize=(7.0, 4.6), layout="constrained")
    axis = figure.subplots()
    size = float(abs(sweep.eigenvalues).max()) or 1.0
    colors: dict[str, str] = {}
    for j, (column, mode) in enumerate(zip(sweep.eigenvalues.T, sweep.modes, strict=True)):
        if abs(column).max() <= _NOTHING * size:
            continue
        label = mode if mode not in colors else None
        color = colors.setdefault(mode or f"column {j}", CURVES[len(colors) % len(CURVES)])
        axis.plot(sweep.values, column.real, color=color, linewidth=1.2, label=label or None)
        imaginary = abs(column.imag)
        if imaginary.max() > _NOTHING * size:
            axis.plot(sweep.values, imaginary, "--", color=color, linewidth=0.8)
    axis.axhline(0.0, color="black", linewidth=0.6)
    stable = (sweep.eigenvalues.real < _NOTHING * size).all(axis=1)
    across = axis.get_xaxis_transform()
    axis.fill_between(sweep.values, 0, 1, where=stable, transform=across, color="0.92", zorder=0)
    for crossing in sweep.crossings:
        axis.axvline(crossing.value, color="0.5", linewidth=0.8)
        outputs = [f"{name} {value:.4g}" for name, value in crossing.outputs.items()]
        axis.annotate(
            ", ".join([crossing.mode, f"{crossing.value:.6g}", *outputs[:2]]),
            (crossing.value, 0.02),
            xycoords=("data", "axes fraction"),
            rotation=90,
            ha="right",
            va="bottom",
            fontsize=7,
            color="0.3",
        )
    if any(sweep.modes):
        axis.legend(fontsize=8)
    unit = f" [{sweep.unit}]" if sweep.unit else ""
    axis.set_xlabel(f"{sweep.name}{unit}")
    axis.set_ylabel("eigenvalue [1/s]: real part, imaginary part dashed")
    axis.set_title(f"{sweep.points[0].model}; gray: stable", fontsize=10)
    return figure


MOST_PANELS, MOST_CURVES = 8, 6


def draw_sensitivity(found: Sensitivity) -> Figure:
    """Draw derivatives of outputs over time, scaled by the sizes of output and target."""
    names = found.run.names[:MOST_PANELS]
    figure = Figure(figsize=(7.5, 1.0 + 1.9 * len(names)), layout="constrained")
    axes = figure.subplots(len(names), 1, sharex=True, squeeze=False).ravel()
    scaled = found.scaled
    heaviest = np.argsort(-np.abs(scaled).max(axis=(0, 1)), kind="stable")
    colors = {int(j): CURVES[place % len(CURVES)] for place, j in enumerate(heaviest)}
    for i, (axis, name) in enumerate(zip(axes, names, strict=True)):
        weights = np.abs(scaled[:, i, :]).max(axis=0)
        order = np.argsort(-weights, kind="stable")
        for rank, j in enumerate(order):
            named = rank < MOST_CURVES and weights[j] > 0
            axis.plot(
                found.run.time,
                scaled[:, i, j],
                color=colors[int(j)] if named else "0.85",
                linewidth=1.1 if named else 0.6,
                label=found.targets[j].name if named else None,
                zorder=3 if named else 1,
            )
        axis.set_ylabel(name)
        if axis.get_legend_handles_labels()[0]:
            axis.legend(fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5))
        axis.grid(visible=True, alpha=0.3)
    axes[-1].set_xlabel("time [s]")
    figure.suptitle(f"{found.run.model}: derivatives, scaled", fontsize=10)
    return figure


LOOKS = dict(zip(OUTCOMES, OUTCOME_COLORS, strict=True))
# For print without color; accurate cases have none, severe ones a capital
LETTERS = dict(zip(OUTCOMES, ("", "r", "f", "S", "u", "H", "C"), strict=True))

_CELL, _HEAD = 0.16, 0.95  # heights of a row and of the space around a panel, inches
_MAP_WIDTH = 15.0


def draw_map(findings: Sequence[CaseFinding]) -> Figure:
    """Draw a panel for each family of cases: parameter values across, solvers down."""
    families: dict[str, list[CaseFinding]] = {}
    for finding in findings:
        families.setdefault(finding.case.family, []).append(finding)
    columns: list[list[str]] = [[], []]
    heights = [0.0, 0.0]
    for family, members in families.items():
        shorter = heights.index(min(heights))
        columns[shorter].append(family)
        heights[shorter] += _HEAD + _CELL * len({_runner(f.case) for f in members})
    with matplotlib.rc_context(STYLE | {"axes.grid": False}):
        used = [names for names in columns if names]
        size = (_MAP_WIDTH * len(used) / 2, max(heights) + 0.9)
        figure = Picture(figsize=size, layout="constrained")
        parts = figure.subfigures(1, len(used), squeeze=False)[0]
        for part, names in zip(parts, used, strict=True):
            rows = [_HEAD + _CELL * len({_runner(f.case) for f in families[n]}) for n in names]
            axes = part.subplots(len(names), 1, squeeze=False, height_ratios=rows).ravel()
            for axis, name in zip(axes, names, strict=True):
                _family_panel(axis, name, families[name])
        everyone = [finding.verdict.outcome for finding in findings]
        handles = [
            Line2D([], [], marker="s", linestyle="", color=LOOKS[o],
                   label=f"{o}{f' ({LETTERS[o]})' if LETTERS[o] else ''}: {everyone.count(o)}")
            for o in OUTCOMES
        ]  # fmt: skip
        figure.legend(
            handles=handles, loc="outside lower center", ncols=len(handles), frameon=False
        )
        figure.suptitle(f"{len(findings)} extreme cases and their outcomes", fontsize=11)
    return figure


def _family_panel(axis: Axes, family: str, findings: Sequence[CaseFinding]) -> None:
    points = list(dict.fromkeys(_parameter_value(f.case) for f in findings))
    runners = sorted({_runner(f.case) for f in findings})
    for finding in findings:
        x, y = points.index(_parameter_value(finding.case)), runners.index(_runner(finding.case))
        outcome = finding.verdict.outcome
        axis.plot(x, y, "s", color=LOOKS[outcome], markersize=8, markeredgewidth=0)
        if letter := LETTERS[outcome]:
            axis.text(x, y, letter, ha="center", va="center", fontsize=6, color="white")
    axis.set_title(f"{family} ({len(findings)})", fontsize=9, loc="left")
    turned = {"rotation": 90} if len(points) > 20 else {"rotation": 35, "ha": "right"}
    axis.set_xticks(range(len(points)), points, fontsize=6, **turned)
    axis.set_yticks(range(len(runners)), runners, fontsize=6)
    axis.set_xlim(-0.8, max(len(points), 8) - 0.2)
    axis.set_ylim(len(runners) - 0.4, -0.6)
    axis.tick_params(length=0)


def _parameter_value(case: Case) -> str:
    """Return the value of the family's parameter in a case."""
    return case.name.removesuffix(f", {case.solver}")


def _runner(case: Case) -> str:
    """Return formulation and solver of a case."""
    model = case.model.partition("/")[2] or case.model
    several = case.family in ("mass ratios", "tolerances")
    return ", ".join(filter(None, (case.model if several else model, case.solver)))
