"""Model structure of an FMU: its unknowns and their dependencies."""

from collections.abc import Sequence
from xml.etree import ElementTree as ET

from casadi_models.dae import Start
from cosim.fmi.export.dependencies import Dependencies
from cosim.fmi.export.dialect import Dialect
from cosim.fmi.export.variables import FmuVariable, Role
from cosim.model.reduction import Pattern

Needs = dict[int, tuple[int, ...]]  # value references of the dependencies of each unknown


def model_structure(
    variables: Sequence[FmuVariable], depends: Dependencies, dialect: Dialect, indicators: int = 0
) -> ET.Element:
    """Return outputs, derivatives, initial unknowns and event indicators with their dependencies.

    Args:
        indicators: Number of outputs at the end of the list that are event indicators.
    """
    positions = {role: [i for i, v in enumerate(variables) if v.role is role] for role in Role}
    time, states = positions[Role.TIME], positions[Role.STATE]
    inputs, parameters = positions[Role.INPUT], positions[Role.PARAMETER]
    computed = [*positions[Role.DERIVATIVE], *positions[Role.ALGEBRAIC], *positions[Role.OUTPUT]]
    knowns = [*time, *states, *inputs, *parameters]
    running = _lists(computed, depends.running, knowns)
    if not dialect.fixed_are_knowns:
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
    groups = observed, positions[Role.DERIVATIVE], unknown, margins
    lists, whole = (running, running, initial, running), ET.Element("ModelStructure")
    for tag, members, needs in zip(dialect.sections, groups, lists, strict=False):
        parent = ET.SubElement(whole, tag) if dialect.unknown and members else whole
        for i in sorted(members):
            others = " ".join(str(dialect.first + k) for k in needs[i])
            own = {dialect.reference: str(dialect.first + i), "dependencies": others}
            ET.SubElement(parent, dialect.unknown or tag, own)
    return whole


def _lists(rows: Sequence[int], pattern: Pattern, columns: Sequence[int]) -> Needs:
    return {
        row: tuple(sorted(c for c, needed in zip(columns, line, strict=True) if needed))
        for row, line in zip(rows, pattern, strict=True)
    }
