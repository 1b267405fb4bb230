"""Documentation of an FMU: the page `documentation/index.html`, diagram and icon of its model."""

from collections.abc import Container, Mapping, Sequence
from html import escape
from pathlib import Path
from string import Template

import casadi as ca
from casadi import SX

from casadi_models.dae import Dae
from casadi_models.dae.expressions import as_text, operation_count
from cosim.drawing.diagram import diagram, icon
from cosim.drawing.pose import start_pose
from cosim.fmi.export.plan import Plan
from cosim.fmi.export.variables import FmuVariable, Role
from cosim.memo import cached_per_thread
from cosim.text import html_list

LONGEST_FORMULA = 120  # characters of an expression that the page shows
DIAGRAM = "documentation/diagram.png"
ICONS = {2: "model.png", 3: "terminalsAndIcons/icon.png"}


@cached_per_thread(8)
def pictures(dae: Dae, fmi: int) -> Mapping[str, bytes]:
    """Return diagram and icon, at the start values, by their paths; none without shapes."""
    pose = start_pose(dae)
    return {} if pose is None else {DIAGRAM: diagram(pose), ICONS[fmi]: icon(pose)}


@cached_per_thread(8)
def formulas(dae: Dae) -> tuple[tuple[str, str], ...]:
    """Return left and right sides of start rules, dx/dt, algebraic equations and outputs."""
    parameters = frozenset(parameter.name for parameter in dae.parameters)
    found = []
    for rule in dae.start_rules:
        names = ", ".join(dae.states[i].name for i in rule.states)
        text = _text(rule.expression, parameters)
        right = f"solution of 0 = {text}" if rule.implicit else text
        found.append((f"{names} at the start", right))
    every = [f"der({state.name})" for state in dae.states] + ["0"] * len(dae.algebraics)
    every += [output.name for output in dae.output_variables]
    expressions = ca.vertsplit(ca.vertcat(dae.ode, dae.alg, dae.outputs))
    found += zip(every, (_text(one, parameters) for one in expressions), strict=True)
    return tuple(found)


def _text(expression: SX, parameters: Container[str]) -> str:
    """Return an expression as text; a long one as its variables and number of operations."""
    symbols = ca.symvar(expression)
    count = operation_count(ca.Function("f", symbols, [expression]))
    if expression.is_scalar() and count < LONGEST_FORMULA:
        text = as_text(expression)
        if len(text) <= LONGEST_FORMULA and "@" not in text:
            return text
    moving = ", ".join(s.name() for s in symbols if s.name() not in parameters)
    return f"f({moving}{'; ' if moving else ''}parameters), {count} operations"


_HEADINGS = {
    Role.PARAMETER: "Parameters",
    Role.INPUT: "Inputs",
    Role.STATE: "States",
    Role.ALGEBRAIC: "Algebraic unknowns",
    Role.OUTPUT: "Outputs",
}
_FIGURE = """<figure><img src="diagram.png" alt="the mechanism">
<figcaption>At the start values. 1, 2, 3: axes of the bodies' frames. Brown: positive forces and
torques. Purple, two heads: axes of positive rotation (right-hand rule).</figcaption></figure>
"""
_EQUATIONS = """Short equations are written out; f stands for a longer one, with its number of
operations. sources/equations.c computes all of them together."""


def documentation_page(plan: Plan, *, pictured: bool) -> str:
    """Return `documentation/index.html`: description, variables and equations of a model."""
    dae, variables = plan.dae, plan.variables
    page = Template(Path(__file__).with_name("documentation.html").read_text(encoding="utf-8"))
    sections = (
        _section(heading, [v for v in variables if v.role is role])
        for role, heading in _HEADINGS.items()
    )
    return page.substitute(
        name=escape(dae.full_name),
        description=escape(dae.description),
        source=f"Source: {escape(dae.source)}. " if dae.source else "",
        solver=escape(plan.solver),
        tolerance=f"{plan.options.tolerance:g}",
        limits=html_list("The model is valid while", [meaning for _, meaning in dae.limits]),
        diagram=_FIGURE if pictured else "",
        sections="".join(sections),
        equations=html_list(_EQUATIONS, [f"{left} = {right}" for left, right in formulas(dae)]),
        invariants=html_list(
            "The exact solution fulfills", [one.meaning for one in dae.invariants]
        ),
    )


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
