"""The trial of inputs that rise within a step, by their derivatives."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from cosim.arrays import Vector
from cosim.fmi.check.finding import TRIAL_RULES, Finding
from cosim.fmi.check.parsed import Described
from cosim.fmi.check.trials.bench import MOST_NAMES, Bench, Note, Skipped, altered

_LONG, _SHORT = 3, 16  # long steps, and short steps in each
_RISES = (0.5, 0.05)  # of the size of an input; an event in a step is in one of them only
_SHARE = 1 / 3  # of the effect of a derivative that may be missing: Euler's method in three steps
_CLEAR = 0.1  # of this effect: what steps of other sizes may change
_TOLERANCES = 10  # of the solver inside: an effect that is clear


def ramps(bench: Bench, kind: str) -> Iterator[Finding | Note]:
    """An input with a derivative has the effect of constant inputs in many short steps."""
    if kind != "CoSimulation" or not bench.offers(kind, "canInterpolateInputs"):
        raise Skipped("it takes no derivatives of inputs")
    if not bench.offers(kind, "canHandleVariableCommunicationStepSize"):
        raise Skipped("its steps have one size")
    outputs, compared = bench.reals("output", "continuous"), 0
    for variable in bench.reals("input", "continuous")[:MOST_NAMES]:
        try:
            pairs = np.array([_effects(bench, variable, outputs, rise) for rise in _RISES])
        except Exception:  # it may reject values, or end
            continue
        effect, missing = pairs[:, 0], pairs[:, 1]
        compared += bool(effect.any())
        wrong = np.flatnonzero(((effect > 0) & (missing > _SHARE * effect)).all(axis=0))
        if len(wrong):
            k = wrong[0]
            yield TRIAL_RULES["input-derivatives"].at(
                variable.name,
                f"with its derivative, {outputs[k].name} is {missing[0, k]:.2g} off what {_SHORT} "
                f"times shorter steps give, without it {effect[0, k]:.2g}",
            )
            return
    Skipped.when(not compared, "no derivative of an input has a clear effect")
    yield Note(f"{compared} inputs")


def _effects(
    bench: Bench, variable: Described, outputs: list[Described], rise: float
) -> tuple[Vector, Vector]:
    """Return the effect of an input's derivative on outputs, and how much of it is missing.

    Effects that are not clear are 0.
    """
    rows = partial(_rows, bench, variable, outputs, rise)
    dense, half = (rows(n, follows=True) for n in (_SHORT, _SHORT // 2))
    held, fine = (rows(n) for n in (1, _SHORT))
    effect, missing = (np.abs(r - dense).max(axis=0) for r in (held, rows(1, rate=True)))
    left = np.maximum(np.abs(half - dense), np.abs(fine - held)).max(axis=0)
    size = np.maximum([v.nominal for v in outputs], np.abs(dense).max(axis=0))
    clear = (effect > _TOLERANCES * bench.tolerance * size) & (left < _CLEAR * effect)
    return np.where(clear, effect, 0.0), missing


def _rows(
    bench: Bench,
    variable: Described,
    outputs: list[Described],
    rise: float,
    parts: int,
    *,
    follows: bool = False,
    rate: bool = False,
) -> Vector:
    """Return outputs at the ends of long steps, (steps, outputs), of an input that rises.

    Args:
        bench: The FMU.
        variable: The input.
        outputs: What to return.
        rise: Of the input in all, by its size.
        parts: Short steps in each long step.
        follows: Whether a short step has the input's value in its middle, not at the start of its
            long step.
        rate: Whether the input has its derivative.
    """
    size = min(bench.step_size("CoSimulation"), bench.span / (_LONG + 1) / _SHORT) * _SHORT
    rows = []
    with bench.started("CoSimulation") as session:
        [begin] = session.values([variable])
        step = (altered(variable, begin, rise) - begin) / _LONG
        for i in range(_LONG * parts):
            at = (i + 0.5) / parts if follows else i // parts
            session.put(variable, begin + at * step)
            if rate:
                references = [int(variable.reference)]
                session.instance.setRealInputDerivatives(references, [1], [step / size])
            if not list(session.steps(size / parts, 1)):
                break
            if (i + 1) % parts == 0:
                rows.append(session.values(outputs))
    return np.array(rows)
