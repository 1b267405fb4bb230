"""`Finding`: a fault of an FMU, and `Rule`: the rule that it breaks."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

WRONG, ADVICE, OWN = "wrong", "advice", "own"


@dataclass(frozen=True)
class Finding:
    """A fault of an FMU.

    Attributes:
        level: "wrong" if the FMI is violated or a run fails; "advice" if the FMI leaves it open,
            but importers have trouble with it; "own" for this project's exports only.
        rule: The rule's short name.
        place: File in the FMU, variable, section or interface.
        found: The fault.
        remedy: The remedy for the FMU's author.
        importers: The effect on importers.
        sentence: Place and fault in one sentence; not in `row`.
    """

    level: str
    rule: str
    place: str
    found: str
    remedy: str
    importers: str = ""
    sentence: str = field(default="", compare=False)

    def row(self) -> dict[str, Any]:
        """Return the finding as a row of a table."""
        shown = (one.name for one in fields(self) if one.name != "sentence")
        return {name: getattr(self, name) for name in shown}

    def within(self, file: str) -> "Finding":
        """Return the finding with a file's name before its sentence."""
        return replace(self, sentence=f"{file}: {self.sentence}")


@dataclass(frozen=True)
class Rule:
    """A rule for FMUs.

    Attributes:
        name, level, remedy, importers: Of each finding, see `Finding`.
    """

    name: str
    level: str
    importers: str
    remedy: str

    def at(self, place: str, found: str, sentence: str | None = None) -> Finding:
        """Return a finding at a place; its sentence is "place: found" by default."""
        text = f"{place}: {found}" if sentence is None else sentence
        return Finding(self.level, self.name, place, found, self.remedy, self.importers, text)

    def about(self, place: str, found: str) -> Finding:
        """Return a finding at a place, described by a whole sentence."""
        return self.at(place, found, found)


def _rules(levels: Mapping[str, Mapping[str, Mapping[str, str]]]) -> Mapping[str, Rule]:
    return {
        key: Rule(**{"name": key, "level": level, **facts})
        for level, rules in levels.items()
        for key, facts in rules.items()
    }


_TABLES = tomllib.loads(Path(__file__).with_name("rules.toml").read_text(encoding="utf-8"))
RULES = _rules(_TABLES["static"])
TRIAL_RULES = _rules(_TABLES["trials"])
EVERYWHERE: Mapping[str, str] = _TABLES["everywhere"]
