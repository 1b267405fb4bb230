"""The zarr folder of a stored sweep: its arrays, the digests of its blocks and its lock."""

import hashlib
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from cosim.arrays import Vector
from cosim.errors import ExportError, UsageError
from cosim.files import write_atomically
from cosim.host.locks import exclusive
from cosim.host.optional_packages import optional_module

MANIFEST = "zarr.json"  # of the store and of each array, as zarr names it
DIGEST_BYTES = 32  # of SHA-256


class Folder:
    """The arrays of a zarr folder whose chunks are blocks of runs, each with a checksum.

    Args:
        path: The folder; it is created if it does not exist.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._group = optional_module("zarr", "sweep").open_group(path, mode="a")

    def names(self) -> set[str]:
        """Return the names of the arrays and groups."""
        return {entry.name for entry in self.path.iterdir() if entry.is_dir()}

    def can_hold(self, name: str) -> bool:
        """Tell whether an array of this name has a folder of its own, where case may not count."""
        if "/" in name or name in ("", ".", "..", MANIFEST):
            return False
        return name in self.names() or not (self.path / name).exists()

    def set_attributes(self, attributes: Mapping[str, Any]) -> None:
        """Set attributes of the whole store."""
        self._group.attrs.update(attributes)

    def add(
        self,
        name: str,
        shape: tuple[int, ...],
        chunks: tuple[int, ...],
        dimensions: tuple[str, ...],
        content: Any,
        attributes: Mapping[str, Any],
    ) -> None:
        """Add an array, or restore the description of one that exists.

        Args:
            name: Its name; `GROUP/NAME` in a group.
            shape: Its shape.
            chunks: Shape of a chunk.
            dimensions: Name of each dimension.
            content: The array, or one number or text for every entry that is not written.
            attributes: Its attributes.
        """
        zarr, codecs = (optional_module(module, "sweep") for module in ("zarr", "zarr.codecs"))
        single = np.ndim(content) == 0
        described: dict[str, Any] = {}
        group = zarr.open_group(zarr.storage.MemoryStore(described), mode="w")
        group.create_array(
            name,
            shape=shape,
            chunks=chunks,
            dtype=str if isinstance(content, str) else np.asarray(content).dtype,
            fill_value=content if single else 0,
            compressors=[codecs.ZstdCodec(), codecs.Crc32cCodec()],
            dimension_names=dimensions,
            attributes=dict(attributes),
        )
        for key in described.keys() - {MANIFEST}:
            self._write(self.path / key, described[key].to_bytes())
        if not single:
            for chunk in (self.path / name / "c").glob("*"):
                if chunk.is_dir():
                    _removed(chunk)
            array = self[name]
            for first in range(0, shape[0], chunks[0]):  # where one fails, zarr leaves others open
                piece = slice(first, first + chunks[0])
                array[piece] = content[piece]

    def __getitem__(self, name: str) -> Any:
        """Return an array of zarr; chunks are written even if they equal the fill value."""
        return self._group[name].with_config({"write_empty_chunks": True})

    def read(self, name: str, part: int | slice = slice(None)) -> Vector:
        """Return a part of an array along its first dimension.

        Raises:
            UsageError: A chunk of it is damaged.
        """
        try:
            return np.asarray(self._group[name][part])
        except ValueError as error:  # of the checksum
            raise UsageError(
                f"{self.path}: the array {name} is damaged; repeat the sweep with resume=True "
                "(--resume), which computes damaged blocks again"
            ) from error

    def digest(self, names: Iterable[str], block: int) -> bytes:
        """Return a digest of the files of a block in some arrays."""
        total = hashlib.sha256()
        for file in self._files(names, block):
            content = file.read_bytes()
            place = file.relative_to(self.path).as_posix()
            total.update(f"{place} {len(content)}\n".encode())
            total.update(content)
        return total.digest()

    def remove(self, names: Iterable[str], block: int) -> None:
        """Remove what is stored of a block in some arrays."""
        for name in names:
            _removed(self.path / name / "c" / str(block))

    def remove_partial_files(self) -> None:
        """Remove files that a process was writing when it was killed."""
        for left in self.path.rglob("*.partial"):
            left.unlink(missing_ok=True)

    def _files(self, names: Iterable[str], block: int) -> Iterator[Path]:
        """Yield the files of a block: chunk `block` along the first dimension."""
        for name in sorted(names):
            chunk = self.path / name / "c" / str(block)
            if chunk.is_dir():
                yield from (file for file in sorted(chunk.rglob("*")) if file.is_file())
            elif chunk.exists():
                yield chunk

    def _write(self, place: Path, content: bytes) -> None:
        if place.is_dir():
            _removed(place)
        if not place.is_file() or place.read_bytes() != content:
            place.parent.mkdir(parents=True, exist_ok=True)
            write_atomically(place, content)


def _removed(place: Path) -> None:
    """Remove a file, or a folder that stands in its place."""
    if place.is_dir():
        shutil.rmtree(place)
    else:
        place.unlink(missing_ok=True)


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Be the only writer of a store.

    Raises:
        UsageError: Another sweep writes to it, or it holds none.
    """
    try:
        with exclusive(folder / MANIFEST):
            yield
    except BlockingIOError as error:
        raise UsageError(
            f"another sweep is writing to {folder}; wait until it has ended, or name another store"
        ) from error


@contextmanager
def writing(folder: Path | None) -> Iterator[None]:
    """Explain why a store cannot be written.

    Raises:
        ExportError: The disk is full, or permission is missing.
    """
    try:
        yield
    except OSError as error:
        raise ExportError(
            f"cannot write {folder}: {error.strerror or error}; finished blocks are stored: "
            "make it writable again, then continue with resume=True (--resume)"
        ) from error
