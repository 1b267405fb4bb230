"""Figures of studies: eigenvalues, sensitivities, extreme cases, error against cost."""

import re
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from casadi_models.extreme_cases import Case
from cosim.colors import CURVES, MARKERS, solver_look
from cosim.colors import OUTCOMES as OUTCOME_COLORS
from cosim.integrate.solvers import SOLVERS
from cosim.plotting import LINES, STYLE, Picture
from cosim.study.extremes.oracles import OUTCOMES, CaseFinding
from cosim.study.linearize.along import EigenvalueSweep
from cosim.study.pareto import pareto_front
from cosim.study.sensitivity.result import Sensitivity
from cosim.study.tradeoff.configuration import Family
from cosim.study.tradeoff.measurement import LEFT_OUT, Measurement
from cosim.study.tradeoff.result import Tradeoff
from cosim.text import Table, axis_label, with_unit

_NOTHING = 1e-9  # parts of eigenvalues below this share of the largest count as zero
_CLOSE = 0.2  # share of the axis; texts of crossings with less between them stand higher in turn


def draw_eigenvalues(sweep: EigenvalueSweep) -> Figure:
    """Draw eigenvalues over a parameter, shade where all are stable, and name the crossings."""
    size = float(abs(sweep.eigenvalues).max()) or 1.0
    is_map = sweep.period is not None  # stable where the size of each eigenvalue is below 1
    table = abs(sweep.eigenvalues) if is_map else sweep.eigenvalues
    looks: dict[str, dict[str, Any]] = {}
    with matplotlib.rc_context(STYLE):
        figure = Picture(figsize=(7.0, 4.8), layout="constrained")
        axis = figure.subplots()
        for j, (column, mode) in enumerate(zip(table.T, sweep.modes, strict=True)):
            if abs(column).max() <= _NOTHING * size:
                continue
            i, label = len(looks), None if mode in looks else mode or None
            color, marker = CURVES[i % len(CURVES)], MARKERS[i % len(MARKERS)]
            new = {"color": color, "marker": marker, "markevery": 0.1, "markersize": 4}
            look = looks.setdefault(mode or f"column {j}", new)
            axis.plot(sweep.values, column.real, label=label, **look)
            if abs(column.imag).max() > _NOTHING * size:
                axis.plot(sweep.values, abs(column.imag), "--", **look)
        axis.plot([], [], color="0.3", label="size" if is_map else "real part")
        if not is_map:
            axis.plot([], [], "--", color="0.3", label="imaginary part")
        axis.axhline(float(is_map), color="black", linewidth=0.6)
        stable = sweep.is_stable
        band: Any = {"transform": axis.get_xaxis_transform(), "color": "0.9", "zorder": 0}
        axis.fill_between(sweep.values, 0, 1, where=stable, label="stable", **band)
        axis.margins(x=0)
        axis.set(
            xlabel=axis_label(sweep.name, sweep.unit),
            ylabel="eigenvalue of one period" if is_map else "eigenvalue [1/s]",
        )
        close, labels, previous, higher = _CLOSE * float(np.ptp(sweep.values)), [], -np.inf, False
        for crossing in sweep.crossings:
            axis.axvline(crossing.value, color="0.5", linewidth=0.8)
            higher = crossing.value - previous < close and not higher
            outputs = [
                f"{n} {with_unit(v, sweep.units[n], 4)}" for n, v in crossing.outputs.items()
            ][:1]
            lines = [crossing.mode, with_unit(crossing.value, sweep.unit, 4), *outputs]
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
        everyone = [finding.outcome for finding in findings]
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
    with suppress(ValueError):  # of texts that are no numbers
        points.sort(key=float)
    for finding, (row, point) in zip(findings, places, strict=True):
        x, y, outcome = points.index(point), rows.index(row), finding.outcome
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
    values = [_Extreme.of(case) for case in cases]
    several = len({case.model.partition("/")[0] for case in cases}) > 1
    runners = list[str]()
    for case in cases:
        model = case.model if several else case.model.rpartition("/")[2]
        runners.append(f"{model}, {case.solver}" if case.solver else model)
    parameters_of: dict[str, set[str]] = {}
    for runner, value in zip(runners, values, strict=True):
        parameters_of.setdefault(runner, set()).add(value.parameter)
    units = {value.unit for value in values} - {""}
    places = list[tuple[str, str]]()
    for runner, value in zip(runners, values, strict=True):
        row = f"{runner}, {value.parameter}" if len(parameters_of[runner]) > 1 else runner
        places.append((row, value.number + value.unit if len(units) > 1 else value.number))
    parameters = {value.parameter for value in values} - {""}
    label = [*parameters] if len(parameters) == 1 else []
    if values[0].is_factor:
        label.append("factor")
    if len(units) == 1:
        label.append(f"[{units.pop().strip()}]")
    return " ".join(label), places


