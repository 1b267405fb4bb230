"""Trials of what an FMU does to the process that runs it: its output, its folder, its memory."""

import ctypes
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import chdir
from itertools import islice
from pathlib import Path
from time import monotonic

from cosim.fmi.check.finding import TRIAL_RULES, Finding
from cosim.fmi.check.trials.bench import MEMORY_GROWTH, Bench, Note, Skipped, memory_in_use
from cosim.fmi.check.trials.start import few_numbers
from cosim.host.temporary import temporary_folder

_SHARE = 1 / 24  # of all time is for instances
_MOST_INSTANCES = 10_000


def quiet(bench: Bench, kind: str) -> Iterator[Finding]:
    """It writes neither to standard output nor into the current folder."""
    rule = TRIAL_RULES["quiet"]
    c = ctypes.CDLL(None) if os.name == "posix" else ctypes.cdll.msvcrt
    sys.stdout.flush()
    c.fflush(None)
    with temporary_folder() as place, tempfile.TemporaryFile() as written:
        saved = os.dup(1)
        os.dup2(written.fileno(), 1)
        try:
            with chdir(place), bench.session(kind) as session:
                few_numbers(session)
            c.fflush(None)
        finally:
            os.dup2(saved, 1)
            os.close(saved)
        written.seek(0)
        if text := written.read():
            yield rule.at(kind, f"it writes {len(text)} bytes to standard output: {text[:40]!r}")
        for file in islice(Path(place).iterdir(), 1):
            yield rule.at(kind, f"it writes '{file.name}' into the current folder")


def memory(bench: Bench, kind: str) -> Iterator[Finding | Note]:
    """Memory does not grow with instances; `steps` looks whether it does with steps."""
    if bench.offers(kind, "canBeInstantiatedOnlyOncePerProcess"):
        raise Skipped("it can be instantiated once per process only")
    end, used = monotonic() + _SHARE * bench.timeout, [memory_in_use()]
    with bench.session(kind) as session:
        while len(used) <= _MOST_INSTANCES and monotonic() < end:
            session.start()
            try:
                session.instantiate_bare(logger=True)
            except Exception as error:
                raise Skipped(f"it does not instantiate again: {error}") from error
            used.append(memory_in_use())
    if (growth := used[-1] - used[len(used) // 2]) > MEMORY_GROWTH:
        found = f"{growth / 1e6:.1f} MB are lost in {len(used) // 2} instances"
        yield TRIAL_RULES["memory"].at(kind, found)
    yield Note(f"{len(used) - 1} instances")
