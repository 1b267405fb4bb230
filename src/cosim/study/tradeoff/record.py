"""One run of a configuration as plain values, and the file in which they survive."""

import json
import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, TextIO

from cosim.errors import ExportError
from cosim.study.tradeoff.configuration import Configuration


@dataclass(frozen=True)
class Event:
    """What one run of a configuration took, and how far it was off.

    Attributes:
        configuration: What ran.
        status: "complete", or why there is no result.
        errors: Largest global error by name, in nominal values.
        drift: Largest change of what the reference keeps constant, in nominal values, by name.
        rhs_calls, jacobian_calls, steps: Counts; None where the road does not tell.
        points: Output times that were compared.
        solver_time, total_time: s; of the integration alone, and with everything around it.
    """

    configuration: Configuration
    status: str = "complete"
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

    def begin(self, *, resume: bool) -> list[Event]:
        """Open the record; return the runs it holds already, none unless resumed.

        Raises:
            ExportError: The file cannot be written.
        """
        kept = list(self._events()) if resume else []
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
            _write(stream, {"key": self.key, **asdict(event)})

    def _events(self) -> Iterator[Event]:
        try:
            lines = self.path.read_text(encoding="utf-8").splitlines()
        except (OSError, UnicodeDecodeError):
            return
        for line in lines:
            try:
                facts = json.loads(line)
                if facts.pop("key") == self.key:
                    configuration = Configuration(**facts.pop("configuration"))
                    yield Event(configuration, **facts)
            except (ValueError, KeyError, TypeError, AttributeError):
                continue  # cut off by an interruption


def _write(stream: TextIO, facts: dict[str, Any]) -> None:
    stream.write(json.dumps(facts) + "\n")
    stream.flush()
    os.fsync(stream.fileno())
