"""`Merged`: parts that slide on each other, simulated as one part of their system."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from typing import Any

from casadi_models.dae import Dae
from casadi_models.dae.coupled import Connection, joined
from casadi_models.dae.relations import KEEPS
from cosim.coupling.part import Part, part_of
from cosim.errors import UsageError
from cosim.integrate.modes import hybrid
from cosim.text import Violation, one_note
from cosim.trajectory import Trajectory

Name = tuple[str, str]  # part and variable


def sides_of(
    connections: Sequence[Connection], holder: str, inputs: Collection[str] | None = None
) -> set[str]:
    """Return the parts that hold the two sides of a relation.

    Args:
        connections: Of the system.
        holder: The part whose relation it is; what drives this part moves the other side.
        inputs: Those of it that move the relation; all when None.
    """
    feeling = {holder}
    while more := {w.input[0] for w in connections if w.output[0] in feeling} - feeling:
        feeling |= more
    moving = (w for w in connections if w.input[0] == holder)
    return {holder} | {w.output[0] for w in moving if not inputs or w.input[1] in inputs} & feeling


def sliding_parts(
    parts: Mapping[str, Part], connections: Sequence[Connection], holder: str
) -> tuple[str, ...]:
    """Return the parts that hold the two sides of a relation; none if these are no two models."""
    sides = sides_of(connections, holder)
    known = all(isinstance(parts[name].subject, Dae) for name in sides)
    return tuple(sorted(sides)) if known and len(sides) > 1 else ()  # in any order the same bits


def sticking_parts(parts: Mapping[str, Part], connections: Sequence[Connection]) -> dict[str, bool]:
    """Return the models whose relations may stay at 0 by what other parts do.

    By name: whether all these parts can merge.
    """
    return {
        name: bool(sliding_parts(parts, connections, name))
        for name, part in parts.items()
        if isinstance(part.subject, Dae)
        and (model := hybrid(part.subject))
        and any(r.at_zero != KEEPS for r in compress(model.relations, model.of_input))
    }


def one_model(
    name: str, title: str, models: Mapping[str, Dae], connections: Sequence[Connection]
) -> Dae:
    """Return all models as one; raises UsageError where that is impossible."""
    try:
        return joined(name, title, models, connections)
    except ValueError as error:
        raise UsageError(f"{name}: {error}") from None


@dataclass(frozen=True)
class Merged:
    """How names of a system become those of one in which some parts are one.

    Attributes:
        names: The merged parts.
        whole: The part that stands for them.
    """

    names: tuple[str, ...]
    whole: str

    def inside(self, name: Name) -> Name:
        """Return the part and the variable that stand for others."""
        return (self.whole, ".".join(name)) if name[0] in self.names else name

    def changes(
        self,
        parts: Mapping[str, Part],
        connections: Sequence[Connection],
        start_values: Mapping[Name, float],
        unused: Mapping[str, Sequence[Any]],
    ) -> dict[str, Any]:
        """Return these attributes of the system with merged parts."""
        inner = [w for w in connections if {w.input[0], w.output[0]} <= {*self.names}]
        outer = [w for w in connections if w not in inner]
        daes = {n: p.subject for n, p in parts.items() if n in self.names}
        models = {name: dae for name, dae in daes.items() if isinstance(dae, Dae)}
        dae = one_model(self.whole, "", models, inner)
        driving = (self.inside(w.output) for w in outer)
        dae = replace(dae, driving=tuple(name for part, name in driving if part == self.whole))
        others = {name: part for name, part in parts.items() if name not in self.names}
        lacking = dict.fromkeys(ability for name in self.names for ability in unused.get(name, ()))
        return {
            "parts": {**others, self.whole: part_of(self.whole, dae)},
            "connections": tuple(
                w._replace(input=self.inside(w.input), output=self.inside(w.output)) for w in outer
            ),
            "start_values": {self.inside(name): v for name, v in start_values.items()},
            "unused": {**unused, self.whole: tuple(lacking)},
        }

    def outside(self, run: Trajectory, names: Sequence[Name]) -> Trajectory:
        """Return a run of the merged system with the given names of variables, and of events."""
        prefix = f"{self.whole}."
        columns = tuple(replace(c, name=c.name.removeprefix(prefix)) for c in run.columns)
        events = tuple(
            replace(event, name=event.name.removeprefix(f"{self.whole}: ")) for event in run.events
        )
        together = f"{' and '.join(self.names)} slide on each other: they are simulated as one part"
        stats = {**run.stats, "note": one_note(run.stats.get("note"), together)}
        if "invalid" in stats:
            texts = (
                (one.time, one.what.removeprefix(f"{self.whole}: ")) for one in stats["invalid"]
            )
            stats["invalid"] = [Violation(*text) for text in texts]
        if "error_estimate_of" in stats:
            stats["error_estimate_of"] = stats["error_estimate_of"].removeprefix(prefix)
        found = replace(run, columns=columns, events=events, stats=stats)
        return found.select([".".join(name) for name in names])
