"""The folder of a sweep: manifest and samples first, then a file per chunk, whole or not there."""

import io
import json
import os
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.arrays import Vector
from cosim.errors import ExportError, UsageError
from cosim.files import write_atomically
from cosim.integrate.ensemble.ensemble import RunState
from cosim.study.sweep.samples import Samples, read_samples
from cosim.study.sweep.statistics import Node, Sketch

Watch = Callable[[int], None]  # is told which run begins
STATES = tuple(RunState)  # a state is stored as its position here
_CHUNK = re.compile(r"(\d+)-(\d+)\.npz")
_NODE = ("count", "mean", "squares", "low", "high")


@dataclass(frozen=True, eq=False)
class ChunkRecord:
    """What is kept of consecutive runs.

    Attributes:
        first: Position of the first run.
        time: Output times, s; empty where nothing ran.
        states, steps, reached: Of each run: position in `STATES`, steps, good output times.
        reasons: Why, by position in the sweep, where a run is not complete or left the limits.
        numbers: By name, (runs,).
        values: (runs, times, columns), where trajectories are kept.
        node, sketch: Where statistics are kept.
    """

    first: int
    time: Vector
    states: NDArray[np.int8]
    steps: NDArray[np.int64]
    reached: NDArray[np.int64]
    reasons: Mapping[int, str]
    numbers: Mapping[str, Vector]
    values: Vector | None = None
    node: Node | None = None
    sketch: Sketch | None = None

    def __len__(self) -> int:
        return len(self.states)


class Store:
    """A folder that holds a sweep.

    Args:
        folder: Its place; see `create` and `reopen`.
    """

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.folder = Path(folder)
        self.chunks = self.folder / "chunks"

    def create(self, manifest: Mapping[str, Any], samples: Samples) -> None:
        """Begin a sweep in a folder that is empty or not there.

        Raises:
            UsageError: Something is there.
            ExportError: It cannot be written.
        """
        if self.folder.exists() and (not self.folder.is_dir() or any(self.folder.iterdir())):
            raise UsageError(
                f"{self.folder} is there already; go on with resume (--resume), or name another"
            )
        try:
            self.chunks.mkdir(parents=True)
        except OSError as error:
            raise ExportError(f"cannot create {self.folder}: {error.strerror or error}") from error
        samples.to_csv(self.folder / "samples.csv")
        text = json.dumps(manifest, indent=1, sort_keys=True) + "\n"
        write_atomically(self.folder / "manifest.json", text.encode())

    def reopen(self, manifest: Mapping[str, Any]) -> None:
        """Go on with a sweep.

        Raises:
            UsageError: There is none, or another one.
        """
        found = self.manifest()
        for name in sorted({*manifest, *found}):
            if manifest.get(name) != found.get(name):
                raise UsageError(
                    f"{self.folder} holds another sweep: its {name} is {found.get(name)!r}, now "
                    f"{manifest.get(name)!r}; resume with the same, or name another store"
                )
        for left in self.chunks.glob(".*"):  # of writers that were killed
            left.unlink(missing_ok=True)

    def manifest(self) -> dict[str, Any]:
        """Return the manifest.

        Raises:
            UsageError: There is no sweep.
        """
        try:
            text = (self.folder / "manifest.json").read_text(encoding="utf-8")
            found: dict[str, Any] = json.loads(text)
        except (OSError, ValueError) as error:
            raise UsageError(f"{self.folder} holds no sweep ({error}); begin one there") from error
        return found

    def samples(self) -> Samples:
        """Return what is varied."""
        found = self.manifest()
        columns = read_samples(self.folder / "samples.csv").columns
        return Samples(columns, found["samples"], found["problem"])

    def finished(self) -> list[tuple[int, int]]:
        """Return first run and number of runs of every chunk, in order."""
        matches = (_CHUNK.fullmatch(path.name) for path in self.chunks.iterdir())
        return sorted((int(match[1]), int(match[2])) for match in matches if match)

    def write(self, record: ChunkRecord) -> None:
        """Write a chunk."""
        arrays: dict[str, Any] = {
            "time": record.time,
            "states": record.states,
            "steps": record.steps,
            "reached": record.reached,
            "reasons": np.array(json.dumps({str(i): text for i, text in record.reasons.items()})),
            "names": np.array(json.dumps(list(record.numbers))),
        }
        if record.numbers:
            arrays["numbers"] = np.column_stack([*record.numbers.values()])
        if record.values is not None:
            arrays["values"] = record.values
        if record.node is not None and record.sketch is not None:
            arrays |= {f"node_{name}": getattr(record.node, name) for name in _NODE}
            arrays["size"] = np.array(record.node.size)
            arrays |= {"codes": record.sketch.codes, "counts": record.sketch.counts}
        stream = io.BytesIO()
        np.savez(stream, **arrays)
        write_atomically(self._path(record.first, len(record), "npz"), stream.getvalue())

    def read(self, first: int, count: int) -> ChunkRecord:
        """Read a chunk."""
        with np.load(self._path(first, count, "npz")) as found:
            names = json.loads(str(found["names"]))
            table = found["numbers"] if names else np.empty((count, 0))
            node = sketch = None
            if "size" in found:
                parts = (found[f"node_{name}"] for name in _NODE)
                node = Node(first, int(found["size"]), *parts)
                sketch = Sketch(found["codes"], found["counts"])
            reasons = json.loads(str(found["reasons"]))
            return ChunkRecord(
                first,
                found["time"],
                found["states"],
                found["steps"],
                found["reached"],
                {int(i): text for i, text in reasons.items()},
                dict(zip(names, table.T, strict=True)),
                found["values"] if "values" in found.files else None,
                node,
                sketch,
            )

    def records(self) -> Iterator[ChunkRecord]:
        """Read every chunk, in order."""
        for first, count in self.finished():
            yield self.read(first, count)

    @contextmanager
    def watching(self, first: int, count: int) -> Iterator[Watch]:
        """Yield what notes, for the case that this process dies, which run has begun."""
        path = self._path(first, count, "at")
        with path.open("wb", buffering=0) as stream:

            def watch(position: int) -> None:
                stream.seek(0)
                stream.write((first + position).to_bytes(8, "little"))

            yield watch
        path.unlink(missing_ok=True)

    def last_begun(self, first: int, count: int) -> tuple[bool, int | None]:
        """Tell whether a chunk had begun when its process died, and at which run, if noted."""
        path = self._path(first, count, "at")
        try:
            content = path.read_bytes()
            path.unlink(missing_ok=True)
        except OSError:
            return False, None
        return True, int.from_bytes(content, "little") if len(content) == 8 else None

    def has(self, first: int, count: int) -> bool:
        """Tell whether a chunk is finished."""
        return self._path(first, count, "npz").exists()

    def _path(self, first: int, count: int, suffix: str) -> Path:
        return self.chunks / f"{first:09d}-{count}.{suffix}"
