"""The store of a sweep: one array per quantity, in memory or in a zarr folder, written by block."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.arrays import Vector
from cosim.errors import ExportError, UsageError
from cosim.host.optional_packages import optional_module
from cosim.host.temporary import temporary_folder
from cosim.study.sweep.block import NOT_COMPUTED, STATES, Block
from cosim.study.sweep.reductions import Keep, Moments, Statistics, merged
from cosim.study.sweep.samples import Samples
from cosim.trajectory import Column

if TYPE_CHECKING:
    import xarray as xr

_STATISTICS = ("mean", "variance", "minimum", "maximum")  # of all runs
_MOMENTS = ("count", "mean", "squares", "low", "high")  # of each block
_BLOCKS = "blocks/"  # a group of the store for them; xarray does not show it
_MANIFEST = "sweep"  # an attribute of the store


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
    """

    manifest: Mapping[str, Any]
    samples: Samples
    columns: tuple[Column, ...]
    time: Vector
    keep: Keep
    block: int

    def blocks(self) -> Iterator[tuple[int, int]]:
        """Yield first run and number of runs of each block."""
        for first in range(0, len(self.samples), self.block):
            yield first, min(self.block, len(self.samples) - first)

    @property
    def varied(self) -> dict[str, str]:
        """Array of each varied quantity, by name; a trajectory may have the name itself."""
        taken = {column.name for column in self.columns} if self.keep.trajectories else set()
        return {n: f"{n}_start" if n in taken else n for n in self.samples.columns}

    def described(self) -> dict[str, Any]:
        """Return the manifest as a store holds it, in the types of JSON."""
        found: dict[str, Any] = json.loads(json.dumps({**self.manifest, "varied": self.varied}))
        return found


