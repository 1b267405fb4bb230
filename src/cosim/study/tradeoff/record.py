"""One run of a configuration as plain values, and the file in which runs survive."""

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from cosim.codegen.cache import plain_file
from cosim.errors import ExportError
from cosim.study.tradeoff.configuration import Configuration

COMPLETE, LEFT_OUT = "complete", "left out"


@dataclass(frozen=True)
class Outcome:
    """How a run ended.

    Attributes:
        kind: "complete", "left out", or the type of the error.
        reason: Why there is no result.
    """

    kind: str = COMPLETE
    reason: str = ""

    def __str__(self) -> str:
        return f"{self.kind}: {self.reason}" if self.reason else self.kind


@dataclass(frozen=True)
class Event:
    """What one run of a configuration took, and how far it was off.

    Attributes:
        configuration: What ran.
        outcome: How the run ended.
        errors: Largest global error by name, in nominal values.
        drift: Largest change of what the reference keeps constant, in nominal values, by name.
        rhs_calls, jacobian_calls, steps: Counts; None where the road does not tell.
        points: Output times that were compared.
        solver_time, total_time: s; of the integration alone, and with everything around it.
    """

    configuration: Configuration
    outcome: Outcome = Outcome()
    errors: dict[str, float] = field(default_factory=dict)
    drift: dict[str, float] = field(default_factory=dict)
    rhs_calls: int | None = None
    jacobian_calls: int | None = None
    steps: int | None = None
    points: int = 0
    solver_time: float | None = None
    total_time: float | None = None

    @classmethod
    def of(cls, facts: Mapping[str, Any]) -> "Event":
        """Return a run from its plain values (`asdict`).

        Raises:
            KeyError, TypeError: They are of another version.
        """
        configuration = Configuration(**facts["configuration"])
        outcome = Outcome(**facts["outcome"])
        return cls(**{**facts, "configuration": configuration, "outcome": outcome})

    @property
    def run_time(self) -> float:
        """Time of the integration as far as it is known, without what was compiled for it, s."""
        return self.solver_time or 0.0


@dataclass(frozen=True)
class Record:
    """Runs in a file of JSON lines, which is appended to and never rewritten.

    Attributes:
        path: The file.
        key: Hash of what was measured; lines of another one do not count.
    """

    path: Path
    key: str

    def begin(self, *, resume: bool) -> list[Event]:
        """Open the record; return the runs it holds already, none unless resumed.

        Raises:
            ExportError: The file cannot be written.
        """
        kept = list(self._events()) if resume else []
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            if not kept:
                self.path.unlink(missing_ok=True)
            with self.path.open("a" if kept else "x", encoding="utf-8") as stream:
                stream.write("\n" if kept else "")  # ends a line that an interruption cut
        except OSError as error:
            raise ExportError(f"cannot keep results in {self.path}: {error.strerror}") from error
        return kept

    def append(self, event: Event) -> None:
        """Add a run; it is on the disk when this returns."""
        with self.path.open("a", encoding="utf-8") as stream:
            facts = {"key": self.key} | asdict(event)
            stream.write(json.dumps({**facts, "sha256": _facts_checksum(facts)}) + "\n")
            stream.flush()
            os.fsync(stream.fileno())

    def _events(self) -> Iterator[Event]:
        for line in (plain_file(self.path) or b"").split(b"\n"):
            try:
                facts = json.loads(line)
                checksum = facts.pop("sha256")
                if checksum == _facts_checksum(facts) and facts.pop("key") == self.key:
                    yield Event.of(facts)
            except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
                continue  # cut off by an interruption, or damaged


def _facts_checksum(facts: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(facts).encode()).hexdigest()
