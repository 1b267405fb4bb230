"""The samples of a sweep: tables, grids and designs."""

import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from math import isfinite, prod
from numbers import Real
from pathlib import Path
from typing import Any
from warnings import catch_warnings, simplefilter, warn

import numpy as np
from numpy.typing import ArrayLike

from casadi_models.units import represented
from cosim.arrays import Vector, reals
from cosim.errors import ParameterError, UnknownName, UsageError
from cosim.host.optional_packages import optional_module
from cosim.memo import digest_of
from cosim.model.many_values import as_arrays
from cosim.model.values import MOST_SEED, number, whole
from cosim.series.csv_file import numbers_of, rows_of

DESIGNS = {"sobol": "Sobol", "lhs": "LatinHypercube", "halton": "Halton", "random": ""}
A_TABLE = "arrays by name, a CSV file, a pandas table, or what grid and design return"


@dataclass(frozen=True, eq=False)
class Samples:
    """Numbers by name, one row per run.

    Attributes:
        columns: Name to values, (runs,).
        origin: Their source: the file, or the design with its seed.

    Raises:
        ParameterError: Columns differ in length, or a value is no number.
    """

    columns: Mapping[str, Vector]
    origin: str = "table"

    def __post_init__(self) -> None:
        object.__setattr__(self, "columns", as_arrays("samples", self.columns))
        if not len(self):
            raise ParameterError("samples: there are none; give one row for each run")

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()))) if self.columns else 0

    def part(self, first: int, count: int) -> dict[str, Vector]:
        """Return consecutive rows."""
        return {name: column[first : first + count] for name, column in self.columns.items()}

    def distinct_names(self, taken: Collection[str]) -> dict[str, str]:
        """Return by name what each quantity is called among results that have taken some names."""
        found = dict[str, str]()
        for name in self.columns:
            place = name
            while place in taken or (place != name and place in self.columns):
                place += "_start"
            found[name] = place
        return found

    @cached_property
    def digest(self) -> str:
        """Hash of names and numbers."""
        return digest_of(n.encode() + b"\0" + own.tobytes() for n, own in self.columns.items())


def as_samples(table: Any) -> Samples:
    """Return samples from a CSV file, a mapping, a pandas table or samples."""
    if isinstance(table, Samples):
        return table
    if isinstance(table, str | os.PathLike):
        return read_samples(table)
    if isinstance(table, Mapping):
        return Samples(table)
    if hasattr(table, "columns") and hasattr(table, "iloc"):  # of pandas
        return Samples({str(name): table[name].to_numpy() for name in table.columns})
    raise UsageError.of_type("sweep: samples", table, A_TABLE)


def chosen_samples(
    start_values: Mapping[str, Any] | None,
    samples: Any = None,
    named: str | None = None,
    *,
    seed: int = 0,
) -> Samples:
    """Return the samples of a sweep.

    Args:
        start_values: By name: arrays, (runs,), or single numbers. With samples: single numbers
            only. With a design: see `grid` and `design`.
        samples: A table; see `as_samples`.
        named: A design: "grid" or KIND:N, e.g. "sobol:1024".
        seed: Of the design.
    """
    expected = "arrays by name, e.g. {'phi': [0.1, 0.2]}; a table as samples"
    UsageError.reject("sweep: start_values", start_values, Mapping | None, expected)
    if samples is not None:
        if named is not None:
            raise UsageError("sweep: give samples or a design, not both")
        table, fixed = as_samples(samples), dict(start_values or {})
        for name, value in fixed.items():
            if name in table.columns:
                raise UsageError(f"sweep: {name} is in samples and in start_values; give it once")
            if np.ndim(value):
                raise UsageError(f"sweep: {name}: with samples give one value for all runs")
        return replace(table, columns={**table.columns, **fixed})
    if named in (None, "grid"):
        if not start_values:
            raise UsageError("sweep: nothing varies; give start_values or samples")
        return Samples(start_values) if named is None else grid(start_values)
    kind, _, count = str(named).partition(":")
    if not count.isdecimal():
        raise UsageError(f"sweep: design {named}: write KIND:N, e.g. sobol:1024, or grid")
    return design(kind, int(count), start_values or {}, seed=seed)


