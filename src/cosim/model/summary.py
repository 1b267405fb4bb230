"""The catalogue in numbers, without building its models: `cosim list` in a fraction of a second."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from casadi_models import CATALOG
from cosim.text.tables import Table

FILE = Path(__file__).with_name("catalogue.json")


def summary() -> list[dict[str, Any]]:
    """Return a row for each model and formulation: its size and its description.

    The rows are recorded; a formulation that is not is built.
    """
    recorded = json.loads(FILE.read_text(encoding="utf-8"))
    return [{"model": name, **(recorded.get(name) or facts_of(name))} for name in CATALOG]


def models() -> Table:
    """Return every model and formulation, the first formulation of a model being its default.

    Example:
        >>> models()[0]["model"], len(models())
        ('crank_shaft/driven', 13)
    """
    return Table(tuple(summary()))


def facts_of(name: str) -> dict[str, Any]:
    """Return the row of a formulation from its model."""
    from cosim.model.catalogue import load  # CasADi takes its time

    dae = load(name)
    return {
        "states": len(dae.states),
        "algebraics": len(dae.algebraics),
        "parameters": len(dae.parameters),
        "outputs": len(dae.output_variables),
        "description": dae.description,
    }


def record(tell: Callable[[str], None] = print) -> None:
    """Write the rows of all formulations: `python -m cosim.model.summary`."""
    rows = {name: facts_of(name) for name in CATALOG}
    FILE.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    tell(f"{FILE}: {len(rows)} formulations")


if __name__ == "__main__":
    record()
