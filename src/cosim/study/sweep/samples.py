"""What is varied from run to run: tables, grids and designs of experiments."""

import csv
import hashlib
import io
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cosim.arrays import Vector
from cosim.errors import ParameterError, UnknownName, UsageError
from cosim.files import read_text, write_atomically
from cosim.host.optional_packages import optional_module
from cosim.model.many_values import as_arrays
from cosim.trajectory import repr_17

DESIGNS = {"sobol": "Sobol", "lhs": "LatinHypercube", "halton": "Halton", "random": ""}
A_TABLE = "arrays by name, a CSV file, a pandas table, or what grid and design return"


@dataclass(frozen=True, eq=False)
class Samples:
    """Numbers by name, one row per run.

    Attributes:
        columns: Name to values, (runs,).
        origin: Where they come from, in words; with the seed of a design.
        problem: Names and bounds as SALib takes them, of a design for sensitivity indices.

    Raises:
        ParameterError: Columns differ in length, or hold no numbers.
    """

    columns: Mapping[str, Vector]
    origin: str = "table"
    problem: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "columns", as_arrays("samples", self.columns))
        if not len(self):
            raise ParameterError("samples: there are none; give one row per run")

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()))) if self.columns else 0

    def part(self, first: int, count: int) -> dict[str, Vector]:
        """Return some consecutive rows."""
        return {name: column[first : first + count] for name, column in self.columns.items()}

    @cached_property
    def digest(self) -> str:
        """What these samples are known by."""
        parts = (name.encode() + b"\0" + column.tobytes() for name, column in self.columns.items())
        return hashlib.sha256(b"\0".join(parts)).hexdigest()

    def to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write one row per run with 17 significant digits; the file is whole or not there."""
        rows = zip(*(column.tolist() for column in self.columns.values()), strict=True)
        lines = [",".join(self.columns), *(",".join(map(repr_17, row)) for row in rows)]
        write_atomically(path, ("\n".join(lines) + "\n").encode())


def as_samples(given: Any) -> Samples:
    """Return samples of whatever a user may give.

    Raises:
        UsageError: It is none of these.
        ParameterError: A file cannot be read, or something is no number.
    """
    if isinstance(given, Samples):
        return given
    if isinstance(given, str | os.PathLike):
        return read_samples(given)
    if isinstance(given, Mapping):
        return Samples(given)
    if hasattr(given, "columns") and hasattr(given, "to_numpy"):  # of pandas
        return Samples({str(name): given[name].to_numpy() for name in given.columns})
    raise UsageError.of_type("sweep: samples", given, A_TABLE)


def read_samples(path: str | os.PathLike[str]) -> Samples:
    """Read a CSV file: names in the first line, then one row of numbers per run, SI units.

    Raises:
        UsageError: It cannot be read.
        ParameterError: Something is no number.
    """
    text = io.StringIO(read_text(path, "the samples "), newline="")
    names, *rows = [row for row in csv.reader(text) if row] or [[]]
    names = [name.strip() for name in names]
    for number, row in enumerate(rows, start=2):
        if len(row) != len(names):
            raise ParameterError(
                f"{path}, row {number}: {len(row)} values for {len(names)} names; give as many"
            )
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise ParameterError(f"{path}: the column {twice} is there twice; keep one")
    try:
        table = np.array(rows, dtype=float).reshape(len(rows), len(names))
    except ValueError as error:
        raise ParameterError(f"{path}: {error}; give numbers in SI units") from error
    return Samples(dict(zip(names, table.T, strict=True)), f"{Path(path).name}")


def grid(axes: Mapping[str, ArrayLike]) -> Samples:
    """Return every combination of the values of each name; the last name varies fastest."""
    columns = {name: np.atleast_1d(np.array(values, dtype=float)) for name, values in axes.items()}
    table = np.array(list(product(*columns.values())), dtype=float)
    return Samples(dict(zip(columns, table.T, strict=True)), "grid")


def design(kind: str, runs: int, ranges: Mapping[str, Any], *, seed: int = 0) -> Samples:
    """Return a design of experiments.

    Args:
        kind: "sobol", "lhs", "halton" or "random".
        runs: How many; a power of two for "sobol".
        ranges: By name (low, high), evenly likely, or a distribution with a `ppf`, as those of
            `scipy.stats`; a single number stays the same in all runs.
        seed: The same seed, the same design.

    Raises:
        UnknownName: There is no such design.
        ParameterError: A range is none, or `runs` is not positive.
        MissingTool: scipy is not there.
    """
    if kind not in DESIGNS:
        raise UnknownName.among("sweep", "design", kind, DESIGNS)
    if runs < 1:
        raise ParameterError(f"sweep: {runs} runs; give 1 or more")
    varied = [name for name, spread in ranges.items() if not isinstance(spread, int | float)]
    if not varied:
        raise ParameterError(f"sweep: {kind} needs a range; give e.g. phi_dot=0:1")
    if kind == "random":
        unit = np.random.default_rng(seed).random((runs, len(varied)))
    else:
        qmc = optional_module("scipy.stats", "sweep").qmc
        sampler = getattr(qmc, DESIGNS[kind])(len(varied), rng=np.random.default_rng(seed))
        unit = sampler.random(runs)
    quantiles = dict(zip(varied, unit.T, strict=True))
    columns = {
        name: _spread(name, spread, quantiles[name]) if name in quantiles else spread
        for name, spread in ranges.items()
    }
    return Samples(columns, f"{kind}:{runs}, seed {seed}")


def _spread(name: str, spread: Any, quantiles: Vector) -> Vector:
    if hasattr(spread, "ppf"):
        found: Vector = np.asarray(spread.ppf(quantiles), dtype=float)
        return found
    if isinstance(spread, Sequence | np.ndarray) and len(spread) == 2:
        low, high = float(spread[0]), float(spread[1])
        if low < high < np.inf and low > -np.inf:
            return low + (high - low) * quantiles
    raise ParameterError(
        f"sweep: {name} = {spread!r} is no range; give (low, high) or a distribution with a ppf"
    )


def digest_of(parts: Iterable[bytes]) -> str:
    """Return what some bytes are known by."""
    return hashlib.sha256(b"\0".join(parts)).hexdigest()