def read_samples(path: str | os.PathLike[str]) -> Samples:
    """Read a CSV file: names in the first line, then one row of numbers per run, SI units.

    Raises:
        UsageError: It cannot be read.
        ParameterError: Something is no number.
    """
    (_, head), *rows = rows_of(Path(path))
    names = [name.strip() for name in head]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise ParameterError(f"{path}: the column {twice} occurs twice; remove one")
    places = range(len(names))
    table = [numbers_of(Path(path), line, row, names, places) for line, row in rows]
    columns = np.array(table).reshape(len(table), len(names)).T
    return Samples(dict(zip(names, columns, strict=True)), f"{Path(path).name}")


def grid(axes: Mapping[str, ArrayLike]) -> Samples:
    """Return every combination of the values of each name; the last name varies fastest.

    Example:
        >>> grid({"g": [1.62, 9.81], "m": [1.0, 2.0]}).columns["m"]
        array([1., 2., 1., 2.])
    """
    UsageError.reject("grid: axes", axes, Mapping, "values by name, e.g. {'phi': [0.1, 0.2]}")
    columns = {name: _axis(name, values) for name, values in axes.items()}
    whole("grid", "runs", prod(map(len, columns.values())))
    table = np.array(list(product(*columns.values())), dtype=float)
    return Samples(dict(zip(columns, table.T, strict=True)), "grid")


def _axis(name: str, values: ArrayLike) -> Vector:
    try:
        axis = np.atleast_1d(reals(values))
    except (TypeError, ValueError, OverflowError, RuntimeError, NotImplementedError):
        axis = np.empty((0, 0))
    if axis.ndim != 1 or not axis.size:
        raise ParameterError(f"grid: {name} = {represented(values)}; give one or more numbers")
    return axis


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

    Example:
        >>> len(design("sobol", 8, {"phi": (0.0, 0.5)}))
        8
    """
    UnknownName.reject("sweep", "design", DESIGNS, kind)
    whole("design", "runs", runs)
    whole("design", "seed", seed, 0, MOST_SEED)
    varied = [name for name, spread in ranges.items() if not isinstance(spread, Real)]
    if not varied:
        raise ParameterError(f"sweep: {kind} needs a range; give e.g. phi_dot=0:1")
    if kind == "random":
        unit = np.random.default_rng(seed).random((runs, len(varied)))
    else:
        qmc = optional_module("scipy.stats", "sweep").qmc
        sampler = getattr(qmc, DESIGNS[kind])(len(varied), rng=np.random.default_rng(seed))
        with catch_warnings():
            simplefilter("ignore", UserWarning)  # of SciPy, on numbers that are no power of 2
            unit = sampler.random(runs)
        if kind == "sobol" and runs & (runs - 1):
            better = f"{2 ** (runs.bit_length() - 1)} or {2 ** runs.bit_length()}"
            warn(f"sweep: {runs} sobol samples are unevenly spread; give {better}", stacklevel=2)
    quantiles = dict(zip(varied, unit.T, strict=True))
    columns = {
        name: _spread(name, spread, quantiles[name]) if name in quantiles else spread
        for name, spread in ranges.items()
    }
    return Samples(columns, f"{kind}:{runs}, seed {seed}")


def _spread(name: str, spread: Any, quantiles: Vector) -> Vector:
    if hasattr(spread, "ppf"):
        return np.asarray(spread.ppf(quantiles), dtype=float)
    if isinstance(spread, Sequence | np.ndarray) and len(spread) == 2:
        low, high = (number("sweep", name, end) for end in spread)
        if low < high and isfinite(high - low):
            return low + (high - low) * quantiles
        if low < high:
            return low * (1 - quantiles) + high * quantiles
    raise ParameterError(
        f"sweep: {name} = {represented(spread)} is no range; give (low, high), or a distribution "
        "such as scipy.stats.norm(0, 1)"
    )
