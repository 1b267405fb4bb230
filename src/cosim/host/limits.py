"""What a foreign FMU may use in its own process. A limit stops an accident; it is no sandbox."""

import os
import sys
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from cosim.errors import UsageError

LIMITS_VARIABLE = "COSIM_FMU_LIMITS"


@dataclass(frozen=True)
class Limits:
    """Limits of one run, where the system has such; 0 is none.

    Attributes:
        memory: Address space, bytes.
        cpu: Time on the processor, s.
        file: Size of a file that it writes, bytes.
        files: Open at once.
        processes: And threads, beyond those that its user runs already; root has no such limit.
    """

    memory: int = 16 * 2**30
    cpu: int = 4 * 3600
    file: int = 2**30
    files: int = 256
    processes: int = 256

    @classmethod
    def chosen(cls) -> "Limits":
        """Return the limits of this user: the usual ones, but what $COSIM_FMU_LIMITS says.

        Raises:
            UsageError: It is not like `memory=32e9,cpu=0`.
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
        """Limit this process and all that it will start."""
        try:
            import resource
        except ImportError:  # not on Windows
            return
        wanted = {
            resource.RLIMIT_CORE: (0, True),
            resource.RLIMIT_CPU: (self.cpu, bool(self.cpu)),
            resource.RLIMIT_FSIZE: (self.file, bool(self.file)),
            resource.RLIMIT_NOFILE: (self.files, bool(self.files)),
        }
        if sys.platform == "linux":
            wanted[resource.RLIMIT_AS] = (self.memory, bool(self.memory))
            most = _threads_of_user() + self.processes if self.processes else 0
            wanted[resource.RLIMIT_NPROC] = (most, bool(most))
        for kind, (most, set_it) in wanted.items():
            _, hard = resource.getrlimit(kind)
            if set_it:
                most = most if hard == resource.RLIM_INFINITY else min(most, hard)
                with suppress(OSError, ValueError):
                    resource.setrlimit(kind, (most, most))


def _threads_of_user() -> int:
    """Count the threads of all processes of this user, which is what Linux limits."""
    count = 0
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if process.stat().st_uid == os.geteuid():
                count += len(list((process / "task").iterdir()))
    return count
