"""The map of the extremes: every case as a square, coloured by how it ended."""

from collections.abc import Sequence
from math import ceil

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from cosim.study.extremes.campaign import Finding
from cosim.study.extremes.oracles import OUTCOMES

COLOURS = {
    "accurate": "#2a9d5c",
    "refused": "#4c78a8",
    "failed": "#f2b134",
    "silent": "#d62728",
    "unverified": "#9467bd",
    "hang": "#111111",
    "crash": "#7f0000",
}
_ACROSS = 54  # cases in a line


def draw_map(findings: Sequence[Finding]) -> Figure:
    """Draw a block of squares per family, in the order of the catalogue."""
    families: dict[str, list[str]] = {}
    for finding in findings:
        families.setdefault(finding.case.family, []).append(finding.verdict.outcome)
    lines = sum(ceil(len(outcomes) / _ACROSS) for outcomes in families.values())
    figure = Figure(figsize=(11, 0.26 * lines + 1.3), layout="constrained")
    axis = figure.subplots()
    ticks, labels, line = [], [], 0
    for family, outcomes in families.items():
        places = [(i % _ACROSS, line + i // _ACROSS) for i in range(len(outcomes))]
        colours = [COLOURS[outcome] for outcome in outcomes]
        across, down = zip(*places, strict=True)
        axis.scatter(across, down, c=colours, marker="s", s=62, linewidths=0)
        ticks.append(line)
        labels.append(f"{family} ({len(outcomes)})")
        line += ceil(len(outcomes) / _ACROSS)
    axis.set_yticks(ticks, labels, fontsize=9)
    axis.set_xticks([])
    axis.set_xlim(-0.8, _ACROSS - 0.2)
    axis.set_ylim(line - 0.4, -0.6)
    for side in axis.spines.values():
        side.set_visible(False)
    axis.tick_params(length=0)
    everyone = [finding.verdict.outcome for finding in findings]
    handles = [
        Line2D(
            [], [], marker="s", linestyle="", color=COLOURS[o], label=f"{o}: {everyone.count(o)}"
        )
        for o in OUTCOMES
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)
    axis.set_title(f"{len(findings)} limit cases and how they end", fontsize=11)
    return figure
