"""Samples over time as a file of numpy, bit for bit."""

import io
import json
import os
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from cosim.arrays import Vector
from cosim.errors import UsageError
from cosim.series.column import Column


def write_npz(
    target: str | os.PathLike[str] | BinaryIO,
    columns: Sequence[Column],
    time: Vector,
    values: Vector,
    facts: Mapping[str, Any],
) -> None:
    """Write samples over time, and what else is known of them.

    Args:
        target: File name, replaced atomically, or an open binary file.
        columns: What is known of each.
        time: s, (n,).
        values: SI, (n, len(columns)).
        facts: What else is kept, as JSON has it.

    Raises:
        ExportError: The file cannot be written.
    """
    told = {**facts, "columns": [asdict(column) for column in columns]}
    content = io.BytesIO()
    np.savez(content, time=time, values=values, facts=json.dumps(told))
    if not isinstance(target, str | os.PathLike):
        target.write(content.getvalue())
        return
    from cosim.files import write_atomically  # only where a file is wanted

    write_atomically(target, content.getvalue())


def read_npz(
    source: str | os.PathLike[str] | BinaryIO,
) -> tuple[tuple[Column, ...], Vector, Vector, dict[str, Any]]:
    """Return columns, time, values and facts of what `write_npz` wrote.

    Raises:
        UsageError: It is no such file.
    """
    try:
        if isinstance(source, str | os.PathLike):
            with Path(source).open("rb") as file:  # numpy leaves a damaged one open
                return read_npz(file)
        with np.load(source, allow_pickle=False) as stored:
            facts = json.loads(str(stored["facts"]))
            columns = tuple(Column(**column) for column in facts.pop("columns"))
            return columns, stored["time"], stored["values"], facts
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise UsageError(f"{source} holds no trajectory: {error}") from error
