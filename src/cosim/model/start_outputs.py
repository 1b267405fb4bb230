"""Start values set through an output, e.g. a bicycle's `speed` instead of its wheel rate."""

from collections.abc import Collection, Mapping

import casadi as ca
import numpy as np
from casadi import SX

from casadi_models.dae import Dae
from casadi_models.dae.starts import StartThrough
from cosim.arrays import Truths, Vector
from cosim.errors import UsageError
from cosim.memo import cached_per_thread

_LARGEST_RESIDUAL = 1e-9  # relative to the size of what is solved for


def reject_twice(dae: Dae, given: Collection[str]) -> None:
    """Reject values for both an output and the state whose start value it determines.

    Raises:
        UsageError: Both are given, or two outputs that give the same start.
    """
    taken: dict[str, str] = {}
    for way in _ways(dae, given):
        state = dae.states[way.state].name
        other = state if state in given else taken.get(state)
        if other is not None:
            raise UsageError(
                f"{dae.full_name}: {way.variable.name} gives the start of {state}, and {other} is "
                "given, too; give one of them"
            )
        taken[state] = way.variable.name


def overriding(dae: Dae, old: Mapping[str, float], new: Mapping[str, float]) -> dict[str, float]:
    """Return merged values by name; new ones replace old ones of the same start value."""
    pairs = [(way.variable.name, dae.states[way.state].name) for way in dae.start_outputs]
    gone = {state for output, state in pairs if output in new}
    gone |= {output for output, state in pairs if state in new}
    gone |= {o for o, state in pairs if any(s == state and other in new for other, s in pairs)}
    return {**{name: value for name, value in old.items() if name not in gone}, **new}


def solved_starts(
    dae: Dae, given: Mapping[str, Vector], x: Vector, p: Vector
) -> tuple[Vector, Truths]:
    """Solve for the start values that outputs determine.

    Args:
        given: Of each run, (runs,), by name; other names than `Dae.start_outputs` do not count.
        x: Starts and guesses, (runs, nx).
        p: Parameters, (runs, np).

    Returns:
        `x` with these starts, (runs, nx), and whether each run has them, (runs,).
    """
    ways = _ways(dae, given)
    if not (ways and len(x)):
        return x, np.ones(len(x), dtype=bool)
    names = tuple(way.variable.name for way in ways)
    root, residual = _functions(dae, names, len(x))
    targets = np.array([given[name] for name in names], dtype=float)
    guesses = x[:, _unknowns(dae, ways)].T
    found = np.array(root(guesses, targets, x.T, p.T)).reshape(guesses.shape)
    left = np.abs(np.array(residual(found, targets, x.T, p.T)).reshape(guesses.shape))
    x = x.copy()
    for row, way in zip(found[: len(ways)], ways, strict=True):
        x[:, way.state] = row
    size = 1 + np.abs(found).max(axis=0, initial=0.0)
    return x, np.asarray(left.max(axis=0) <= _LARGEST_RESIDUAL * size)  # not a number is not less


def _ways(dae: Dae, given: Collection[str]) -> list[StartThrough]:
    return [way for way in dae.start_outputs if way.variable.name in given]


def _unknowns(dae: Dae, ways: Collection[StartThrough]) -> list[int]:
    """Return the positions in x of the states that are solved for, with those that follow."""
    return [*(way.state for way in ways), *(i for rule in dae.start_rules for i in rule.states)]


@cached_per_thread(16)
def _functions(dae: Dae, names: tuple[str, ...], runs: int) -> tuple[ca.Function, ca.Function]:
    """Return root and residual of all start equations together, one column for each run."""
    ways = _ways(dae, names)
    rows = _unknowns(dae, ways)
    unknown, targets = SX.sym("unknown", len(rows)), SX.sym("targets", len(ways))
    filled = SX(dae.x)
    filled[rows] = unknown
    laws = [way.expression - targets[i] for i, way in enumerate(ways)]
    for rule in dae.start_rules:
        own = dae.x[list(rule.states)]
        laws.append(rule.expression if rule.implicit else own - rule.expression)
    column = ca.densify(ca.substitute(ca.vertcat(*laws), dae.x, filled))
    residual = ca.Function("laws", [unknown, targets, dae.x, dae.p], [column], {"cse": True})
    options = {"error_on_fail": False, "max_iter": 50, "abstol": 1e-13}
    root = ca.rootfinder("starts", "fast_newton", residual, options)
    return (root, residual) if runs == 1 else (root.map(runs), residual.map(runs))
