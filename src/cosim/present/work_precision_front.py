"""The figure of a trade-off study for a lecture: the front, and the best run of each solver."""

from collections.abc import Sequence
from itertools import groupby
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from cosim.plotting import STYLE, Picture
from cosim.present.work_precision import SOLVER_COLOURS
from cosim.study.tradeoff.configuration import Family
from cosim.study.tradeoff.measurement import Measurement
from cosim.study.tradeoff.result import Tradeoff

_SOLVER_MARKERS = dict(zip(SOLVER_COLOURS, "osD^vP*Xp", strict=True))
_MOST_NAMES = 10  # names of the front
_GOOD = 1e-6  # nominal values: at what error solvers are compared


def draw_front(study: Tradeoff) -> Figure:
    """Draw global error against time: the Pareto front in black, and one line for each solver.

    A solver's line is that of the formulation, road and reduction with which it is cheapest at an
    error of 1e-6, or most accurate. Numbers beside the front stand for the names at the right.
    """
    timed = any(m.solver_time for m in study.competing)
    cost, factor = ("solver_time", 1e3) if timed else ("rhs_calls", 1.0)
    front = study.front(cost)
    with matplotlib.rc_context(STYLE | {"font.size": 11}):
        figure = Picture(figsize=(11.0, 5.8), layout="constrained")
        axis = figure.subplots()
        axis.set_xscale("log")
        axis.set_yscale("log")
        for family, members in _best(study.competing, cost).items():
            members = sorted(members, key=lambda m: -_shown_error(study, m))
            points = [(factor * (m.cost(cost) or 0.0), _shown_error(study, m)) for m in members]
            solver = family[3]
            axis.plot(
                *zip(*points, strict=True),
                marker=_SOLVER_MARKERS[solver],
                color=SOLVER_COLOURS[solver],
                linewidth=1.2,
                markersize=6,
                label=_family_name(family),
            )
        prices = [factor * (m.cost(cost) or 0.0) for m in front]
        errors = [_shown_error(study, m) for m in front]
        axis.plot(prices, errors, color="black", linewidth=2.4, label="Pareto front", zorder=4)
        notes = _write_numbers(axis, front, prices, errors)
        low, high = axis.get_ylim()
        axis.axhspan(min(low, study.floor / 10), study.floor, color="0.9", zorder=0)
        axis.set_ylim(min(low, study.floor / 10), high)
        axis.set_xlabel(
            "time of the solver [ms], median" if timed else "right-hand sides evaluated"
        )
        axis.set_ylabel("largest global error [nominal values]")
        axis.set_title(f"{study.scene}: error against cost", fontsize=12)
        legend = figure.legend(loc="outside right upper", fontsize=9, title="cheapest form of each")
        legend.get_title().set_fontsize(9)
        unseen = [Line2D([], [], linestyle="") for _ in notes]
        figure.legend(
            unseen, notes, loc="outside right lower", fontsize=9, title="on the front",
            title_fontsize=9, handlelength=0, handletextpad=0,
        )  # fmt: skip
    return figure


def _best(shown: Sequence[Measurement], cost: str) -> dict[Family, list[Measurement]]:
    """Return of each solver the family that is cheapest at a good error, or else most accurate."""
    families: dict[Family, list[Measurement]] = {}
    for m in shown:
        if m.error is not None and m.cost(cost) is not None:
            families.setdefault(m.configuration.family, []).append(m)
    best: dict[str, tuple[tuple[bool, float], Family]] = {}
    for family, members in families.items():
        good = [m.cost(cost) or 0.0 for m in members if (m.error or 0.0) <= _GOOD]
        rank = (False, min(good)) if good else (True, min(m.error or 0.0 for m in members))
        if family[3] not in best or rank < best[family[3]][0]:
            best[family[3]] = rank, family
    return {family: families[family] for _, family in best.values()}


def _write_numbers(
    axis: Axes, front: Sequence[Measurement], prices: Sequence[float], errors: Sequence[float]
) -> list[str]:
    """Write a number at each stretch of the front in one family; return what they stand for."""
    points = list(zip(front, prices, errors, strict=True))
    stretches = [list(g) for _, g in groupby(points, key=lambda p: p[0].configuration.family)]
    stretches = sorted(sorted(stretches, key=len)[-_MOST_NAMES:], key=lambda s: s[0][1])
    notes = []
    for number, stretch in enumerate(stretches, start=1):
        first, price, error = stretch[len(stretch) // 2]
        box = {"boxstyle": "circle,pad=0.25", "facecolor": "black", "edgecolor": "white"}
        style: Any = {"ha": "center", "va": "center", "color": "white", "zorder": 6, "bbox": box}
        axis.text(price, error, str(number), fontsize=9, **style)
        start, last = stretch[0][0].configuration, stretch[-1][0].configuration
        setting = start.setting if len(stretch) == 1 else f"{start.setting} ... {last.setting}"
        notes.append(f"{number}  {_family_name(first.configuration.family)}, {setting}")
    return notes


def _family_name(family: Family) -> str:
    model, reduced, road, solver, control = family
    parts = (solver, model.partition("/")[2], road, "reduced" if reduced else "", control or "")
    return ", ".join(filter(None, parts))


def _shown_error(study: Tradeoff, measurement: Measurement) -> float:
    return max(measurement.error or 0.0, study.floor)
