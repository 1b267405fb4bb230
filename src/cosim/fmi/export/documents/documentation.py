"""The page about the model inside the FMU."""

from collections.abc import Sequence
from html import escape
from pathlib import PurePosixPath

from casadi_models.dae import Dae
from cosim.fmi.export.documents.formulas import formulas
from cosim.fmi.export.variables import FmuVariable, Role

_HEADINGS = {
    Role.PARAMETER: "Parameters",
    Role.INPUT: "Inputs",
    Role.STATE: "States",
    Role.ALGEBRAIC: "Algebraic unknowns",
    Role.OUTPUT: "Outputs",
}


def documentation_page(
    dae: Dae,
    variables: Sequence[FmuVariable],
    solver: str,
    tolerance: float,
    picture: str | None = None,
) -> str:
    """Return `documentation/index.html`: what the model is, every variable, the equations.

    Args:
        dae: The model.
        variables: Those of the FMU.
        solver, tolerance: Of co-simulation, and relative.
        picture: Path of the model's diagram in the FMU, beside this page.
    """
    sections = "".join(
        _section(heading, [v for v in variables if v.role is role])
        for role, heading in _HEADINGS.items()
    )
    return f"""<!DOCTYPE html>
<html lang="en">
<head><meta charset="utf-8"><title>{escape(dae.full_name)}</title>
<style>body {{ font-family: sans-serif; margin: 2em }} td, th {{ padding: 0.1em 1em 0.1em 0;
text-align: left }} td.number {{ text-align: right }}</style></head>
<body>
<h1>{escape(dae.full_name)}</h1>
<p>{escape(dae.description)}</p>
<p>Source: {escape(dae.source)}. All values are in SI units.</p>
<p>Co-simulation integrates with {escape(solver)}; the recommended relative tolerance is
{tolerance:g}.</p>
{_limits(dae)}{_diagram(picture)}{sections}{_equations(dae)}</body>
</html>
"""


def _limits(dae: Dae) -> str:
    if not dae.limits:
        return ""
    rows = "".join(f"<li>{escape(meaning)}</li>\n" for _, meaning in dae.limits)
    return f"<p>The model holds while</p>\n<ul>\n{rows}</ul>\n"


def _diagram(picture: str | None) -> str:
    if picture is None:
        return ""
    return f"""<figure><img src="{PurePosixPath(picture).name}" alt="the mechanism">
<figcaption>At the start values. 1, 2, 3: axes of the bodies' frames. Brown: what counts as a
positive force or torque. Purple, two heads: the axis of a positive turn, by the right
hand.</figcaption></figure>
"""


def _equations(dae: Dae) -> str:
    rows = "".join(f"<li>{escape(left)} = {escape(right)}</li>\n" for left, right in formulas(dae))
    drift = "".join(f"<li>{escape(i.meaning)}</li>\n" for i in dae.invariants)
    kept = f"<p>What exact solutions keep to:</p>\n<ul>\n{drift}</ul>\n" if drift else ""
    return f"""<h2>Equations</h2>
<p>Those that are short are written out; f stands for others, with what it takes to compute each
alone. sources/equations.c computes all of them together.</p>
<ul>
{rows}</ul>
{kept}"""


def _section(heading: str, variables: Sequence[FmuVariable]) -> str:
    if not variables:
        return ""
    rows = "".join(
        f"<tr><td>{escape(v.name)}</td><td class='number'>"
        f"{'' if v.start is None else format(v.start, '.10g')}</td>"
        f"<td>{escape(v.unit)}</td><td>{escape(v.meaning)}</td></tr>\n"
        for v in variables
    )
    head = "<tr><th>name</th><th>start</th><th>unit</th><th>meaning</th></tr>\n"
    return f"<h2>{heading}</h2>\n<table>\n{head}{rows}</table>\n"
