"""Sensitivity indices of a number over the runs of a design: Sobol and Morris, by SALib."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cosim.arrays import Vector
from cosim.errors import UnknownName, UsageError
from cosim.host.optional_packages import optional_module
from cosim.study.sweep.samples import Samples

METHODS = {"sobol": "sobol", "morris": "morris"}


def sensitivity_design(
    method: str, size: int, ranges: Mapping[str, Sequence[float]], *, seed: int = 0
) -> Samples:
    """Return the design that indices need.

    Args:
        method: "sobol" (size * (2 k + 2) runs for k names) or "morris" (size * (k + 1)).
        size: Base samples, a power of two for "sobol"; trajectories of "morris".
        ranges: By name (low, high).
        seed: The same seed, the same design.

    Raises:
        UnknownName: There is no such method.
        MissingTool: SALib is not there.
    """
    if method not in METHODS:
        raise UnknownName.among("sweep", "sensitivity method", method, METHODS)
    names = list(ranges)
    problem = {
        "num_vars": len(names),
        "names": names,
        "bounds": [[float(low), float(high)] for low, high in ranges.values()],
    }
    module = optional_module(f"SALib.sample.{METHODS[method]}", "sweep")
    table = module.sample(problem, size, seed=seed)
    columns = dict(zip(names, np.array(table, dtype=float).T, strict=True))
    return Samples(columns, f"SALib {method}:{size}, seed {seed}", problem)


def indices(samples: Samples, number: Vector, method: str) -> dict[str, Vector]:
    """Return the indices of a number of each run.

    Returns:
        "sobol": first-order "S1" and total "ST" with half-widths of 95 % "S1_conf", "ST_conf";
        "morris": "mu_star", "sigma"; one per name, in the order of the samples.

    Raises:
        UsageError: The samples are no design of that method, or a run has no number.
    """
    if method not in METHODS:
        raise UnknownName.among("sweep", "sensitivity method", method, METHODS)
    if samples.problem is None or not samples.origin.startswith(f"SALib {method}"):
        raise UsageError(f"indices: the samples are no {method} design; see sensitivity_design")
    if not np.isfinite(number).all():
        missing = int((~np.isfinite(number)).sum())
        raise UsageError(f"indices: {missing} runs have no number; narrow the ranges")
    analyze = optional_module(f"SALib.analyze.{METHODS[method]}", "sweep").analyze
    found: Mapping[str, Any]
    if method == "sobol":
        found = analyze(dict(samples.problem), number, seed=0)
        kept: tuple[str, ...] = ("S1", "S1_conf", "ST", "ST_conf")
    else:
        table = np.column_stack([*samples.columns.values()])
        found = analyze(dict(samples.problem), table, number, seed=0)
        kept = ("mu_star", "sigma")
    return {key: np.array(found[key], dtype=float) for key in kept}
