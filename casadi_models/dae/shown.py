"""What a model says of itself at a prompt and in a notebook."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from html import escape
from typing import TYPE_CHECKING

from casadi_models.dae.variables import Start, Variable

if TYPE_CHECKING:
    from casadi_models.dae.frozen import Dae

_MOST_NAMES = 8  # in one line


def text(dae: Dae) -> str:
    """Return up to nine lines: what it is, and the names of its variables."""
    lines = [f"Dae {dae.full_name}: {dae.description}".rstrip(": ")]
    lines += [f"  {kind:10} {len(own):3}  {_names(own)}" for kind, own in _groups(dae) if own]
    if dae.report:
        lines.append(f"  reduced: {dae.report[0]}" + (", ..." if len(dae.report) > 1 else ""))
    experiment = dae.experiment
    lines.append(f"  runs 0 ... {experiment.stop_time:g} s, every {experiment.output_interval:g} s")
    return "\n".join(lines)


def html(dae: Dae) -> str:
    """Return a table of every variable."""
    return table(f"{dae.full_name}: {dae.description}", _groups(dae))


def table(caption: str, groups: Iterable[tuple[str, Sequence[Variable]]]) -> str:
    """Return a table in HTML of variables by kind."""
    head = "".join(f"<th>{t}</th>" for t in ("kind", "name", "unit", "start", "meaning"))
    rows = "".join(
        "<tr>"
        + "".join(
            f"<td>{escape(cell)}</td>" for cell in (kind, v.name, v.unit, _start(v), v.meaning)
        )
        + "</tr>"
        for kind, own in groups
        for v in own
    )
    return (
        f"<table><caption>{escape(caption)}</caption><thead><tr>{head}</tr></thead>"
        f"<tbody>{rows}</tbody></table>"
    )


def _groups(dae: Dae) -> Iterator[tuple[str, Sequence[Variable]]]:
    yield "states", dae.states
    yield "algebraics", dae.algebraics
    yield "inputs", dae.inputs
    yield "parameters", dae.parameters
    yield "outputs", dae.output_variables


def _names(variables: Sequence[Variable]) -> str:
    more = ", ..." if len(variables) > _MOST_NAMES else ""
    return ", ".join(v.name for v in variables[:_MOST_NAMES]) + more


def _start(variable: Variable) -> str:
    if variable.start is None:
        return "calculated"
    guess = "guess " if variable.start_kind is Start.GUESS else ""
    return f"{guess}{variable.start:g}"
