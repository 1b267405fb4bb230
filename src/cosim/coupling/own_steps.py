"""Parts whose steps have one length, and the macro steps that they allow."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import ceil, isclose

from cosim.coupling.opened_part import OpenedPart
from cosim.errors import UsageError

_MOST_MULTIPLES = 1000
_MOST_PIECES = 10_000  # of an output interval


@dataclass(frozen=True)
class OwnSteps:
    """The lengths of steps, s.

    Attributes:
        of_parts: The only length of the steps of a part, by its name.
        quantum: Macro steps are multiples of it; 0 if they may have any length.
    """

    of_parts: Mapping[str, float]
    quantum: float


def own_steps(
    system: str,
    parts: Mapping[str, OpenedPart],
    macro_step: float | None,
    interval: float,
    span: float | None,
    share: float,
    *,
    at_internal_steps: bool,
) -> OwnSteps:
    """Return the steps of parts that take steps of one length only.

    It is the length that the file names, or else the macro step, or the output interval: of that
    such a part of it where inputs stay within the step that their error follows the tolerance.

    Args:
        system: Its name.
        parts: By name.
        macro_step: s; None if it is chosen by the accuracy.
        interval: Distance of the output times, s.
        span: Length of the run, s; None if output times and the end are not known.
        share: Of the tolerance of the first run.
        at_internal_steps: Whether macro steps that are chosen end with steps of the solvers inside
            parts that drive others where their length is fixed. Outputs change there only.

    Raises:
        UsageError: The macro step, the output interval or the span is no multiple of it, or the
            lengths of two parts have no common multiple.
    """
    found = dict[str, float]()
    pieces = min(ceil(share**-0.5), _MOST_PIECES)  # as the error is of second order
    for name, part in parts.items():
        if part.any_step:
            continue
        default = macro_step or (interval / pieces if part.holds_inputs else interval)
        found[name] = part.only_step or default
        if (
            macro_step is not None
            and not part.internal_step
            and not is_multiple(macro_step, found[name])
        ):
            found[name] = macro_step  # another length may do as well if it is always the same
        for what, length in (
            ("macro_step", macro_step),
            ("output_interval", span and interval),
            ("the span of the run", span),
        ):
            if length is not None and not is_multiple(length, found[name]):
                raise UsageError(
                    f"{system}: {what} = {length:g} s is no multiple of {found[name]:g} s, the "
                    f"only step of part '{name}'; choose one that is"
                )
    quantum = _common_multiple(found.values())
    if found and not quantum:
        steps = ", ".join(f"{name}: {step:g} s" for name, step in found.items())
        raise UsageError(
            f"{system}: the only steps of the parts have no common multiple ({steps}); export the "
            "parts with other ones"
        )
    if macro_step is not None:
        return OwnSteps(found, 0.0)
    internal = {p.internal_step for p in parts.values() if at_internal_steps and p.outputs}
    return OwnSteps(found, _common_multiple({quantum, *internal} - {0.0}) or quantum)


def is_multiple(length: float, step: float) -> bool:
    """Tell whether a length is a multiple of a step but for rounding."""
    return (
        step > 0
        and length > step / 2
        and isclose(length / step, round(length / step), rel_tol=1e-9)
    )


def _common_multiple(steps: Iterable[float]) -> float:
    """Return the least common multiple of lengths; 0 if there are none, or it has none."""
    every = sorted(steps)
    if not every:
        return 0.0
    multiples = (n * every[-1] for n in range(1, _MOST_MULTIPLES))
    return next((m for m in multiples if all(is_multiple(m, step) for step in every)), 0.0)
