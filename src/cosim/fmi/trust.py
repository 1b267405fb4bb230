"""Whose FMUs may run here: files that this user exported or trusts, by the hash of their bytes."""

import hashlib
import os
import sys
from contextlib import suppress

from cosim.codegen.cache import content_of, keep
from cosim.errors import CacheError, FmuError, SecurityError, UsageError
from cosim.files import read_plain
from cosim.fmi.archive import opened

TRUST_VARIABLE = "COSIM_TRUST"
MADE, TRUSTED = "exported here", "trusted by its user"
CHOICES = ("ask", "known", "all")
_RISK = "was not exported here: its code will run with your rights, in a process of its own"


def remember(content: bytes, how: str = MADE) -> None:
    """Trust a file of these bytes from now on; where nothing can be kept, it is asked for again."""
    if content_of(_entry(content)) == how.encode():
        return
    with suppress(OSError, CacheError):
        keep(_entry(content), how.encode())


def is_trusted(path: str | os.PathLike[str]) -> bool:
    """Tell whether this user has exported or trusted a file of these bytes.

    Raises:
        OSError: It cannot be read.
    """
    return content_of(_entry(read_plain(path))) is not None


def is_made_here(path: str | os.PathLike[str]) -> bool:
    """Tell whether this user has exported a file of these bytes.

    Raises:
        OSError: It cannot be read.
    """
    return content_of(_entry(read_plain(path))) == MADE.encode()


def require_trust(path: str | os.PathLike[str], *, trusted: bool = False) -> None:
    """Let an FMU's code run, or not: asked at a terminal, warned of elsewhere.

    $COSIM_TRUST = all asks for no file, known refuses all that are not trusted yet.

    Args:
        path: The FMU.
        trusted: The user says so; kept for this very content.

    Raises:
        FmuError: The file cannot be read.
        SecurityError: The user says no.
        UsageError: $COSIM_TRUST is none of its values.
    """
    choice = os.environ.get(TRUST_VARIABLE) or "ask"
    if choice not in CHOICES:
        raise UsageError(f"{TRUST_VARIABLE} = {choice} is none of {', '.join(CHOICES)}; unset it")
    try:
        if choice == "all" or is_trusted(path):
            return
    except OSError as error:
        raise FmuError(f"cannot read {path}: {error.strerror or error}; give an FMU") from error
    with opened(path):  # refuses what is no FMU, or dangerous, before anybody trusts it
        pass
    if trusted or (choice == "ask" and _at_a_terminal() and _asked(path)):
        remember(read_plain(path), TRUSTED)
        return
    how = "to trust this file, say --trust once"
    if choice == "known" or _at_a_terminal():
        raise SecurityError(f"{path} is not run: it {_RISK}; {how}")
    print(f"warning: {path} {_RISK}; {how}", file=sys.stderr)


def _asked(path: object) -> bool:
    print(f"{path} {_RISK}. Run it? [y/N] ", end="", file=sys.stderr, flush=True)
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def _at_a_terminal() -> bool:
    return all(s is not None and s.isatty() for s in (sys.stdin, sys.stderr))


def _entry(content: bytes) -> str:
    return f"made/{hashlib.sha256(content).hexdigest()}"
