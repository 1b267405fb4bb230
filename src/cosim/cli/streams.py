"""Standard streams as a shell may leave them: closed, full, or without a reader."""

import errno
import io
import os
import sys
from typing import Any

NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF)


class _Forgiving(io.TextIOWrapper):
    """Messages that go nowhere end no run."""

    def write(self, text: str) -> int:
        """Write as far as it goes."""
        try:
            return super().write(text)
        except (OSError, ValueError):
            return len(text)

    def flush(self) -> None:
        """Flush as far as it goes."""
        try:
            super().flush()
        except (OSError, ValueError):
            return


def mend_streams() -> None:
    """Open closed standard streams as the null device; let no message end the process.

    The next file that is opened would take a closed one's place, and get what is printed.
    """
    for handle, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            _fill(handle)
            mode = "r" if name == "stdin" else "w"
            setattr(sys, name, os.fdopen(handle, mode, closefd=False, errors="backslashreplace"))
    if isinstance(sys.stderr, io.TextIOWrapper):
        settings: dict[str, Any] = {"encoding": sys.stderr.encoding, "errors": "backslashreplace"}
        sys.stderr = _Forgiving(sys.stderr.detach(), **settings, line_buffering=True)


def flushed(code: int) -> int:
    """Flush standard output; return the exit code, 1 where results could not be written."""
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        _forget_output()
    except (OSError, ValueError) as error:
        _forget_output()
        if code == 0:
            print(f"cannot write the results: {getattr(error, 'strerror', error)}", file=sys.stderr)
            return 1
    return code


def _forget_output() -> None:
    """Have what Python flushes at its end go nowhere."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)


def _fill(handle: int) -> None:
    try:
        os.fstat(handle)
    except OSError:
        null = os.open(os.devnull, os.O_RDWR)
        if null != handle:
            os.dup2(null, handle)
            os.close(null)
        os.set_inheritable(handle, True)
