"""One thing to be said of an FMU, and the rules that say it."""

from dataclasses import dataclass, field, fields, replace
from typing import Any

WRONG, ADVICE, HOUSE = "wrong", "advice", "house"


@dataclass(frozen=True)
class Finding:
    """Something about an FMU.

    Attributes:
        level: "wrong" where the FMI is broken or a run fails; "advice" where the FMI leaves it
            open, but others stumble over it; "house" where only our own files are held to it.
        rule: A short name, the same for all findings of a kind.
        place: File within the FMU, variable, section or interface.
        found: What is there.
        cure: What its author can do.
        importers: What importers do with it.
        sentence: Place and finding in one; not in `row`.
    """

    level: str
    rule: str
    place: str
    found: str
    cure: str
    importers: str = ""
    sentence: str = field(default="", compare=False)

    def row(self) -> dict[str, Any]:
        """Return the finding as a line of a table."""
        shown = (one.name for one in fields(self) if one.name != "sentence")
        return {name: getattr(self, name) for name in shown}

    def within(self, file: str) -> "Finding":
        """Return the finding with a file's name before its sentence."""
        return replace(self, sentence=f"{file}: {self.sentence}")


@dataclass(frozen=True)
class Rule:
    """What an FMU must keep, or should.

    Attributes:
        name, level, cure, importers: Of each finding, see `Finding`.
    """

    name: str
    level: str
    importers: str
    cure: str

    def at(self, place: str, found: str, sentence: str | None = None) -> Finding:
        """Return what is found at a place; the sentence is both of them unless it is given."""
        told = f"{place}: {found}" if sentence is None else sentence
        return Finding(self.level, self.name, place, found, self.cure, self.importers, told)

    def about(self, place: str, found: str) -> Finding:
        """Return what is found, as a whole sentence by itself, at a place."""
        return self.at(place, found, found)
