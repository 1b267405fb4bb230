"""Resource limits of foreign FMUs: they stop accidents and are no sandbox."""

import os
import sys
from contextlib import suppress
from dataclasses import asdict, dataclass, replace

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
