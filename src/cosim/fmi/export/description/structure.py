"""Which unknowns an importer asks for, and what each of them depends on."""

from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree as ET

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


@dataclass(frozen=True)
class StructureTags:
    """How a version of FMI writes the model structure.

    Attributes:
        sections: Tags for outputs, derivatives, initial unknowns and, if it has them, indicators.
        unknown: Tag of each within its section; None where those of a section have its tag.
        reference: Attribute that says which variable it is.
        first: What the first variable is called there.
    """

    sections: tuple[str, ...]
    unknown: str | None
    reference: str
    first: int

    def element(self, structure: Structure) -> ET.Element:
        """Return the model structure; sections without a member are left out."""
        whole = ET.Element("ModelStructure")
        found = (structure.outputs, structure.derivatives, structure.initial_unknowns)
        for tag, unknowns in zip(self.sections, (*found, structure.indicators), strict=False):
            apart = self.unknown is not None and unknowns
            parent = ET.SubElement(whole, tag) if apart else whole
            for unknown in unknowns:
                needs = " ".join(str(self.first + other) for other in unknown.dependencies)
                own = {self.reference: str(self.first + unknown.reference), "dependencies": needs}
                ET.SubElement(parent, self.unknown or tag, own)
        return whole


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
