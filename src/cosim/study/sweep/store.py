"""The store of a sweep: one array per quantity, in memory or in a zarr folder, written by block."""

from __future__ import annotations

import json
import warnings
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.arrays import Vector
from cosim.errors import ExportError, UsageError
from cosim.host.optional_packages import optional_module
from cosim.host.temporary import temporary_folder
from cosim.integrate.ensemble.ensemble import unit_fact
from cosim.study.sweep.block import NOT_COMPUTED, STATES, Block
from cosim.study.sweep.folder import DIGEST_BYTES, MANIFEST, Folder, locked, writing
from cosim.study.sweep.reductions import Keep, Moments, Statistics, merged
from cosim.study.sweep.samples import Samples
from cosim.text import shortened
from cosim.trajectory import Column

if TYPE_CHECKING:
    import xarray as xr

_OF_RUNS = ("status", "reason", "steps", "reached", "blocks")  # which every store has
_STATISTICS = ("mean", "variance", "minimum", "maximum")  # of all runs
_MOMENTS = ("count", "mean", "squares", "low", "high")  # of each block
_BLOCKS = "blocks/"  # a group of the store for what concerns blocks; xarray does not show it
_DIGESTS = f"{_BLOCKS}digest"  # of the files of each finished block
_CHUNKED = ("run", "block")  # dimensions along which a chunk is a block
_SWEEP = "sweep"  # an attribute of the store: the manifest


@dataclass(frozen=True, eq=False)
class Layout:
    """Shape and meaning of the arrays of a sweep, fixed before its first run.

    Attributes:
        manifest: Facts that the results depend on; a sweep resumes only if they are the same.
        samples: The varied values.
        columns: The outputs.
        time: Output times, s.
        keep: The results to store.
        block: Runs that are computed and written together.
        of_rows: Whether the numbers of each run are those of its output times alone.
        units: Units of the varied values, by name.
    """

    manifest: Mapping[str, Any]
    samples: Samples
    columns: tuple[Column, ...]
    time: Vector
    keep: Keep
    block: int
    of_rows: bool = False
    units: Mapping[str, str] = field(default_factory=dict)

    def blocks(self) -> Iterator[tuple[int, int]]:
        """Yield first run and number of runs of each block."""
        for first in range(0, len(self.samples), self.block):
            yield first, min(self.block, len(self.samples) - first)

    @property
    def number_units(self) -> dict[str, str]:
        """Units of the numbers of each run, by name; users' functions have none."""
        units = {column.name: column.unit for column in self.columns}
        return {r.name: r.unit(units[r.variable]) for r in self.keep.reductions}

    @property
    def varied(self) -> dict[str, str]:
        """Array of each varied quantity, by name; another array may have the name itself."""
        taken = {*_OF_RUNS, *self.number_units}
        taken |= {column.name for column in self.columns if self.keep.trajectories}
        return self.samples.distinct_names(taken)

    def described(self) -> dict[str, Any]:
        """Return the manifest as a store holds it, in the types of JSON."""
        found: dict[str, Any] = json.loads(json.dumps({**self.manifest, "varied": self.varied}))
        return found