class _Extreme(NamedTuple):
    """The extreme value in the name of a case; a name without a number is all text."""

    parameter: str
    is_factor: bool
    number: str
    unit: str

    @classmethod
    def of(cls, case: Case) -> "_Extreme":
        """Read the name of a case; powers of ten lose their zeros."""
        name = case.name.removesuffix(f", {case.solver}")
        found = _VALUE.fullmatch(name)
        parameter, separator, number, unit = found.groups("") if found else ("", "", name, "")
        short = re.sub(r"e\+?(-?)0+(?=\d)", r"e\1", number)
        return cls(parameter, separator == " x ", short, unit)


_DIVERGED = 10.0  # error of a co-simulation in nominal values
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
        figure.legend(loc="outside right upper", title="best variant of each solver", **style)
        answers = _answers(study, best, cost)
        unseen = [Line2D([], [], linestyle="") for _ in answers]
        style |= {"handlelength": 0, "handletextpad": 0, "ncols": 2}
        title = "cheapest configuration for an error of at most"
        figure.legend(unseen, answers, loc="outside lower left", title=title, **style)
    return figure


def draw_methods(study: Table) -> Figure:
    """Draw the error of co-simulation against the macro step, one line for each method.

    Dotted lines have the slope of an order. A cross at the top is a run that has diverged.
    """
    with matplotlib.rc_context(STYLE):
        figure = Picture(figsize=(7.0, 4.8), layout="constrained")
        axis = figure.subplots()
        done = [row["error"] for row in study if row["error"] and row["error"] < _DIVERGED]
        low, high = min(done, default=1e-9) / 3, _DIVERGED
        for i, method in enumerate(dict.fromkeys(row["method"] for row in study)):
            rows = [row for row in study if row["method"] == method and row["error"] != 0]
            look: Any = {"color": CURVES[i % len(CURVES)], "marker": MARKERS[i % len(MARKERS)]}
            good = [row for row in rows if row["error"] and row["error"] < _DIVERGED]
            points = [1e3 * row["step"] for row in good], [row["error"] for row in good]
            axis.loglog(*points, label=method.replace("_", "-"), markersize=4, **look)
            bad = [r for r in rows if r not in good and not r["status"].startswith(LEFT_OUT)]
            gone = [1e3 * row["step"] for row in bad]
            if gone:
                axis.plot(gone, [high * 0.6**i] * len(gone), "x", color=look["color"])
        steps = np.array(sorted({1e3 * row["step"] for row in study}))
        for order in (1, 2, 3, 4):
            line = high * (steps / steps[-1]) ** order
            axis.loglog(steps, line, ":", color="0.6", linewidth=1, zorder=0)
            shown = next((i for i in range(len(steps)) if line[i] > 2 * low), 0)
            place = steps[shown], 1.2 * line[shown]
            axis.annotate(f"order {order}", place, color="0.4", fontsize=8)
        axis.plot([], [], "x", color="0.3", label="diverged")
        axis.set(xlabel="macro step [ms]", ylabel="largest error of an output [nominal values]")
        axis.set_ylim(low, 1.5 * high)
        axis.set_title(study.caption.partition(":")[0])
        figure.legend(loc="outside lower center", ncols=5)
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
