"""Report: one page that documents a run, from the equations to the figures."""

import hashlib
import html
import platform
import re
from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import version
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

import casadi_models
from casadi_models.dae import Dae, Start, Variable
from casadi_models.printed import PRINTED
from casadi_models.units import convert
from cosim.drawing.diagram import diagram
from cosim.drawing.picture import draw_pose
from cosim.drawing.pose import start_pose
from cosim.errors import CosimError, MissingTool
from cosim.model.reduction import size
from cosim.model.values import plain_values
from cosim.plotting import picture
from cosim.present.figures import draw_figures
from cosim.present.formulas import MOST_FORMULAS, formulas, linear_formulas
from cosim.present.playback.page import page as playback_page
from cosim.present.playback.playback import playback
from cosim.scene.scene import Scene, run_settings
from cosim.study.linearize.linearization import Linearization
from cosim.study.linearize.linearize import linearize
from cosim.text import counted, html_list, html_table, moment, violations_in
from cosim.trajectory import Trajectory

_FEW = 20  # lines that are not folded
_CSS = "\n" + Path(__file__).with_name("report.css").read_text(encoding="utf-8")


@dataclass(frozen=True)
class ReportContents:
    """Content of a report.

    Attributes:
        scene: The scene: model and values.
        dae: The model as it ran, reduced to the outputs of the scene.
        run: The result.
        shown: The same run with all variables that place the bodies, for pictures.
        checks: Rows of a crosscheck; empty if none was made.
        command: The command that reproduces the page.
    """

    scene: Scene
    dae: Dae
    run: Trajectory
    shown: Trajectory | None
    checks: Sequence[Mapping[str, Any]]
    command: str


def report(contents: ReportContents) -> str:
    """Return the page as HTML: one file that needs no network and can be printed."""
    c = contents
    title = c.scene.title or c.dae.description or c.run.model
    parts = [f"<h1>{html.escape(title)}</h1>", _validity(c.run), *_system(c), *_bodies(c)]
    parts += [*_numbers_section(c), *_printed(c), *_figures(c), *_trust(c), *_origin_section(c)]
    body, numbers = "\n".join(parts), count()
    titles = re.findall(r"<h2>(.*?)</h2>", body)
    links = " | ".join(f'<a href="#{i}">{name}</a>' for i, name in enumerate(titles))
    body = re.sub("<h2>", lambda _: f'<h2 id="{next(numbers)}">', body)
    body = body.replace("</h1>", f"</h1>\n<nav>{links}</nav>", 1)
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{html.escape(title)}</title><style>{_CSS}</style></head>\n<body>\n{body}\n</body></html>\n"
    )


def _validity(run: Trajectory) -> str:
    start, reasons = run.validity
    if not reasons:
        return ""
    times = {i: moment(time) for i, time, *_ in violations_in(run.stats.get("invalid", ()))}
    since = {i: f" (from {time} s)" for i, time in times.items() if time != moment(start)}
    why = html.escape("; ".join(reason + since.get(i, "") for i, reason in enumerate(reasons)))
    return f'<p class="invalid">invalid from {moment(start)} s: {why}</p>'


def _system(c: ReportContents) -> Iterable[str]:
    yield "<h2>The system</h2>"
    facts = {"model": c.dae.full_name, "source": c.dae.source}
    if c.scene.title:  # otherwise the description is the title of the page
        facts["description"] = c.dae.description
    counts = size(c.dae)
    facts["equations"] = (
        f"{counts.states} differential, {counts.algebraics} algebraic; {counts.operations} scalar "
        f"operations with {counted(counts.outputs, 'output')}"
    )
    facts["states"] = ", ".join(v.name for v in c.dae.states)
    facts["algebraic unknowns"] = ", ".join(v.name for v in c.dae.algebraics)
    yield _facts_table(facts)
    if pose := start_pose(c.dae):
        content = b64encode(diagram(pose)).decode()
        yield f'<img alt="frames and positive directions" src="data:image/png;base64,{content}"/>'
    if c.dae.full_name in casadi_models.CATALOG:
        yield from _paragraphs(import_module(f"casadi_models.{c.dae.name}").__doc__ or "")
    yield from _equations(c)
    yield html_list("The model is valid while", (meaning for _, meaning in c.dae.limits))
    yield html_list("Reduced to the outputs of the scene:", c.dae.report)