class Store:
    """The arrays of a sweep over the dimensions run, time, output and block.

    Args:
        layout: Their shape and meaning.
        folder: A zarr folder with a sweep (see `opened`); None for memory.
    """

    def __init__(self, layout: Layout, folder: Path | None = None) -> None:
        self.layout, self.folder = layout, folder
        self._files = None if folder is None else Folder(folder)
        self._arrays: Any = {} if self._files is None else self._files
        self._lengths = {
            "run": len(layout.samples),
            "time": len(layout.time),
            "output": len(layout.columns),
            "block": sum(1 for _ in layout.blocks()),
            "digest": DIGEST_BYTES,
        }
        self._variables: dict[str, tuple[tuple[str, ...], Mapping[str, Any]]] = {}
        self._moments: Moments | None = None  # of the first blocks
        self._waiting: dict[int, Moments | None] = {}  # of later blocks; None where stored
        self._merged = 0  # number of blocks in `_moments`
        self._add_all()
        self.numbers = [reduction.name for reduction in layout.keep.reductions]
        if self._files is not None:
            for name in sorted(self._files.names() - {"blocks", *self._variables}):
                self._add_numbers(name)

    @classmethod
    @contextmanager
    def opened(cls, layout: Layout, folder: Path, *, resume: bool) -> Iterator[Store]:
        """Yield a new sweep in a folder, or one that continues, as its only writer.

        Raises:
            UsageError: The folder holds something else, or another process writes to it.
            ExportError: It cannot be written.
        """
        if resume:
            _stored_manifest(folder)
        else:
            cls.created(layout, folder)
        with ExitStack() as held:
            with writing(folder):
                held.enter_context(locked(folder))
                store = cls.reopened(layout, folder)
            yield store

    @classmethod
    def created(cls, layout: Layout, folder: Path) -> Store:
        """Return a new sweep in a folder that is empty or does not exist.

        Raises:
            UsageError: The folder holds something.
            ExportError: It cannot be written.
        """
        try:
            if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
                raise UsageError(
                    f"{folder} exists already; continue it with resume=True (--resume), or name "
                    "another store"
                )
            folder.parent.mkdir(parents=True, exist_ok=True)
            with temporary_folder(folder.parent) as place:  # so that it is whole or not there
                store = cls(layout, place / "store")
                store._arrays.set_attributes(
                    {
                        "model": layout.manifest["model"],
                        "coordinates": " ".join(layout.varied.values()),  # xarray reads this
                        _SWEEP: json.dumps(layout.described()),
                    }
                )
                if folder.exists():
                    folder.rmdir()
                (place / "store").rename(folder)
        except (OSError, ExportError) as error:
            reason = error.__cause__ or error  # without the temporary folder
            reason = getattr(reason, "strerror", None) or reason
            raise ExportError(f"cannot create {folder}: {reason}") from error
        return cls(layout, folder)

    @classmethod
    def reopened(cls, layout: Layout, folder: Path) -> Store:
        """Return the store of a sweep that continues; damaged blocks count as not computed.

        Raises:
            UsageError: The folder holds no sweep, or another one.
        """
        found, now = _stored_manifest(folder), layout.described()
        for name in sorted({*now, *found}):
            if now.get(name) != found.get(name):
                raise UsageError(
                    f"{folder} holds another sweep: its {name} is {found.get(name)!r}, now "
                    f"{now.get(name)!r}; resume with the same, or name another store"
                )
        store = cls(layout, folder)
        store._remove_unfinished()
        if layout.keep.statistics:
            store._waiting = {first // layout.block: None for first, _ in store.finished()}
            store._merge()
        return store

    def finished(self) -> list[tuple[int, int]]:
        """Return first run and number of runs of each block that is stored completely."""
        blocks = [*self.layout.blocks()]
        if self._files is None:
            left = self["status"] == NOT_COMPUTED
            return [(first, n) for first, n in blocks if not left[first : first + n].any()]
        whole = self[_DIGESTS].any(axis=1)
        return [part for part, is_whole in zip(blocks, whole, strict=True) if is_whole]

    def write(self, block: Block) -> None:
        """Store a block; the digest of its files comes last and marks it as finished.

        Raises:
            ExportError: The disk is full, or the folder cannot be written.
        """
        with writing(self.folder):
            self._write(block)

    def finish(self) -> None:
        """Store the statistics over all runs.

        Raises:
            ExportError: As for `write`.
        """
        if (statistics := self.statistics()) is None:
            return
        with writing(self.folder):
            for output in self.layout.columns:
                for kind in _STATISTICS:
                    place = f"{output.name}_over_runs_{kind}"
                    self._arrays[place][:] = getattr(statistics, kind)(output.name)

    def statistics(self) -> Statistics | None:
        """Return the statistics over the blocks that are stored."""
        found = self._moments
        for block in sorted(self._waiting):  # those behind a gap
            moments = self._waiting[block] or self._stored_moments(block)
            found = moments if found is None else merged(found, moments)
        if found is None:
            return None
        return Statistics(tuple(column.name for column in self.layout.columns), found)

    def __getitem__(self, name: str) -> Any:
        """Return a whole array."""
        return self.read(name)

    def read(self, name: str, part: int | slice = slice(None)) -> Vector:
        """Return a part of an array along its first dimension, e.g. one run, (times,)."""
        if self._files is None:
            return np.asarray(self._arrays[name][part])
        return self._files.read(name, part)

    def to_xarray(self) -> xr.Dataset:
        """Return everything as a dataset; of a folder, its arrays are read when they are used."""
        xarray = optional_module("xarray", "sweep")
        if self.folder is not None:
            stored: xr.Dataset = xarray.open_zarr(self.folder, consolidated=False)
            return stored
        variables = {
            name: (dimensions, self._arrays[name], dict(attributes))
            for name, (dimensions, attributes) in self._variables.items()
            if not name.startswith(_BLOCKS)
        }
        facts = {"model": self.layout.manifest["model"]}
        dataset: xr.Dataset = xarray.Dataset(variables, attrs=facts)
        return dataset.set_coords([*self.layout.varied.values()])

    def _add_all(self) -> None:
        """Add every array except those of users' functions, whose names only the runs report."""
        layout, run = self.layout, ("run",)
        flags = {"flag_values": list(range(len(STATES))), "flag_meanings": " ".join(STATES)}
        self._add("time", ("time",), layout.time, {"units": "s"})
        for name, column in layout.samples.columns.items():
            self._add(layout.varied[name], run, column, unit_fact(layout.units, name))
        self._add("status", run, np.int8(NOT_COMPUTED), flags)
        self._add("reason", run, "", {"long_name": "why a run is not complete"})
        self._add("steps", run, 0, {"long_name": "steps of the solver"})
        self._add("reached", run, 0, {"long_name": "valid output times"})
        for reduction in layout.keep.reductions:
            of_rows = " of the rows" if reduction.of_motion and layout.of_rows else ""
            facts = {"long_name": reduction.meaning + of_rows}
            facts |= unit_fact(layout.number_units, reduction.name)
            self._add(reduction.name, run, np.nan, facts)
        for output in layout.columns:
            if layout.keep.trajectories:
                self._add(output.name, ("run", "time"), np.nan, output.facts)
            for kind in _STATISTICS if layout.keep.statistics else ():
                self._add(f"{output.name}_over_runs_{kind}", ("time",), np.nan, output.facts)
        if self.folder is None:
            return
        self._add(_DIGESTS, ("block", "digest"), np.uint8(0), {"long_name": "SHA-256 of the files"})
        for kind in _MOMENTS if layout.keep.statistics else ():
            self._add(f"{_BLOCKS}{kind}", ("block", "time", "output"), np.nan, {})

    def _add(
        self, name: str, dimensions: tuple[str, ...], content: Any, attributes: Mapping[str, Any]
    ) -> None:
        """Add an array with a content, or with one number for every entry that is not computed."""
        if name in (*self._variables, "blocks"):
            raise UsageError(
                f"sweep: an output cannot be kept under the name '{name}', which another result "
                "has; rename it, or leave it out of outputs"
            )
        own = self._files is None or dimensions[0] == "block" or self._files.can_hold(name)
        if not own:
            raise UsageError(
                f"sweep: '{name}' cannot be the name of a folder of its own, in which a store "
                "keeps each result; rename it, leave it out, or leave out store (--store)"
            )
        self._variables[name] = dimensions, attributes
        shape = tuple(self._lengths[dimension] for dimension in dimensions)
        if self._files is None:
            kind: Any = object if isinstance(content, str) else np.asarray(content).dtype
            single = np.ndim(content) == 0
            self._arrays[name] = np.full(shape, content, kind) if single else np.array(content)
            return
        pieces = dict(zip(_CHUNKED, (self.layout.block, 1), strict=True))
        chunks = tuple(min(pieces.get(d, n), n) for d, n in zip(dimensions, shape, strict=True))
        self._files.add(name, shape, chunks, dimensions, content, attributes)

    def _add_numbers(self, name: str) -> None:
        """Add the array of a number that a user's function returns."""
        self._add(name, ("run",), np.nan, {})
        self.numbers.append(name)

    @property
    def taken(self) -> frozenset[str]:
        """Names that the number of a user's function cannot have."""
        return frozenset({"run", "blocks", *self._variables} - {*self.numbers})

    def _in_blocks(self) -> list[str]:
        """Return the arrays of results whose chunks are blocks."""
        others = {_DIGESTS, *self.layout.varied.values()}
        in_blocks = [
            n for n, (dimensions, _) in self._variables.items() if dimensions[0] in _CHUNKED
        ]
        return [name for name in in_blocks if name not in others]

    def _remove_unfinished(self) -> None:
        """Remove what an interrupted process has left, and blocks that were changed since."""
        assert self._files is not None
        self._files.remove_partial_files()
        names, damaged = self._in_blocks(), list[str]()
        for number, (first, count) in enumerate(self.layout.blocks()):
            try:
                stored = self._files.read(_DIGESTS, number).tobytes()
            except UsageError:  # the digest itself is damaged
                stored = b"damaged"
            if stored == self._files.digest(names, number):
                continue
            if any(stored):
                damaged.append(f"{first} to {first + count - 1}")
            self._files.remove([*names, _DIGESTS], number)
        if damaged:
            warnings.warn(
                f"{self.folder}: the stored results of the runs {shortened(damaged, 6)} were "
                "damaged; these runs are computed again",
                RuntimeWarning,
                stacklevel=2,
            )

    def _write(self, block: Block) -> None:
        part = slice(block.first, block.first + len(block))
        for name, column in block.numbers.items():
            if name not in self.numbers:
                self._add_numbers(name)
            self._arrays[name][part] = column
        if block.values is not None:
            for i, output in enumerate(self.layout.columns):
                self._arrays[output.name][part] = block.values[:, :, i]
        number = block.first // self.layout.block
        if block.moments is not None:
            self._add_moments(number, block.moments)
        texts = [block.reasons.get(run, "") for run in range(part.start, part.stop)]
        self._arrays["reason"][part] = np.array(texts, dtype=object)
        self._arrays["steps"][part] = block.steps
        self._arrays["reached"][part] = block.reached
        self._arrays["status"][part] = block.states
        if self._files is not None:
            digest = self._files.digest(self._in_blocks(), number)
            self._files[_DIGESTS][number] = np.frombuffer(digest, dtype=np.uint8)

    def _add_moments(self, block: int, moments: Moments) -> None:
        if self.folder is None:
            self._waiting[block] = moments
        else:
            for kind in _MOMENTS:
                self._arrays[_BLOCKS + kind][block] = getattr(moments, kind)
            self._waiting[block] = None
        self._merge()

    def _merge(self) -> None:
        """Merge the moments in the order of the blocks, which makes the bits independent of it."""
        while self._merged in self._waiting:
            block, self._merged = self._merged, self._merged + 1
            moments = self._waiting.pop(block) or self._stored_moments(block)
            self._moments = moments if self._moments is None else merged(self._moments, moments)

    def _stored_moments(self, block: int) -> Moments:
        tables = (self.read(_BLOCKS + kind, block) for kind in _MOMENTS)
        return Moments(*tables)


def stored_samples(folder: Path) -> Samples:
    """Return the samples of a stored sweep.

    Raises:
        UsageError: The folder holds no sweep.
    """
    manifest = _stored_manifest(folder)
    files = Folder(folder)
    try:
        columns = {name: files.read(place) for name, place in manifest["varied"].items()}
        samples = Samples(columns, manifest["samples"])
        whole = samples.digest == manifest["samples_digest"]
    except (KeyError, ValueError, TypeError, UsageError):  # of a description of an array
        whole = False
    if not whole:
        raise UsageError(
            f"{folder}: the stored samples are damaged; name them again "
            "(--samples, --design or -p) with resume=True (--resume)"
        )
    return samples


def _stored_manifest(folder: Path) -> dict[str, Any]:
    try:
        attributes = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))["attributes"]
        found: dict[str, Any] = json.loads(attributes[_SWEEP])
    except (OSError, ValueError, KeyError, TypeError) as error:
        why = getattr(error, "strerror", None) or error
        raise UsageError(f"{folder} holds no sweep ({why}); begin one without resume") from error
    return found
