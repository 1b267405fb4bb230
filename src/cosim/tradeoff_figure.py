"""The figure of a trade-off study: error and drift against cost, both logarithmic."""

from collections.abc import Callable, Sequence
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from cosim.tradeoffs import ROADS, Measurement, Tradeoff

# Okabe and Ito's colours, which colour-blind readers can tell apart, by solver
_COLOURS = ("#0072B2", "#56B4E9", "#CC79A7", "#D55E00", "#009E73", "#E69F00", "#8B6914", "#555555")
_MARKERS = dict(zip(ROADS, "osD^", strict=True))
_MILLISECONDS = 1e3
_SMALLEST = 1e-17  # a difference of zero has no logarithm
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
    the black line with numbers, the reference's own error the grey band. Runs with steps longer
    than the output interval are left out.
    """
    shown = study.competing
    with matplotlib.rc_context(_STYLE):
        panels = 3 if any(m.drift for m in shown) else 2
        figure = Figure(figsize=(5.4 * panels, 6.2), layout="constrained")
        axes = figure.subplots(1, panels)
        _errors(axes[0], study, shown, "rhs_calls", 1.0, "right-hand sides")
        time = "time of the solver [ms], median"
        _errors(axes[1], study, shown, "solver_time", _MILLISECONDS, time)
        if panels == 3:
            _scatter(axes[2], shown, "solver_time", _MILLISECONDS, lambda m: m.drift)
            axes[2].set_xlabel(time)
            axes[2].set_ylabel("largest drift [nominal values]")
            axes[2].set_title(f"needs no reference: {_some(study.invariants)}", fontsize=8)
        figure.suptitle(f"{study.scene}: global error against cost", fontsize=12)
        figure.legend(handles=_legend(shown), loc="outside lower center", ncols=6)
    return figure


def _errors(
    axis: Axes,
    study: Tradeoff,
    shown: Sequence[Measurement],
    cost: str,
    factor: float,
    label: str,
) -> None:
    _scatter(axis, shown, cost, factor, lambda m: m.error)
    front = study.front(cost)
    prices = [factor * (m.cost(cost) or 0.0) for m in front]
    errors = [max(m.error or 0.0, study.floor) for m in front]
    axis.plot(prices, errors, color="black", linewidth=1.2, zorder=4)
    _name(axis, front, prices, errors)
    low, high = axis.get_ylim()
    low = min(low, study.floor / 10)
    axis.axhspan(low, study.floor, color="0.88", zorder=0)
    axis.set_ylim(low, high)
    axis.set_title(f"grey: the reference's own error, {study.floor:.0e}", fontsize=8)
    axis.set_xlabel(label)
    axis.set_ylabel("largest global error of the kept outputs [nominal values]")


def _scatter(
    axis: Axes,
    shown: Sequence[Measurement],
    cost: str,
    factor: float,
    height: Callable[[Measurement], float | None],
) -> None:
    first = shown[0].configuration.model
    colours = _colours(shown)
    families: dict[tuple[str, bool, str, str], list[tuple[float, float]]] = {}
    for measurement in shown:
        price, value = measurement.cost(cost), height(measurement)
        if price is None or value is None:
            continue
        configuration = measurement.configuration
        point = (factor * price, max(value, _SMALLEST))
        families.setdefault(configuration.family, []).append(point)
        colour = colours[configuration.solver]
        axis.plot(
            *point,
            _MARKERS[configuration.road],
            color=colour,
            markerfacecolor="none" if configuration.reduced else colour,
            markersize=4.5,
            alpha=0.9 if configuration.model == first else 0.35,
            markeredgewidth=0.9,
        )
    for (_, _, _, solver), points in families.items():
        along = sorted(points, key=lambda point: -point[1])
        axis.plot(*zip(*along, strict=True), color=colours[solver], linewidth=0.5, alpha=0.3)
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.grid(True)


def _name(
    axis: Axes, front: Sequence[Measurement], prices: Sequence[float], errors: Sequence[float]
) -> None:
    """Number the front, and list what the numbers stand for where nothing else can be."""
    for number, (price, error) in enumerate(zip(prices, errors, strict=True), start=1):
        axis.annotate(
            str(number),
            (price, error),
            xytext=(-5, -1),
            textcoords="offset points",
            ha="right",
            va="top",
            fontsize=7,
            zorder=5,
        )
    lines = [f"{i} {m.configuration.short}" for i, m in enumerate(front, start=1)]
    axis.text(
        0.015, 0.015, "\n".join(lines), transform=axis.transAxes, fontsize=6, va="bottom", zorder=5
    )
    if prices:
        left, right = axis.get_xlim()
        axis.set_xlim(min(left, prices[-1] / (right / prices[-1]) ** 0.5, prices[0] / 15), right)


def _some(names: Sequence[str], most: int = 5) -> str:
    return ", ".join(names[:most]) + (", ..." if len(names) > most else "")


def _legend(shown: Sequence[Measurement]) -> list[Line2D]:
    configurations = [m.configuration for m in shown]
    roads = [road for road in ROADS if any(c.road == road for c in configurations)]
    handles = [_key("o", colour, solver) for solver, colour in _colours(shown).items()]
    handles += [_key(_MARKERS[road], "0.3", road) for road in roads]
    if any(c.reduced for c in configurations):
        handles.append(_key("o", "0.3", "reduced to the kept outputs", hollow=True))
    if len({c.model for c in configurations}) > 1:
        handles.append(_key("o", "0.75", "other formulations"))
    handles.append(Line2D([], [], color="black", label="Pareto front"))
    return handles


def _key(marker: str, colour: str, label: str, *, hollow: bool = False) -> Line2D:
    face = "none" if hollow else colour
    return Line2D(
        [], [], marker=marker, color=colour, markerfacecolor=face, linestyle="", label=label
    )


def _colours(shown: Sequence[Measurement]) -> dict[str, str]:
    solvers = dict.fromkeys(m.configuration.solver for m in shown)
    return {name: _COLOURS[i % len(_COLOURS)] for i, name in enumerate(solvers)}
