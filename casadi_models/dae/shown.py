"""Variables by kind, as models show them at a prompt and in a notebook."""

from collections.abc import Iterable, Iterator, Sequence
from html import escape

from casadi_models.dae.variables import Start, Variable

_MOST_NAMES = 8  # in one line


Groups = Iterable[tuple[str, Sequence[Variable]]]


def lines(groups: Groups) -> Iterator[str]:
    """Yield a line for each kind: how many variables there are, and their first names."""
    for kind, own in groups:
        if own:
            more = ", ..." if len(own) > _MOST_NAMES else ""
            names = ", ".join(v.name for v in own[:_MOST_NAMES]) + more
            yield f"  {kind:10} {len(own):3}  {names}"


def table(caption: str, groups: Groups) -> str:
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


def _start(variable: Variable) -> str:
    if variable.start is None:
        return "calculated"
    guess = "guess " if variable.start_kind is Start.GUESS else ""
    return f"{guess}{variable.start:g}"