def _prose(text: str) -> str:
    """Return a text of a docstring as HTML: names between backticks are code."""
    return re.sub("`([^`]+)`", r"<code>\1</code>", html.escape(text))


def _paragraphs(docstring: str) -> Iterable[str]:
    """Yield the text of a system's module; a list and fields, `NAME  text`, line by line."""
    for paragraph in docstring.split("\n\n"):
        if paragraph.startswith("   "):
            continue  # a sketch in letters: the diagram shows it
        for item in re.split(r"\n(?=(?:  )?\w+  )", paragraph):
            if field := re.fullmatch(r"\s*(\w+)  +(.+)", item, re.DOTALL):
                yield f"<p><b>{html.escape(field[1])}</b>: {_prose(field[2])}</p>"
            else:
                yield f"<p>{_prose(item)}</p>"


def _equations(c: ReportContents) -> Iterable[str]:
    """Yield the equations, and the linear ones of those that are too large to be printed."""
    found = formulas(c.dae)
    linear = _linear_system(c) if 0 < len(found.large) <= MOST_FORMULAS else None
    yield "<h3>Equations</h3>"
    yield _block(found.equations)
    if found.outputs:
        yield "<h3>Outputs and validity conditions</h3>"
        yield _block(found.outputs)
    if found.events:
        yield "<h3>Events: conditions and new values</h3>"
        yield _block(found.events)
    if linear:
        point = html.escape(linear.point)
        yield "<h3>Linear equations</h3>"
        yield f"<p>Near {point}. Δ is the deviation from there; all numbers are in SI units.</p>"
        yield _block(linear_formulas(c.dae, linear, found.large))
    if found.named:
        opened = " open" if len(found.named) <= _FEW else ""
        yield f"<details{opened}><summary>Parts c<sub>i</sub> of the formulas</summary>"
        yield f"{_block(found.named)}</details>"


def _block(lines: Iterable[str]) -> str:
    return f"<div class='formulas'>{''.join(lines)}</div>"


def _linear_system(c: ReportContents) -> Linearization | None:
    """Return the linear system at an equilibrium near the start, else at the start."""
    names, request = {variable.name for variable in c.dae.variables}, c.scene.request
    values = {name: value for name, value in request.values.items() if name in names}
    inputs, begin = request.inputs and request.inputs.only(names), request.times.start
    for point in ("equilibrium", "start"):
        with suppress(CosimError):
            linear = linearize(
                c.dae, at=point, start_values=values, inputs=inputs, start_time=begin
            )
            return None if linear.period else linear
    return None


def _bodies(c: ReportContents) -> Iterable[str]:
    if c.shown is None or not c.shown.drawing:
        return
    yield "<h2>In motion</h2>"
    still = playback(c.shown, c.shown.drawing, times=[float(c.shown.time[0])])
    start = _svg(draw_pose([still], [0], follow=""), "At the start; lines are the paths of points.")
    try:
        played = playback(c.shown, c.shown.drawing)
        page = html.escape(playback_page([played], [c.shown]), quote=True)
        yield f'<iframe class="screen" title="playback" srcdoc="{page}"></iframe>'
        yield f'<div class="paper">{start}</div>'
    except MissingTool as error:
        yield f'{start}<p class="note">Without playback: {html.escape(str(error))}</p>'


def _numbers_section(c: ReportContents) -> Iterable[str]:
    yield "<h2>Numbers</h2>"
    values = plain_values(c.scene.dae, c.scene.request.values)
    for caption, variables in (
        ("Start values", c.dae.states),
        ("Parameters", c.dae.parameters),
        ("Inputs", c.dae.inputs),
    ):
        if rows := [_parameter_row(v, c, values) for v in variables]:
            yield html_table(rows, caption)
    settings = run_settings(c.scene.request)
    yield _facts_table({key.replace("_", " "): value for key, value in settings.items()})


