"""Everything a caller may catch: `CosimError` and its children, each with its exit code."""

from __future__ import annotations

import reprlib
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from typing import Any, Protocol

from casadi_models import CATALOG
from cosim.text.escaping import visible
from cosim.text.lists import shortened


class PartialRun(Protocol):
    """What a failed run leaves behind; a `cosim.Trajectory`, or what many runs left."""

    @property
    def time(self) -> Any:
        """Output times, s, (n,)."""

    @property
    def stats(self) -> Mapping[str, Any]:
        """What it took."""

    @property
    def status(self) -> str:
        """Where and why the run stopped."""

    def __getitem__(self, name: str) -> Any:
        """Return the values of a variable, (n,)."""


class CosimError(Exception):
    """Root of all errors of this package; `exit_code` is what the command line returns.

    Example:
        >>> import cosim
        >>> try:
        ...     cosim.load("bycicle")
        ... except cosim.CosimError as error:
        ...     error.exit_code
        3
    """

    exit_code = 1


class UsageError(CosimError):
    """A call that contradicts itself or the documentation."""

    exit_code = 2

    @classmethod
    def of_type(cls, call: str, value: object, wanted: str) -> UsageError:
        """Say that a call was given something of a type that it cannot use."""
        given = f"{' '.join(reprlib.repr(value).split())}, of type {type(value).__name__}"
        return cls(f"{call} was given {given}; give {wanted}")


class ParameterError(UsageError):
    """A value that is not finite, out of bounds, or of the wrong type."""


class UnknownName(CosimError):
    """A model, variable, solver or option that does not exist."""

    exit_code = 3

    @classmethod
    def among(cls, owner: str, kind: str, name: str, known: Iterable[str]) -> UnknownName:
        """Say what does not exist and which names come nearest."""
        names = list(dict.fromkeys(known))
        near = _near(str(name), names)
        hint = (
            f"did you mean {' or '.join(near)}?"
            if near
            else f"it has {shortened(names, 12) or 'none'}"
        )
        return cls(f"{owner} has no {kind} '{name}'; {hint}")

    @classmethod
    def of_model(cls, model: str, kind: str, name: str, known: Iterable[str]) -> UnknownName:
        """Say so of a model's variable, with the command that shows them all."""
        near = cls.among(model, kind, name, known)
        return cls(f"{near} (all: cosim info {model})") if model in CATALOG else near


class InitialConditionError(CosimError):
    """Start values that contradict each other, or that no solution of the constraints has."""


class SolverError(CosimError):
    """A run that ended early; `partial` holds every output up to there."""

    def __init__(self, message: str, partial: PartialRun | None = None) -> None:
        super().__init__(message)
        self.partial = partial


class Interrupted(KeyboardInterrupt):
    """A run that Ctrl-C ended; `partial` holds every output up to there."""

    def __init__(self, message: str, partial: PartialRun) -> None:
        super().__init__(message)
        self.partial = partial


class ExportError(CosimError):
    """An FMU that could not be written."""


class FmuError(CosimError):
    """An FMU that cannot be read or run; what it says itself is shown as one harmless line."""

    def __init__(self, message: object) -> None:
        super().__init__(visible(" ".join(str(message).splitlines())))


class SecurityError(FmuError):
    """A file that would reach beyond its own folder."""


class MissingTool(CosimError):
    """A compiler or an optional package that is not there; the message says how to get it."""

    exit_code = 5


class CompilerExhausted(MissingTool):
    """A compiler that needs more memory than it may have, or more time."""


class CompilerTimeout(CompilerExhausted):
    """A compiler that needs more time than it may have."""


class CacheError(MissingTool):
    """A folder for compiled code that cannot be used, or that others could write to."""


def _near(name: str, names: list[str], most: int = 3) -> list[str]:
    """Return the names that are spelt like one, whatever the case of its letters."""
    folded: dict[str, list[str]] = {}
    for known in names:
        folded.setdefault(known.lower(), []).append(known)
    found = get_close_matches(name.lower(), folded, n=most, cutoff=0.5)
    return [known for key in found for known in folded[key]][:most]
