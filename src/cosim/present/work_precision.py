"""Figure of a trade-off study: error against cost, on logarithmic axes."""

from collections.abc import Sequence
from typing import Any

import matplotlib
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from cosim.colors import solver_look
from cosim.integrate.solvers import SOLVERS
from cosim.plotting import STYLE, Picture
from cosim.study.pareto import pareto_front
from cosim.study.tradeoff.configuration import Family
from cosim.study.tradeoff.measurement import Measurement
from cosim.study.tradeoff.result import Tradeoff

_GOOD = 1e-6  # error at which solvers are compared, nominal values
_ANSWERS = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12)  # errors for which the figure names the cheapest


def draw_tradeoff(study: Tradeoff) -> Figure:
    """Draw global error against time, one line for each solver, and the Pareto front behind them.

    A solver's line is that of the formulation, backend and reduction that is cheapest at an
    error of 1e-6; if none is so accurate, the most accurate one. It leaves out what costs more and
    is no more accurate. Light points are all other configurations, the gray band is the error of
    the reference. Below the figure are the cheapest configurations for some errors, in words.
    """
    timed = any(m.solver_time for m in study.competing)
    cost, factor = ("solver_time", 1e3) if timed else ("rhs_calls", 1.0)
    best = study.pareto_front(cost)
    with matplotlib.rc_context(STYLE | {"font.size": 11}):
        figure = Picture(figsize=(9.6, 6.4), layout="constrained")
        axis = figure.subplots()
        axis.set_xscale("log")
        axis.set_yscale("log")
        for family, members in _best(study.competing, cost).items():
            color, marker = solver_look(family[3], tuple(SOLVERS))
            at, error = (lambda m: m.cost(cost)), (lambda m: m.error)
            front = pareto_front(members, at, error, study.reference_error)
            axis.plot(
                *_points(study, front, cost, factor),
                marker=marker,
                color=color,
                linewidth=1.4,
                markersize=6,
                label=_family_name(family),
            )
        wide: Any = {"linewidth": 9, "alpha": 0.15, "solid_capstyle": "round", "zorder": 1}
        axis.plot(*_points(study, best, cost, factor), color="black", label="Pareto front", **wide)
        axis.set_xlim(axis.get_xlim())  # of these lines; the other configurations lie to the right
        high = axis.get_ylim()[1]
        others = [m for m in study.competing if m.error is not None and m.cost(cost) is not None]
        points = _points(study, others, cost, factor)
        axis.plot(*points, ".", color="0.8", markersize=3, zorder=0, label="other configurations")
        low, top = study.reference_error / 10, study.reference_error
        axis.axhspan(low, top, color="0.9", zorder=0, label="error of the reference")
        axis.set_ylim(low, high)
        axis.set_xlabel("solver time [ms], median" if timed else "right-hand sides evaluated")
        axis.set_ylabel("largest global error [nominal values]")
        values = f" with {study.provenance['values']}" if "values" in study.provenance else ""
        axis.set_title(f"{study.scene}{values}: error against cost", fontsize=12)
        style: Any = {"fontsize": 9, "title_fontsize": 9}
        figure.legend(loc="outside right upper", title="cheapest variant of each", **style)
        answers = _answers(study, best, cost)
        unseen = [Line2D([], [], linestyle="") for _ in answers]
        style |= {"handlelength": 0, "handletextpad": 0, "ncols": 2}
        title = "cheapest configuration for an error of at most"
        figure.legend(unseen, answers, loc="outside lower left", title=title, **style)
    return figure


def _answers(study: Tradeoff, best: Sequence[Measurement], cost: str) -> list[str]:
    """Return which configuration of the Pareto front is cheapest for some errors, in words."""
    answers = []
    for wanted in _ANSWERS:
        good = [m for m in best if study.shown_error(m) <= wanted]
        if good and wanted >= study.reference_error:
            m = min(good, key=lambda m: m.cost(cost) or 0.0)
            price = m.cost(cost) or 0.0
            spent = f"{1e3 * price:.2g} ms" if cost == "solver_time" else f"{price:g} calls"
            name, _, rest = _family_name(m.configuration.family).partition(", ")
            answers.append(f"{wanted:.0e}: {name} at {m.configuration.setting}, {spent} ({rest})")
    return answers


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


def _family_name(family: Family) -> str:
    model, reduced, backend, solver, control = family
    parts = (solver, model.partition("/")[2], backend, "reduced" if reduced else "", control or "")
    return ", ".join(filter(None, parts))


def _points(
    study: Tradeoff, shown: Sequence[Measurement], cost: str, factor: float
) -> tuple[list[float], list[float]]:
    """Return costs and errors of measurements."""
    return [factor * (m.cost(cost) or 0.0) for m in shown], [study.shown_error(m) for m in shown]
