"""A program that ends with the process that called it, within a time and an amount of memory."""

import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

# A shell limits the memory and waits beside the program for the end of a pipe that only the caller
# holds: whatever ends the caller, signal 9 included, closes it. `exec` keeps the exit code.
_SHELL = """
exec 3<&0 </dev/null
ulimit -v "$1" 2>/dev/null
shift
( read -r _ <&3; kill -9 0 ) >/dev/null 2>&1 &
exec 3<&-
exec "$@"
"""
_NOT_RUN = (126, 127)  # of a shell: it is no program, or not there


def run_bounded(
    command: Sequence[str], seconds: float, most_memory: int, folder: Path
) -> tuple[int, str]:
    """Run a program; return its exit code and what it printed. Its children end with it.

    Args:
        command: Program and arguments.
        seconds: After which it is ended.
        most_memory: Address space of each of its processes, bytes. Windows and macOS do not limit
            it, and Windows does not end it with its caller.
        folder: For its temporary files, which it leaves where it is ended.

    Raises:
        subprocess.TimeoutExpired: It took too long.
        OSError: It cannot be run.
    """
    watched = sys.platform != "win32"
    held, end = os.pipe() if watched else (subprocess.DEVNULL, None)
    shell = ["/bin/sh", "-c", _SHELL, "sh", str(most_memory // 1024)] if watched else []
    try:
        with tempfile.TemporaryFile() as output:  # a pipe would stay open while a child holds it
            process = subprocess.Popen(
                [*shell, *command],
                stdin=held,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                env=os.environ | dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(folder)),
            )
            try:
                process.wait(seconds)
            finally:  # done, too late, or interrupted: the watcher is left, and perhaps children
                _end(process)
            output.seek(0)
            told = output.read().decode(errors="replace")
    finally:
        if end is not None:
            os.close(held)
            os.close(end)
    if watched and process.returncode in _NOT_RUN:
        raise OSError(told.strip())
    return process.returncode, told


def _end(process: "subprocess.Popen[bytes]") -> None:
    with suppress(OSError):
        if sys.platform == "win32":
            process.kill()
        else:
            os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def physical_memory() -> int:
    """Return the memory of this machine, bytes; 8 GB where it cannot be asked."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):
        return 8 * 10**9
