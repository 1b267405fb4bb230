"""Resource limits of foreign FMUs and compilers: they stop accidents and are no sandbox."""

import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from cosim.errors import UsageError

LIMITS_VARIABLE = "COSIM_FMU_LIMITS"


@dataclass(frozen=True)
class Limits:
    """Resource limits of one run, as far as the system has them; 0 means none.

    Attributes:
        memory: Address space, bytes.
        cpu: Processor time, s.
        file: Size of a file that the run writes, bytes.
        files: Open files.
    """

    memory: int = 16 * 2**30
    cpu: int = 4 * 3600
    file: int = 2**30
    files: int = 256

    @classmethod
    def chosen(cls) -> "Limits":
        """Return the default limits with those of the variable COSIM_FMU_LIMITS.

        Raises:
            UsageError: The variable is not written like `memory=32e9,cpu=0`.
        """
        chosen, text = cls(), os.environ.get(LIMITS_VARIABLE, "")
        known = asdict(chosen)
        for word in filter(None, text.split(",")):
            name, _, value = word.partition("=")
            try:
                number = float(value)
            except ValueError:
                number = -1.0
            if name.strip() not in known or not 0 <= number < 2**62:
                raise UsageError(
                    f"{LIMITS_VARIABLE}: '{word}' is no limit; give some of {', '.join(known)} as "
                    "NAME=NUMBER, 0 for none, e.g. memory=32e9,cpu=0"
                )
            chosen = replace(chosen, **{name.strip(): int(number)})
        return chosen

    def apply(self) -> None:
        """Limit this process and every process that it will start."""
        try:
            import resource
        except ImportError:  # not on Windows
            return
        limits = {
            resource.RLIMIT_CPU: self.cpu,
            resource.RLIMIT_FSIZE: self.file,
            resource.RLIMIT_NOFILE: self.files,
        }
        if sys.platform == "linux":
            limits[resource.RLIMIT_AS] = self.memory
        chosen = {kind: most for kind, most in limits.items() if most}
        for kind, most in {resource.RLIMIT_CORE: 0, **chosen}.items():
            _, hard = resource.getrlimit(kind)
            most = most if hard == resource.RLIM_INFINITY else min(most, hard)
            with suppress(OSError, ValueError):
                resource.setrlimit(kind, (most, most))


# A shell limits the memory. A second process waits for the end of a pipe that only the caller
# holds: it closes when the caller ends, even by SIGKILL. `exec` passes the exit code on.
_SHELL = """
exec 3<&0 </dev/null
ulimit -v "$1" 2>/dev/null
shift
( read -r _ <&3; kill -9 0 ) >/dev/null 2>&1 &
exec 3<&-
exec "$@"
"""
_NOT_RUN = (126, 127)  # exit codes of a shell: not a program, or not found


def run_bounded(
    command: Sequence[str], seconds: float, most_memory: int, folder: Path
) -> tuple[int, str]:
    """Run a program; return its exit code and its output. Its children end with it.

    Args:
        command: Program and arguments.
        seconds: Time limit, s.
        most_memory: Address space of each of its processes, bytes; not limited on Windows and
            macOS. Windows does not end the program with its caller.
        folder: For temporary files, which a program that was ended leaves there.

    Raises:
        subprocess.TimeoutExpired: The time limit was reached.
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
            printed = output.read().decode(errors="replace")
    finally:
        if end is not None:
            os.close(held)
            os.close(end)
    if watched and process.returncode in _NOT_RUN:
        raise OSError(printed.strip())
    return process.returncode, printed


def _end(process: "subprocess.Popen[bytes]") -> None:
    with suppress(OSError):
        if sys.platform == "win32":
            process.kill()
        else:
            os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def physical_memory() -> int:
    """Return the memory of this machine, bytes; 8 GB if the system does not report it."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):
        return 8 * 10**9
