"""Results as text: aligned tables or JSON on standard output, whole files."""

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cosim.escaping import visible
from cosim.files import write_atomically


def show_table(rows: Sequence[Mapping[str, Any]], *, as_json: bool) -> None:
    """Print rows that have the same keys."""
    if as_json:
        print(json.dumps(rows, indent=1))
        return
    if not rows:
        return
    cells = [[_cell(value) for value in row.values()] for row in rows]
    widths = [max(map(len, column)) for column in zip(rows[0], *cells, strict=True)]
    for line in ([*rows[0]], *cells):
        print(
            "  ".join(text.ljust(width) for text, width in zip(line, widths, strict=True)).rstrip()
        )


def write_text(target: str | None, text: str) -> None:
    """Write a text to a file, whole or not at all, or to standard output."""
    if target:
        write_atomically(Path(target), text.encode())
    else:
        sys.stdout.write(text)


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.3g}"
    return "" if value is None else visible(str(value))
