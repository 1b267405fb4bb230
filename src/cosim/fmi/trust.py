"""Trust: the FMUs that this user exported or trusts, known by the hash of their bytes."""

import os
import sys

from cosim.codegen.cache import content_of, store_if_possible
from cosim.errors import FmuError, SecurityError, UsageError
from cosim.files import read_plain
from cosim.fmi.archive import opened
from cosim.memo import digest_of

TRUST_VARIABLE = "COSIM_TRUST"
MADE, TRUSTED = "exported here", "trusted by its user"
CHOICES = ("ask", "known", "all")
_RISK = "was not exported here: its code will run with your rights, in a process of its own"


def remember(content: bytes, how: str = MADE) -> None:
    """Trust a file of these bytes from now on, if the cache can be written."""
    if content_of(_entry(content)) == how.encode():
        return
    store_if_possible(_entry(content), how.encode())


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


def require_trust(
    path: str | os.PathLike[str], *, trusted: bool = False, name: object = None
) -> None:
    """Check that an FMU's code may run: ask at a terminal, print a warning elsewhere.

    $COSIM_TRUST = all allows every file, known rejects every file that is not trusted yet.

    Args:
        trusted: Whether the user trusts the file; remembered for this content.
        name: What messages call it, for a file that was unpacked from another one.

    Raises:
        FmuError: The file cannot be read.
        SecurityError: The user does not allow it.
        UsageError: $COSIM_TRUST has an unknown value.
    """
    name = name or path
    choice = os.environ.get(TRUST_VARIABLE) or "ask"
    if choice not in CHOICES:
        raise UsageError(f"{TRUST_VARIABLE} = {choice} is none of {', '.join(CHOICES)}; unset it")
    try:
        if choice == "all" or is_trusted(path):
            return
    except OSError as error:
        raise FmuError(f"cannot read {name}: {error.strerror or error}; give an FMU") from error
    with opened(path):  # rejects a file that is no FMU or is dangerous
        pass
    if trusted or (choice == "ask" and _at_a_terminal() and _user_agrees(name)):
        remember(read_plain(path), TRUSTED)
        return
    how = "to trust this file, say --trust once"
    if choice == "known" or _at_a_terminal():
        raise SecurityError(f"{name} is not run: it {_RISK}; {how}")
    print(f"warning: {name} {_RISK}; {how}", file=sys.stderr)


def _user_agrees(name: object) -> bool:
    print(f"{name} {_RISK}. Run it? [y/N]", file=sys.stderr, flush=True)
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def _at_a_terminal() -> bool:
    return all(s is not None and s.isatty() for s in (sys.stdin, sys.stderr))


def _entry(content: bytes) -> str:
    return f"made/{digest_of([content])}"
