"""The figure of a trade-off study: error and drift against cost, both logarithmic."""

from collections.abc import Callable, Iterator, Sequence
from itertools import groupby
from math import log10
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from cosim.plotting import Picture
from cosim.scene.roads import Road
from cosim.study.tradeoff.configuration import Family
from cosim.study.tradeoff.measurement import Measurement
from cosim.study.tradeoff.result import Tradeoff
from cosim.text.lists import shortened

# Okabe and Ito's colours, which colour-blind readers can tell apart, and two darker ones
SOLVER_COLOURS = {
    "cvodes": "#0072B2",
    "cvodes_adams": "#56B4E9",
    "idas": "#CC79A7",
    "erk": "#D55E00",
    "rosenbrock": "#009E73",
    "dop853": "#6A3D9A",
    "ode8": "#8B6914",
    "rk4": "#E69F00",
    "cvode": "#444444",  # fmpy's
}
_ROAD_MARKERS = dict(zip(Road, "osD^", strict=True))
_MILLISECONDS = 1e3
_SMALLEST = 1e-17  # a difference of zero has no logarithm
_ROOM = 0.62  # for the names of the front, in widths of what is drawn
_LINE = 0.021  # from one name to the next, in heights of the panel
_STYLE: dict[Any, Any] = {
    "font.size": 9,
    "axes.axisbelow": True,
    "axes.linewidth": 0.6,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "grid.alpha": 0.3,
    "grid.linewidth": 0.5,
    "legend.fontsize": 8,
}


def draw_tradeoff(study: Tradeoff) -> Figure:
    """Draw global error against right-hand sides and against time, and drift against time.

    One marker per configuration: colour for the solver, shape for the road, filled for the full and
    hollow for the reduced model, faint for other formulations than the first. The Pareto front is
    the black line, named where nothing can be: to its left. The reference's own error is the grey
    band. Runs with steps longer than the output interval are left out.
    """
    shown = study.competing
    with matplotlib.rc_context(_STYLE):
        panels = 3 if any(m.drift for m in shown) else 2
        figure = Picture(figsize=(6.4 * panels, 7.4), layout="constrained")
        axes = figure.subplots(1, panels, width_ratios=(1.2, 1.2, 0.8)[:panels])
        _errors(axes[0], study, shown, "rhs_calls", 1.0)
        axes[0].set_xlabel("right-hand sides evaluated")
        _errors(axes[1], study, shown, "solver_time", _MILLISECONDS)
        axes[1].set_xlabel("time of the solver [ms]: median; of the front also fastest to slowest")
        if panels == 3:
            _scatter(axes[2], shown, "solver_time", _MILLISECONDS, lambda m: m.drift)
            axes[2].set_xlabel("time of the solver [ms], median")
            axes[2].set_ylabel("largest drift [nominal values]")
            axes[2].set_title(f"needs no reference: {shortened(study.invariants, 5)}", fontsize=8)
        without = sum(m.error is None for m in study.measurements)
        values = f" with {study.provenance['values']}" if "values" in study.provenance else ""
        figure.suptitle(
            f"{study.scene}{values}: global error against cost of {len(shown)} configurations"
            + (f" ({without} more have no result)" if without else ""),
            fontsize=12,
        )
        figure.legend(handles=_legend(shown), loc="outside lower center", ncols=8)
    return figure


def _errors(
    axis: Axes, study: Tradeoff, shown: Sequence[Measurement], cost: str, factor: float
) -> None:
    _scatter(axis, shown, cost, factor, lambda m: m.error)
    front = study.front(cost)
    prices = [factor * (m.cost(cost) or 0.0) for m in front]
    errors = [max(m.error or 0.0, study.floor) for m in front]
    axis.plot(prices, errors, color="black", linewidth=1.1, zorder=4)
    if cost == "solver_time":
        for measurement, error in zip(front, errors, strict=True):
            if (time := measurement.solver_time) is not None:
                ends = (factor * time.fastest, factor * time.slowest)
                axis.plot(ends, (error, error), color="0.4", linewidth=0.6, zorder=1)
    low, high = axis.get_ylim()
    low = min(low, study.floor / 30)
    axis.axhspan(low, study.floor, color="0.9", zorder=0)
    axis.set_ylim(low, high)
    if prices:
        left, right = axis.get_xlim()
        axis.set_xlim(prices[0] / (right / left) ** _ROOM, right)
        _name(axis, list(_labels(front, prices, errors)))
    reference = study.reference
    axis.set_title(
        f"grey: the reference's own error, {study.floor:.0e} "
        f"({reference.method} against {reference.check})",
        fontsize=8,
    )
    axis.set_ylabel("largest global error of the kept outputs [nominal values]")


