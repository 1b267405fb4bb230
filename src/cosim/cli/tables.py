"""Results as text: aligned tables or JSON on standard output, whole files."""

import json
import shutil
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cosim.files import write_atomically
from cosim.tables import text_table


def show_table(rows: Sequence[Mapping[str, Any]], *, as_json: bool) -> None:
    """Print rows that have the same keys; on a terminal no wider than it is."""
    if as_json:
        print(json.dumps(rows, indent=1))
    elif rows:
        print(text_table(rows, width=terminal_width()))


def terminal_width() -> int | None:
    """Return the number of letters in a line of the terminal; None where output is none."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


def write_text(target: str | None, text: str) -> None:
    """Write a text to a file, whole or not at all, or to standard output."""
    if target:
        write_atomically(Path(target), text.encode())
    else:
        sys.stdout.write(text)
