"""Files that are whole or not there: written beside their place, then renamed."""

import os
import tempfile
from pathlib import Path

from cosim.errors import ExportError


def write_atomically(target: str | os.PathLike[str], content: bytes) -> Path:
    """Write a file so that its name always stands for the whole old or the whole new content.

    Raises:
        ExportError: The folder is missing or read-only, the disk is full, the name is a folder.
    """
    path = Path(target)
    if path.is_dir():
        raise ExportError(f"cannot write {path}: it is a directory; give a file name")
    try:
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name[:40]}.")
    except OSError as error:
        raise _refusal(path, error) from error
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        Path(temporary).chmod(0o666 & ~_umask())
        Path(temporary).replace(path)
    except BaseException as error:
        Path(temporary).unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise _refusal(path, error) from error
        raise
    return path


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _refusal(path: Path, error: OSError) -> ExportError:
    hint = "" if path.parent.is_dir() else f"; create {path.parent} first"
    return ExportError(f"cannot write {path}: {error.strerror or error}{hint}")
