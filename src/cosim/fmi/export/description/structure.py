"""Which unknowns an importer asks for, and what each of them depends on."""

from collections.abc import Sequence
from dataclasses import dataclass

from casadi_models.dae import Start
from cosim.fmi.export.dependencies import Dependencies
from cosim.fmi.export.variables import FmuVariable, Role
from cosim.model.reduction.structure import Pattern


@dataclass(frozen=True)
class DependentVariable:
    """A variable that the equations determine, and what it depends on, as value references."""

    reference: int
    dependencies: tuple[int, ...]


@dataclass(frozen=True)
class Structure:
    """The unknowns that an importer asks for, by FMI's sections, in ascending order."""

    outputs: tuple[DependentVariable, ...]
    derivatives: tuple[DependentVariable, ...]
    initial_unknowns: tuple[DependentVariable, ...]
    indicators: tuple[DependentVariable, ...] = ()


def model_structure(
    variables: Sequence[FmuVariable],
    depends: Dependencies,
    indicators: int = 0,
    *,
    fixed_are_knowns: bool,
) -> Structure:
    """Return outputs, derivatives and initial unknowns with their true dependencies.

    Args:
        variables: In the order of their value references.
        depends: What depends on what.
        indicators: How many outputs, the last, are event indicators.
        fixed_are_knowns: See `Dialect`.
    """
    positions = {role: [i for i, v in enumerate(variables) if v.role is role] for role in Role}
    time, states = positions[Role.TIME], positions[Role.STATE]
    inputs, parameters = positions[Role.INPUT], positions[Role.PARAMETER]
    computed = [*positions[Role.DERIVATIVE], *positions[Role.ALGEBRAIC], *positions[Role.OUTPUT]]
    knowns = [*time, *states, *inputs, *parameters]
    running = _lists(computed, depends.running, knowns)
    if not fixed_are_knowns:
        fixed = {i for i in parameters if not variables[i].tunable}
        running = {i: tuple(k for k in needs if k not in fixed) for i, needs in running.items()}
    running |= {i: (i,) for i in states}
    initial = _lists([*states, *computed], depends.initial, knowns)
    observed = [i for i, v in enumerate(variables) if v.observed]
    unknown = {i for i in (*observed, *states) if variables[i].start_kind is not Start.EXACT}
    unknown |= set(positions[Role.DERIVATIVE])
    margins = positions[Role.OUTPUT][len(positions[Role.OUTPUT]) - indicators :]
    for i in positions[Role.VALIDITY]:
        running[i] = tuple(sorted({k for margin in margins for k in running[margin]}))
        initial[i] = tuple(sorted({k for margin in margins for k in initial[margin]}))

    def section(
        members: Sequence[int], table: dict[int, tuple[int, ...]]
    ) -> tuple[DependentVariable, ...]:
        return tuple(DependentVariable(i, table[i]) for i in sorted(members))

    return Structure(
        section(observed, running),
        section(positions[Role.DERIVATIVE], running),
        section([*unknown], initial),
        section(margins, running),
    )


def _lists(
    rows: Sequence[int], pattern: Pattern, columns: Sequence[int]
) -> dict[int, tuple[int, ...]]:
    return {
        row: tuple(sorted(c for c, needed in zip(columns, line, strict=True) if needed))
        for row, line in zip(rows, pattern, strict=True)
    }
