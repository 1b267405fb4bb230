"""Results as text: aligned tables or JSON on standard output, whole files; and as figures."""

import argparse
import os
import re
import shutil
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cosim.files import write_atomically
from cosim.presenters import presenter
from cosim.text import json_text, text_table

_COLORS = {"ok": "32", "DIFFERS": "31", "FAILED": "31"}
_VERDICT = re.compile(rf"(?<= )({'|'.join(_COLORS)})(?=  |$)", re.MULTILINE)


def show_table(
    rows: Sequence[Mapping[str, Any]], *, as_json: bool = False, digits: int = 3
) -> None:
    """Print rows that have the same keys; a terminal gets lines that fit, and colored verdicts."""
    if as_json:
        print(json_text(rows, indent=1))
    elif rows:
        text = text_table(rows, width=terminal_width(), digits=digits)
        if colors():
            text = _VERDICT.sub(lambda found: f"\x1b[{_COLORS[found[1]]}m{found[1]}\x1b[0m", text)
        print(text)


def note(args: argparse.Namespace, *lines: object) -> None:
    """Print lines to standard error, unless the command line says --quiet."""
    if lines and not args.quiet:
        print(*lines, sep="\n", file=sys.stderr, flush=True)


def draw(args: argparse.Namespace, kind: str, result: object) -> None:
    """Draw a result to the file of --figure, if there is one; `kind` is a name of a presenter."""
    if args.figure:
        from cosim.plotting import save  # loads matplotlib

        save([presenter(kind)(result)], args.figure)


def report_files(args: argparse.Namespace, *paths: object, **facts: Any) -> None:
    """Name the files that were written: as a note, or with further facts as JSON."""
    if args.json:
        print(json_text({"files": [str(path) for path in paths], **facts}))
    else:
        note(args, *paths)


def colors() -> bool:
    """Return whether to color output: a terminal supports it and NO_COLOR is not set."""
    allowed = "NO_COLOR" not in os.environ and os.environ.get("TERM", "dumb") != "dumb"
    return allowed and sys.stdout.isatty()


def terminal_width() -> int | None:
    """Return the number of characters in a line of the terminal; None if output goes elsewhere."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


def write_text(target: str | None, text: str) -> None:
    """Write a text to a file, completely or not at all, or to standard output."""
    if target:
        write_atomically(Path(target), text.encode())
    else:
        sys.stdout.write(text)