def _scatter(
    axis: Axes,
    shown: Sequence[Measurement],
    cost: str,
    factor: float,
    height: Callable[[Measurement], float | None],
) -> None:
    first = shown[0].configuration.model
    families: dict[Family, list[tuple[float, float]]] = {}
    for measurement in shown:
        price, value = measurement.cost(cost), height(measurement)
        if price is None or value is None:
            continue
        configuration = measurement.configuration
        point = (factor * price, max(value, _SMALLEST))
        families.setdefault(configuration.family, []).append(point)
        colour = SOLVER_COLOURS[configuration.solver]
        axis.plot(
            *point,
            _ROAD_MARKERS[configuration.road],
            color=colour,
            markerfacecolor="none" if configuration.reduced else colour,
            markersize=4.5,
            alpha=0.9 if configuration.model == first else 0.3,
            markeredgewidth=0.9,
        )
    for (model, _, _, solver, _), points in families.items():
        along = sorted(points, key=lambda point: -point[1])
        alpha = 0.5 if model == first else 0.2
        axis.plot(
            *zip(*along, strict=True), color=SOLVER_COLOURS[solver], linewidth=0.6, alpha=alpha
        )
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.grid(True)


def _labels(
    front: Sequence[Measurement], prices: Sequence[float], errors: Sequence[float]
) -> Iterator[tuple[str, float, float, float]]:
    """Yield a name for each stretch of the front in one family, its place, and its last error."""
    points = zip(front, prices, errors, strict=True)
    for _, group in groupby(points, key=lambda point: point[0].configuration.family):
        members = list(group)
        (first, price, error), (last, _, lowest) = members[0], members[-1]
        more = f" ... {last.configuration.setting}" if len(members) > 1 else ""
        yield f"{first.configuration.short}{more}", price, error, lowest


def _name(axis: Axes, labels: Sequence[tuple[str, float, float, float]]) -> None:
    """Write names to the left of the front, each below the one before and what that stands for."""
    low, high = (log10(limit) for limit in axis.get_ylim())

    def part(error: float) -> float:  # of the panel's height
        return (log10(error) - low) / (high - low)

    most = 1.0
    for text, price, error, lowest in labels:
        height = min(part(error), most)
        name = axis.annotate(
            text,
            (price, error),
            xytext=(price / 1.3, 10 ** (low + height * (high - low))),
            ha="right",
            va="center",
            fontsize=6.5,
            arrowprops={"arrowstyle": "-", "color": "0.6", "linewidth": 0.4, "shrinkB": 2},
            zorder=5,
        )
        name.set_in_layout(False)  # or a long one would push the panels aside
        most = min(height, part(lowest) + _LINE / 2) - _LINE


def _legend(shown: Sequence[Measurement]) -> list[Line2D]:
    configurations = [m.configuration for m in shown]
    roads = [road for road in Road if any(c.road == road for c in configurations)]
    solvers = [name for name in SOLVER_COLOURS if any(c.solver == name for c in configurations)]
    handles = [_legend_entry("o", SOLVER_COLOURS[name], name) for name in solvers]
    handles += [_legend_entry(_ROAD_MARKERS[road], "0.3", road) for road in roads]
    if any(c.reduced for c in configurations):
        handles.append(_legend_entry("o", "0.3", "reduced to the kept outputs", hollow=True))
    first, *others = dict.fromkeys(c.model for c in configurations)
    if others:
        names = ", ".join(name.partition("/")[2] for name in others)
        handles.append(_legend_entry("o", "0.3", first))
        handles.append(_legend_entry("o", "0.8", f"faint: {names}"))
    handles.append(Line2D([], [], color="black", label="Pareto front"))
    return handles


def _legend_entry(marker: str, colour: str, label: str, *, hollow: bool = False) -> Line2D:
    face = "none" if hollow else colour
    return Line2D(
        [], [], marker=marker, color=colour, markerfacecolor=face, linestyle="", label=label
    )