def _parameter_row(
    variable: Variable, c: ReportContents, values: Mapping[str, float]
) -> dict[str, Any]:
    series = c.scene.request.inputs
    follows = series is not None and variable.name in series.names
    value = None if follows else values.get(variable.name, variable.start)
    calculated = variable.start_kind is Start.CALCULATED
    if calculated and variable.name in c.run.names and len(c.run):
        value = float(c.run[variable.name][0])
        if abs(value) <= 1e-12 * variable.nominal:
            value = 0.0  # rounding of the calculation
    shown = variable.display_unit or variable.unit
    return {
        "name": variable.name,
        "value": "" if value is None else f"{convert(value, variable.unit, shown):.8g}",
        "unit": shown,
        "meaning": variable.meaning + " (calculated)" * calculated + " (a time series)" * follows,
    }


def _printed(c: ReportContents) -> Iterable[str]:
    if rows := list(printed_rows(c.scene, c.run)):
        yield "<h2>The book's numbers and the run's</h2>"
        yield html_table(rows, "Last column: whether the difference exceeds the book's rounding")


def printed_rows(scene: Scene, run: Trajectory) -> Iterable[dict[str, Any]]:
    """Yield the book's printed numbers and the run's, if the run has the book's values."""
    dae = scene.dae
    changed = any(
        value != next(v.start for v in dae.variables if v.name == name)
        for name, value in scene.request.values.items()
    )
    if dae.full_name not in casadi_models.CATALOG or changed or scene.request.inputs is not None:
        return
    for number in PRINTED.get(dae.name, ()):
        if number.variable not in run.names or not len(run):
            continue
        i = int(np.argmin(np.abs(run.time - number.time)))
        if abs(run.time[i] - number.time) > 1e-9:
            continue
        own = float(run[number.variable][i])
        value = convert(own, run.column(number.variable).unit, number.unit)
        gap = abs(value - float(number.value))
        yield {
            "variable": number.variable,
            "time": f"{number.time:g} s",
            "book": number.value,
            "run": f"{value:.8g}",
            "unit": number.unit,
            "differs": "no" if gap <= 1.02 * number.rounding else f"yes, by {gap:.1e}",
        }


def _figures(c: ReportContents) -> Iterable[str]:
    yield "<h2>Figures</h2>"
    if c.scene.figures:
        figures = draw_figures(c.scene.figures, c.run)
    else:
        names = c.run.names
        figures = [c.run.plot(names[i : i + 12]) for i in range(0, len(names), 12)]
    yield from (_svg(figure, "") for figure in figures)


def _trust(c: ReportContents) -> Iterable[str]:
    yield "<h2>Accuracy</h2>"
    stats = c.run.stats
    if "error_estimate" in stats:
        yield (
            f"<p>Estimated global error: {stats['error_estimate']:.1e} nominal values, from a "
            "second run by another method or tolerance.</p>"
        )
    else:
        yield "<p>No error was estimated; add <code>--accuracy</code> for an estimate.</p>"
    if c.checks:
        yield html_table(
            [*map(dict, c.checks)], "The same run on every backend and in every formulation"
        )


def _origin_section(c: ReportContents) -> Iterable[str]:
    table = np.column_stack((c.run.time, c.run.values))
    stats = c.run.stats
    facts = {
        "command": c.command,
        "solver": f"{stats.get('solver', '')}, {stats.get('steps', '?')} steps",
        "compiled": "yes" if stats.get("compiled") else "no",
        "result (SHA-256)": hashlib.sha256(table.tobytes()).hexdigest(),
        "versions": ", ".join(
            f"{name} {version(name)}" for name in ("cosim-rigid", "casadi", "fmpy", "numpy")
        ),
        "Python": f"{platform.python_version()} on {platform.system()} {platform.machine()}",
    }
    yield "<h2>Reproduction</h2>"
    yield _facts_table(facts)


def _facts_table(facts: Mapping[str, Any]) -> str:
    shown = [(html.escape(key), html.escape(str(value))) for key, value in facts.items() if value]
    rows = "".join(f"<tr><th>{key}</th><td>{value}</td></tr>" for key, value in shown)
    return f"<table>{rows}</table>"


def _svg(figure: Figure, caption: str) -> str:
    drawing = picture(figure, "svg").decode()
    drawing = drawing[drawing.index("<svg") :]
    return f"<figure>{drawing}<figcaption class='note'>{html.escape(caption)}</figcaption></figure>"
