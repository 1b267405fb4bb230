"""The map of the extremes: for each limit its values across, formulations and solvers down."""

from collections.abc import Sequence

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from cosim.plotting import STYLE, Picture
from cosim.study.extremes.campaign import CaseFinding
from cosim.study.extremes.cases import Case
from cosim.study.extremes.oracles import OUTCOMES

OUTCOME_COLOURS = {
    "accurate": "#2a9d5c",
    "refused": "#4c78a8",
    "failed": "#f2b134",
    "silent": "#d62728",
    "unverified": "#9467bd",
    "hang": "#111111",
    "crash": "#7f0000",
}
LETTERS = {  # for print without colour; what is accurate stays empty
    "accurate": "",
    "refused": "r",
    "failed": "f",
    "silent": "S",
    "unverified": "u",
    "hang": "H",
    "crash": "C",
}
_CELL, _HEAD = 0.16, 0.95  # inches: a row, and what stands around a panel
_MAP_WIDTH = 15.0


def draw_map(findings: Sequence[CaseFinding]) -> Figure:
    """Draw a panel per family of cases: values of its parameter across, who ran it down."""
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
            Line2D([], [], marker="s", linestyle="", color=OUTCOME_COLOURS[o],
                   label=f"{o}{f' ({LETTERS[o]})' if LETTERS[o] else ''}: {everyone.count(o)}")
            for o in OUTCOMES
        ]  # fmt: skip
        figure.legend(
            handles=handles, loc="outside lower center", ncols=len(handles), frameon=False
        )
        figure.suptitle(f"{len(findings)} limit cases and how they end", fontsize=11)
    return figure


def _family_panel(axis: Axes, family: str, findings: Sequence[CaseFinding]) -> None:
    points = list(dict.fromkeys(_parameter_value(f.case) for f in findings))
    runners = sorted({_runner(f.case) for f in findings})
    for finding in findings:
        x, y = points.index(_parameter_value(finding.case)), runners.index(_runner(finding.case))
        outcome = finding.verdict.outcome
        axis.plot(x, y, "s", color=OUTCOME_COLOURS[outcome], markersize=8, markeredgewidth=0)
        if LETTERS[outcome]:
            axis.text(x, y, LETTERS[outcome], ha="center", va="center", fontsize=6, color="white")
    axis.set_title(f"{family} ({len(findings)})", fontsize=9, loc="left")
    axis.set_xticks(range(len(points)), points, rotation=35, ha="right", fontsize=6)
    axis.set_yticks(range(len(runners)), runners, fontsize=6)
    axis.set_xlim(-0.8, max(len(points), 8) - 0.2)
    axis.set_ylim(len(runners) - 0.4, -0.6)
    axis.tick_params(length=0)


def _parameter_value(case: Case) -> str:
    """Return which value of the family's parameter a case has."""
    return case.name.removesuffix(f", {case.solver}")


def _runner(case: Case) -> str:
    """Return formulation and solver."""
    model = case.model.partition("/")[2] or case.model
    several = case.family in ("mass ratios", "tolerances")
    return ", ".join(filter(None, (case.model if several else model, case.solver)))
