"""MATLAB files (version 5) of samples over time."""

import io
import os
import re
from collections.abc import Sequence
from typing import Any

from cosim.arrays import Vector
from cosim.host.optional_packages import optional_module
from cosim.series.samples import Column

_RESERVED = re.compile(
    "break|case|catch|classdef|continue|else|elseif|end|for|function|global|if|otherwise|parfor|"
    "persistent|return|spmd|switch|try|while"
)


def write_mat(
    target: str | os.PathLike[str], columns: Sequence[Column], time: Vector, values: Vector
) -> None:
    """Write samples over time, SI, (n, len(columns)); see `Trajectory.to_mat`."""
    from cosim.files import write_atomically  # only if a file is used

    columns = (Column("time", "s"), *columns)
    names = matlab_names([column.name for column in columns])
    table: dict[str, Any] = dict(zip(names, (time, *values.T), strict=True))
    table["units"] = dict(zip(names, (column.unit for column in columns), strict=True))
    table["names"] = dict(zip(names, (column.name for column in columns), strict=True))
    file = io.BytesIO()
    scipy = optional_module("scipy.io", "data")
    scipy.savemat(file, table, long_field_names=True, oned_as="column")
    write_atomically(target, b"MATLAB 5.0 MAT-file".ljust(116) + file.getvalue()[116:])  # no date


def matlab_names(names: Sequence[str]) -> list[str]:
    """Return distinct names that MATLAB accepts: letters, digits and `_`, at most 63."""
    found = ["units", "names"]
    for name in names:
        plain = re.sub(r"\W", "_", name, flags=re.ASCII)
        if not plain[0].isalpha() or _RESERVED.fullmatch(plain):
            plain = f"x_{plain}"
        free, i = plain[:63], 1
        while free in found:
            i += 1
            free = f"{plain[:58]}_{i}"
        found.append(free)
    return found[2:]
