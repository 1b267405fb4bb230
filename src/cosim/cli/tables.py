"""Results as text: aligned tables or JSON on standard output, whole files."""

import json
import os
import re
import shutil
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cosim.files import write_atomically
from cosim.text.tables import text_table

_COLOURS = {"ok": "32", "DIFFERS": "31", "FAILED": "31"}
_VERDICT = re.compile(rf"(?<= )({'|'.join(_COLOURS)})(?=  |$)", re.MULTILINE)


def show_table(rows: Sequence[Mapping[str, Any]], *, as_json: bool, digits: int = 3) -> None:
    """Print rows that have the same keys; on a terminal no wider than it is, verdicts coloured."""
    if as_json:
        print(json.dumps(rows, indent=1))
    elif rows:
        text = text_table(rows, width=terminal_width(), digits=digits)
        if colours():
            text = _VERDICT.sub(lambda found: f"\x1b[{_COLOURS[found[1]]}m{found[1]}\x1b[0m", text)
        print(text)


def colours() -> bool:
    """Tell whether output may be coloured: to a terminal that can, where nobody objects."""
    wanted = "NO_COLOR" not in os.environ and os.environ.get("TERM", "dumb") != "dumb"
    return wanted and sys.stdout.isatty()


def terminal_width() -> int | None:
    """Return the number of letters in a line of the terminal; None where output is none."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


def write_text(target: str | None, text: str) -> None:
    """Write a text to a file, whole or not at all, or to standard output."""
    if target:
        write_atomically(Path(target), text.encode())
    else:
        sys.stdout.write(text)
