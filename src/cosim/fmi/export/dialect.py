"""`Dialect`: what the versions of FMI write differently in modelDescription.xml."""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Dialect:
    """A version of FMI, as `model_description.toml` describes it.

    Attributes:
        version: Of FMI, e.g. "2.0".
        token: Attribute of the GUID or instantiation token.
        nested: Whether the type of a variable is an element of its own.
        types_apart: Whether the value references of each type begin at 0.
        fixed_are_knowns: Whether dependencies include fixed parameters.
        real, real_type: Tags of a real variable and of a declared type of real variables.
        annotation: Tag of an annotation, and its attribute for the name of the tool.
        sections: Tags of outputs, derivatives, initial unknowns and, if supported, indicators.
        unknown: Tag of an unknown within its section; empty if each unknown has the section's tag.
        reference: Attribute that identifies the variable of an unknown.
        first: Number of the first variable.
        both, co_simulation: Constant attributes of both interfaces, and of co-simulation.
    """

    version: str
    token: str
    nested: bool
    types_apart: bool
    fixed_are_knowns: bool
    real: str
    real_type: str
    annotation: Sequence[str]
    sections: Sequence[str]
    unknown: str
    reference: str
    first: int
    both: Mapping[str, str]
    co_simulation: Mapping[str, str]


_TABLES = tomllib.loads(
    Path(__file__).with_name("model_description.toml").read_text(encoding="utf-8")
)
QUANTITIES: Mapping[str, str] = _TABLES["quantities"]
LOG_CATEGORIES: Mapping[str, str] = _TABLES["log_categories"]
DIALECTS = {2: Dialect(**_TABLES["fmi2"]), 3: Dialect(**_TABLES["fmi3"])}