class Store:
    """The arrays of a sweep over the dimensions run, time, output and block.

    Args:
        layout: Their shape and meaning.
        folder: A zarr folder with a sweep (see `created`, `reopened`); None for memory.
    """

    def __init__(self, layout: Layout, folder: Path | None = None) -> None:
        self.layout, self.folder = layout, folder
        self._arrays: Any = {}
        if folder is not None:
            self._arrays = optional_module("zarr", "sweep").open_group(folder, mode="a")
        self._lengths = {
            "run": len(layout.samples),
            "time": len(layout.time),
            "output": len(layout.columns),
            "block": sum(1 for _ in layout.blocks()),
        }
        self._variables: dict[str, tuple[tuple[str, ...], Mapping[str, Any]]] = {}
        self._moments: Moments | None = None  # of the first blocks
        self._waiting: dict[int, Moments | None] = {}  # of later blocks; None where stored
        self._merged = 0  # number of blocks in `_moments`
        self._add_all()
        self.numbers = [reduction.name for reduction in layout.keep.reductions]
        self.numbers += sorted(set(self._arrays) - {"blocks", *self._variables})

    @classmethod
    def created(cls, layout: Layout, folder: Path) -> Store:
        """Return a new sweep in a folder that is empty or does not exist.

        Raises:
            UsageError: The folder holds something.
            ExportError: It cannot be written.
        """
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise UsageError(
                f"{folder} exists already; continue it with resume=True (--resume), or name "
                "another store"
            )
        try:
            folder.parent.mkdir(parents=True, exist_ok=True)
            with temporary_folder(folder.parent) as place:  # so that it is whole or not there
                store = cls(layout, place / "store")
                store._arrays.attrs.update(
                    {
                        "model": layout.manifest["model"],
                        "coordinates": " ".join(layout.varied.values()),  # xarray reads this
                        _MANIFEST: json.dumps(layout.described()),
                    }
                )
                if folder.exists():
                    folder.rmdir()
                (place / "store").rename(folder)
        except OSError as error:
            raise ExportError(f"cannot create {folder}: {error.strerror or error}") from error
        return cls(layout, folder)

    @classmethod
    def reopened(cls, layout: Layout, folder: Path) -> Store:
        """Return the store of a sweep that continues.

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
        for left in folder.rglob("*.partial"):  # of a process that was killed while it wrote
            left.unlink(missing_ok=True)
        store = cls(layout, folder)
        if layout.keep.statistics:
            store._waiting = {first // layout.block: None for first, _ in store.finished()}
            store._merge()
        return store

    def finished(self) -> list[tuple[int, int]]:
        """Return first run and number of runs of each block that is stored."""
        left = self["status"] == NOT_COMPUTED
        return [
            (first, n) for first, n in self.layout.blocks() if not left[first : first + n].any()
        ]

    def write(self, block: Block) -> None:
        """Store a block; its status comes last and marks it as finished."""
        part = slice(block.first, block.first + len(block))
        for name, column in block.numbers.items():
            if name not in self.numbers:
                self._add(name, ("run",), np.nan, {})
                self.numbers.append(name)
            self._arrays[name][part] = column
        if block.values is not None:
            for i, output in enumerate(self.layout.columns):
                self._arrays[output.name][part] = block.values[:, :, i]
        if block.moments is not None:
            self._add_moments(block.first // self.layout.block, block.moments)
        texts = [block.reasons.get(run, "") for run in range(part.start, part.stop)]
        self._arrays["reason"][part] = np.array(texts, dtype=object)
        self._arrays["steps"][part] = block.steps
        self._arrays["reached"][part] = block.reached
        self._arrays["status"][part] = block.states

    def finish(self) -> None:
        """Store the statistics over all runs."""
        if (statistics := self.statistics()) is None:
            return
        for output in self.layout.columns:
            for kind in _STATISTICS:
                self._arrays[f"{output.name}_over_runs_{kind}"][:] = getattr(statistics, kind)(
                    output.name
                )

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
        return np.asarray(self._arrays[name][:])

    def row(self, name: str, run: int) -> Vector:
        """Return one run of an array, (times,)."""
        return np.asarray(self._arrays[name][run])

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
            self._add(layout.varied[name], run, column, {})
        self._add("status", run, np.int8(NOT_COMPUTED), flags)
        self._add("reason", run, "", {"long_name": "why a run is not complete"})
        self._add("steps", run, 0, {"long_name": "steps of the solver"})
        self._add("reached", run, 0, {"long_name": "valid output times"})
        for reduction in layout.keep.reductions:
            self._add(reduction.name, run, np.nan, {"long_name": reduction.meaning})
        for output in layout.columns:
            if layout.keep.trajectories:
                self._add(output.name, ("run", "time"), np.nan, output.facts)
            for kind in _STATISTICS if layout.keep.statistics else ():
                self._add(f"{output.name}_over_runs_{kind}", ("time",), np.nan, output.facts)
        if layout.keep.statistics and self.folder is not None:
            for kind in _MOMENTS:
                self._add(f"{_BLOCKS}{kind}", ("block", "time", "output"), np.nan, {})

    def _add(
        self, name: str, dimensions: tuple[str, ...], content: Any, attributes: Mapping[str, Any]
    ) -> None:
        """Add an array with a content, or with one number for every entry that is not computed."""
        self._variables[name] = dimensions, attributes
        if name in self._arrays:
            return
        shape = tuple(self._lengths[dimension] for dimension in dimensions)
        single = np.ndim(content) == 0
        kind: Any = str if isinstance(content, str) else np.asarray(content).dtype
        if self.folder is None:
            filled = np.full(shape, content, dtype=object if kind is str else kind)
            self._arrays[name] = filled if single else np.array(content)
            return
        pieces = {"run": self.layout.block, "block": 1}
        array = self._arrays.create_array(
            name,
            shape=shape,
            chunks=tuple(min(pieces.get(d, n), n) for d, n in zip(dimensions, shape, strict=True)),
            dtype=kind,
            fill_value=content if single else 0,
            dimension_names=dimensions,
            attributes=dict(attributes),
        )
        if not single:
            array[:] = content

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
        tables = (np.asarray(self._arrays[_BLOCKS + kind][block]) for kind in _MOMENTS)
        return Moments(*tables)


def stored_samples(folder: Path) -> Samples:
    """Return the samples of a stored sweep.

    Raises:
        UsageError: The folder holds no sweep.
    """
    manifest = _stored_manifest(folder)
    arrays = optional_module("zarr", "sweep").open_group(folder, mode="r")
    columns = {name: np.asarray(arrays[place][:]) for name, place in manifest["varied"].items()}
    return Samples(columns, manifest["samples"])


def _stored_manifest(folder: Path) -> dict[str, Any]:
    try:
        attributes = json.loads((folder / "zarr.json").read_text(encoding="utf-8"))["attributes"]
        found: dict[str, Any] = json.loads(attributes[_MANIFEST])
    except (OSError, ValueError, KeyError) as error:
        raise UsageError(f"{folder} holds no sweep ({error}); begin one without resume") from error
    return found
