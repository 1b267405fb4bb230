"""One thing to be said of an FMU."""

from dataclasses import asdict, dataclass
from typing import Any

WRONG, ADVICE = "wrong", "advice"


@dataclass(frozen=True)
class Finding:
    """Something about an FMU.

    Attributes:
        level: "wrong" where the FMI is broken or a run fails, else "advice".
        rule: A short name, the same for all findings of a kind.
        place: File within the FMU, variable or interface.
        found: What is there.
        cure: What its author can do.
    """

    level: str
    rule: str
    place: str
    found: str
    cure: str

    def row(self) -> dict[str, Any]:
        """Return the finding as a line of a table."""
        return asdict(self)
