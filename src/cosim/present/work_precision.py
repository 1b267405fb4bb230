"""Figures of a trade-off study: error and drift against cost, on logarithmic axes."""

from collections.abc import Callable, Sequence
from itertools import groupby
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from cosim.backend import Backend
from cosim.colors import solver_look
from cosim.integrate.solvers import SOLVERS
from cosim.plotting import STYLE, Picture
from cosim.study.tradeoff.configuration import Family
from cosim.study.tradeoff.measurement import Measurement
from cosim.study.tradeoff.result import Tradeoff
from cosim.text import shortened

_BACKEND_MARKERS = dict(zip(Backend, "osD^", strict=True))
_MILLISECONDS = 1e3
_SMALLEST = 1e-17  # shown instead of zero, which has no logarithm


def draw_tradeoff(study: Tradeoff) -> Figure:
    """Draw global error against right-hand sides and against time, and drift against time.

    One marker per configuration: color for solver, shape for backend, filled for the full and
    hollow for the reduced model, faint for all formulations but the first. The black line is the
    Pareto front; the names of its parts are below it, where no point can be. The gray band is the
    error of the reference. Runs with steps longer than the output interval are left out.
    """
    shown = study.competing
    with matplotlib.rc_context(STYLE):
        panels = 3 if any(m.drift for m in shown) else 2
        figure = Picture(figsize=(6.4 * panels, 7.4), layout="constrained")
        axes = figure.subplots(1, panels, width_ratios=(1.2, 1.2, 0.8)[:panels])
        _errors(axes[0], study, shown, "rhs_calls", 1.0)
        axes[0].set_xlabel("right-hand sides evaluated")
        _errors(axes[1], study, shown, "solver_time", _MILLISECONDS)
        axes[1].set_xlabel("solver time [ms]: median; on the Pareto front also fastest to slowest")
        if panels == 3:
            _scatter(axes[2], shown, "solver_time", _MILLISECONDS, lambda m: m.drift)
            axes[2].set_xlabel("solver time [ms], median")
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
    best = study.pareto_front(cost)
    prices, errors = _points(study, best, cost, factor)
    axis.plot(prices, errors, color="black", linewidth=1.1, zorder=4)
    if cost == "solver_time":
        for measurement, error in zip(best, errors, strict=True):
            if (time := measurement.solver_time) is not None:
                ends = (factor * time.fastest, factor * time.slowest)
                axis.plot(ends, (error, error), color="0.4", linewidth=0.6, zorder=1)
    _shade_reference_error(axis, study, 30)
    _name_parts(axis, _write_numbers(axis, best, prices, errors), loc="lower left", fontsize=7)
    reference = study.reference
    axis.set_title(
        f"gray: error of the reference, {study.reference_error:.0e} "
        f"({reference.method} against {reference.check})",
        fontsize=8,
    )
    axis.set_ylabel("largest global error of the selected outputs [nominal values]")


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
        color, _ = _look(configuration.solver)
        axis.plot(
            *point,
            _BACKEND_MARKERS[configuration.backend],
            color=color,
            markerfacecolor="none" if configuration.reduced else color,
            markersize=4.5,
            alpha=0.9 if configuration.model == first else 0.3,
            markeredgewidth=0.9,
        )
    for (model, _, _, solver, _), points in families.items():
        along = sorted(points, key=lambda point: -point[1])
        alpha = 0.5 if model == first else 0.2
        color, _ = _look(solver)
        axis.plot(*zip(*along, strict=True), color=color, linewidth=0.6, alpha=alpha)
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.grid(True)


def _look(solver: str) -> tuple[str, str]:
    """Return color and marker of a solver."""
    return solver_look(solver, tuple(SOLVERS))


def _legend(shown: Sequence[Measurement]) -> list[Line2D]:
    configurations = [m.configuration for m in shown]
    backends = [backend for backend in Backend if any(c.backend == backend for c in configurations)]
    used = {c.solver: None for c in configurations}
    others_last = [n for n in SOLVERS if n in used] + [n for n in used if n not in SOLVERS]
    handles = [_legend_entry("o", _look(name)[0], name) for name in others_last]
    handles += [_legend_entry(_BACKEND_MARKERS[backend], "0.3", backend) for backend in backends]
    if any(c.reduced for c in configurations):
        handles.append(_legend_entry("o", "0.3", "reduced to the selected outputs", hollow=True))
    first, *others = dict.fromkeys(c.model for c in configurations)
    if others:
        formulations = ", ".join(name.partition("/")[2] for name in others)
        handles.append(_legend_entry("o", "0.3", first))
        handles.append(_legend_entry("o", "0.8", f"faint: {formulations}"))
    handles.append(Line2D([], [], color="black", label="Pareto front"))
    return handles


