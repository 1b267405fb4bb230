"""One run of a configuration as plain values, and the file in which runs survive."""

import json
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from cosim.errors import CosimError, ExportError
from cosim.files import write_atomically
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

    def read(self) -> list[Event]:
        """Return the runs that it holds."""
        return list(self._events())

    def facts(self) -> dict[str, Any]:
        """Return what was kept beside the runs; nothing where that is not whole."""
        for facts in self._lines():
            if "facts" in facts and facts["runs"] == len(self.read()):
                return dict(facts["facts"])
        return {}

    def replace(self, events: Iterable[Event], facts: Mapping[str, Any]) -> None:
        """Write runs and what belongs to all of them, whole or not at all.

        Raises:
            OSError, ExportError: The file cannot be written.
        """
        rows: list[dict[str, Any]] = [asdict(event) for event in events]
        rows = [{"facts": dict(facts), "runs": len(rows)}, *rows]
        self.path.parent.mkdir(parents=True, exist_ok=True)
        text = "".join(json.dumps({"key": self.key} | row) + "\n" for row in rows)
        write_atomically(self.path, text.encode())

    def begin(self, *, resume: bool) -> list[Event]:
        """Open the record; return the runs it holds already, none unless resumed.

        Raises:
            ExportError: The file cannot be written.
        """
        kept = self.read() if resume else []
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with self.path.open("a" if kept else "w", encoding="utf-8") as stream:
                stream.write("\n" if kept else "")  # ends a line that an interruption cut
        except OSError as error:
            raise ExportError(f"cannot keep results in {self.path}: {error.strerror}") from error
        return kept

    def append(self, event: Event) -> None:
        """Add a run; it is on the disk when this returns."""
        with self.path.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps({"key": self.key} | asdict(event)) + "\n")
            stream.flush()
            os.fsync(stream.fileno())

    def _events(self) -> Iterator[Event]:
        for facts in self._lines():
            try:
                configuration = Configuration(**facts["configuration"])
                outcome = Outcome(**facts["outcome"])
                yield Event(**facts | {"configuration": configuration, "outcome": outcome})
            except (CosimError, KeyError, TypeError):
                continue  # of another version, or no run

    def _lines(self) -> Iterator[dict[str, Any]]:
        try:
            lines = self.path.read_text(encoding="utf-8").splitlines()
        except (OSError, UnicodeDecodeError):
            return
        for line in lines:
            try:
                facts = json.loads(line)
                if facts.pop("key") == self.key:
                    yield facts
            except (ValueError, KeyError, TypeError, AttributeError):
                continue  # cut off by an interruption
