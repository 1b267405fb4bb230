"""What derivatives are taken with respect to: states, inputs, parameters of an FMU on the bench."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from cosim.arrays import Vector
from cosim.fmi.check.parsed import Described
from cosim.fmi.check.trials.bench import Bench, Session, Skipped


@dataclass(frozen=True)
class Known:
    """What unknowns may depend on.

    Attributes:
        variable: As described.
        state: Its place among the states; None for inputs and parameters.
        surely: Whether the FMU must tell derivatives with respect to it.
    """

    variable: Described
    state: int | None
    surely: bool


def moved_unknowns(
    session: Session,
    unknowns: Sequence[Described],
    known: Known,
    states: Vector,
    value: float,
) -> Vector:
    """Return the unknowns with one known at another value."""
    if known.state is None:
        session.put(known.variable, value)
    else:
        changed = states.copy()
        changed[known.state] = value
        session.put_states(changed)
    return session.values(unknowns)


def states_among(knowns: Sequence[Known], at: Vector) -> Vector:
    """Return the states among values of knowns, (n,)."""
    return np.array([v for k, v in zip(knowns, at, strict=True) if k.state is not None])


def knowns_of(bench: Bench) -> Iterator[Known]:
    """Yield states, then continuous inputs and, in FMI 3.0, tunable parameters."""
    with suppress(Skipped):
        for i, (state, _) in enumerate(bench.states()):
            yield Known(state, i, surely=True)
    for variable in bench.described.variables:
        if not bench.single(variable):
            continue
        kinds = variable.causality, variable.variability
        if kinds == ("input", "continuous"):
            yield Known(variable, None, surely=True)
        elif not bench.second and kinds == ("parameter", "tunable"):
            yield Known(variable, None, surely=False)


def need_model_exchange(kind: str) -> None:
    """Skip a trial of model exchange elsewhere."""
    if kind != "ModelExchange":
        raise Skipped("it is a trial of model exchange")


def tells_slopes(bench: Bench, kind: str) -> bool:
    """Tell whether an interface offers directional derivatives."""
    offered = ("providesDirectionalDerivative", "providesDirectionalDerivatives")
    return bench.offers(kind, *offered)
