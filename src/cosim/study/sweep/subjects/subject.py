"""What is swept, as a value that goes with every task, and what it can do once it is open."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from cosim.arrays import Vector
from cosim.integrate.ensemble.ensemble import Ensemble
from cosim.study.sweep.store import Watch
from cosim.trajectory import Column


@dataclass(frozen=True)
class Subject:
    """What is swept, small enough to go with every task.

    Attributes:
        kind: "model", "dae", "scene" or "fmu".
        source: The model's name, the file's absolute path, or a `Dae` as bytes.
    """

    kind: str
    source: str | bytes


@dataclass(frozen=True, eq=False)  # arrays have no single truth value
class Rows:
    """Runs to be computed together.

    Attributes:
        given: Values by name, one per run, (runs,).
        outputs: What is recorded.
        settings: Of the runs, by the names of `simulate_many`.
        threads: Of this process.
    """

    given: Mapping[str, Vector]
    outputs: Sequence[str]
    settings: Mapping[str, Any]
    threads: int = 1

    def __len__(self) -> int:
        return len(next(iter(self.given.values())))


class Opened(Protocol):
    """A subject that is ready to run."""

    name: str
    digest: str

    def columns(self, outputs: Sequence[str] | None) -> tuple[Column, ...]:
        """Return what is recorded."""

    def unit(self, name: str) -> str | None:
        """Return the unit of what can be varied; None where numbers have none to be read."""

    def prepare(self, names: Sequence[str], settings: Mapping[str, Any]) -> str:
        """Refuse names that cannot be set, compile; say how the runs are computed."""

    def run(self, rows: Rows, watch: Watch) -> Ensemble:
        """Run every row; `watch` is told which one begins, where they go one by one."""