def _legend_entry(marker: str, color: str, label: str, *, hollow: bool = False) -> Line2D:
    face = "none" if hollow else color
    return Line2D(
        [], [], marker=marker, color=color, markerfacecolor=face, linestyle="", label=label
    )


_MOST_NAMES = 10  # of parts of the Pareto front
_GOOD = 1e-6  # error at which solvers are compared, nominal values


def draw_pareto_front(study: Tradeoff) -> Figure:
    """Draw global error against time: the Pareto front in black, and one line for each solver.

    A solver's line is that of the formulation, backend and reduction that is cheapest at an
    error of 1e-6; if none is so accurate, the most accurate one. The names of the numbers are in
    the legend at the right.
    """
    timed = any(m.solver_time for m in study.competing)
    cost, factor = ("solver_time", 1e3) if timed else ("rhs_calls", 1.0)
    best = study.pareto_front(cost)
    with matplotlib.rc_context(STYLE | {"font.size": 11}):
        figure = Picture(figsize=(11.0, 5.8), layout="constrained")
        axis = figure.subplots()
        axis.set_xscale("log")
        axis.set_yscale("log")
        for family, members in _best(study.competing, cost).items():
            members = sorted(members, key=lambda m: -study.shown_error(m))
            color, marker = _look(family[3])
            axis.plot(
                *_points(study, members, cost, factor),
                marker=marker,
                color=color,
                linewidth=1.2,
                markersize=6,
                label=_family_name(family),
            )
        prices, errors = _points(study, best, cost, factor)
        axis.plot(prices, errors, color="black", linewidth=2.4, label="Pareto front", zorder=4)
        notes = _write_numbers(axis, best, prices, errors)
        _shade_reference_error(axis, study, 10)
        axis.set_xlabel("solver time [ms], median" if timed else "right-hand sides evaluated")
        axis.set_ylabel("largest global error [nominal values]")
        axis.set_title(f"{study.scene}: error against cost", fontsize=12)
        style: Any = {"fontsize": 9, "title_fontsize": 9}
        figure.legend(loc="outside right upper", title="cheapest variant of each", **style)
        _name_parts(figure, notes, loc="outside right lower", fontsize=9)
    return figure


def _best(shown: Sequence[Measurement], cost: str) -> dict[Family, list[Measurement]]:
    """Return the family of each solver that is cheapest at a good error, or else most accurate."""
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
    axis: Axes, best: Sequence[Measurement], prices: Sequence[float], errors: Sequence[float]
) -> list[str]:
    """Number the parts of the Pareto front, each of one family; return their names."""
    points = list(zip(best, prices, errors, strict=True))
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


def _name_parts(owner: Axes | Figure, names: Sequence[str], **style: Any) -> None:
    """Add a legend with the names of the numbered parts of the Pareto front."""
    unseen = [Line2D([], [], linestyle="") for _ in names]
    style |= {"handlelength": 0, "handletextpad": 0, "title_fontsize": style["fontsize"]}
    owner.legend(unseen, names, title="on the Pareto front", **style)


def _family_name(family: Family) -> str:
    model, reduced, backend, solver, control = family
    parts = (solver, model.partition("/")[2], backend, "reduced" if reduced else "", control or "")
    return ", ".join(filter(None, parts))


def _points(
    study: Tradeoff, shown: Sequence[Measurement], cost: str, factor: float
) -> tuple[list[float], list[float]]:
    """Return costs and errors of measurements."""
    return [factor * (m.cost(cost) or 0.0) for m in shown], [study.shown_error(m) for m in shown]


def _shade_reference_error(axis: Axes, study: Tradeoff, below: float) -> None:
    """Shade errors up to that of the reference, on an axis that goes further by a factor."""
    low, high = axis.get_ylim()
    low = min(low, study.reference_error / below)
    axis.axhspan(low, study.reference_error, color="0.9", zorder=0)
    axis.set_ylim(low, high)
