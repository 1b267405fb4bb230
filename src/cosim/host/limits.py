"""Limits of time, and of the resources of foreign FMUs: they stop accidents, no attacks."""

import os
import sys
from collections.abc import Mapping
from contextlib import suppress
from math import ceil

from cosim.errors import UsageError

MOST_WAIT = 4e6  # s, 46 days: timers of every system can wait for so long
LIMITS_VARIABLE = "COSIM_FMU_LIMITS"
# Address space, bytes; processor time, s; size of a file, bytes; open files; 0 means no limit
_USUAL = {"memory": 16 * 2**30, "cpu": 4 * 3600, "file": 2**30, "files": 256}
_KINDS = {"memory": "AS", "cpu": "CPU", "file": "FSIZE", "files": "NOFILE"}


def chosen_limits() -> dict[str, int]:
    """Return the limits of one run by name, with those of the variable COSIM_FMU_LIMITS.

    Raises:
        UsageError: The variable is not written like `memory=32e9,cpu=0`.
    """
    chosen = dict(_USUAL)
    for word in filter(None, os.environ.get(LIMITS_VARIABLE, "").split(",")):
        name, _, value = (part.strip() for part in word.partition("="))
        try:
            number = float(value)
        except ValueError:
            number = -1.0
        if name not in chosen or not 0 <= number < 2**62:
            raise UsageError(
                f"{LIMITS_VARIABLE}: '{word}' is no limit; give some of {', '.join(chosen)} as "
                "NAME=NUMBER, 0 for none, e.g. memory=32e9,cpu=0"
            )
        chosen[name] = ceil(number)
    return chosen


def waiting_time(seconds: float | None) -> float | None:
    """Return a time limit, s, for a timer; None, which is no limit, beyond `MOST_WAIT`."""
    return None if seconds is None or seconds > MOST_WAIT else seconds


def apply_limits(limits: Mapping[str, int]) -> None:
    """Limit this process and every process that it will start, as far as the system can."""
    try:
        import resource
    except ImportError:  # not on Windows
        return
    wanted = {_KINDS[name]: most for name, most in limits.items() if most} | {"CORE": 0}
    if sys.platform != "linux":
        wanted.pop("AS", None)
    for name, most in wanted.items():
        kind = getattr(resource, f"RLIMIT_{name}")
        _, hard = resource.getrlimit(kind)
        most = most if hard == resource.RLIM_INFINITY else min(most, hard)
        with suppress(OSError, ValueError):
            resource.setrlimit(kind, (most, most))
