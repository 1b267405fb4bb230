"""Exceptions: `CosimError` and its subclasses, each with an exit code."""

from __future__ import annotations

import reprlib
from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any

from casadi_models import CATALOG
from cosim.text import bounded, shortened, visible


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

    def __init__(self, message: object = "") -> None:
        super().__init__(bounded(str(message)))


class UsageError(CosimError):
    """A call that contradicts itself or the documentation."""

    exit_code = 2

    @classmethod
    def of_type(cls, call: str, value: object, expected: str) -> UsageError:
        """Say that a call was given something of a type that it cannot use."""
        given = f"{' '.join(reprlib.repr(value).split())}, of type {type(value).__name__}"
        return cls(f"{call} was given {given}; give {expected}")


class ParameterError(UsageError):
    """A value that is not finite, out of bounds, or of the wrong type."""


class UnknownName(CosimError):
    """A model, variable, solver or option that does not exist."""

    exit_code = 3

    @classmethod
    def among(cls, owner: str, kind: str, name: str, known: Iterable[str]) -> UnknownName:
        """Say what does not exist and which names come nearest."""
        names = list(dict.fromkeys(known))
        near = near_names(str(name), names)
        hint = (
            f"did you mean {' or '.join(near)}?"
            if near
            else f"it has {shortened(names, 12) or 'none'}"
        )
        return cls(f"{owner} has no {kind} '{bounded(str(name), 300)}'; {hint}")

    @classmethod
    def of_model(cls, model: str, kind: str, name: str, known: Iterable[str]) -> UnknownName:
        """Say so of a model's variable, with the command that shows them all."""
        near = cls.among(model, kind, name, known)
        return cls(f"{near} (all: cosim info {model})") if model in CATALOG else near


class InitialConditionError(CosimError):
    """Start values that contradict each other, or that no solution of the constraints has."""


class SolverError(CosimError):
    """A simulation that stopped early.

    Attributes:
        partial: Every output up to there, a `Trajectory`; None if there is nothing.
    """

    def __init__(self, message: str, partial: Any = None) -> None:
        super().__init__(message)
        self.partial = partial


class Interrupted(KeyboardInterrupt):
    """A simulation that Ctrl-C stopped.

    Attributes:
        partial: Every output up to there: a `Trajectory`, or the results of many runs.
    """

    def __init__(self, message: str, partial: Any) -> None:
        super().__init__(message)
        self.partial = partial


class ExportError(CosimError):
    """An FMU that could not be written."""


class FmuError(CosimError):
    """An FMU that cannot be read or run; its own message is shown as one escaped line."""

    def __init__(self, message: object) -> None:
        super().__init__(visible(" ".join(str(message).splitlines())))


class SecurityError(FmuError):
    """A file that would reach beyond its own folder."""


class MissingTool(CosimError):
    """A missing compiler or optional package; the message says how to install it."""

    exit_code = 5


class CompilerExhausted(MissingTool):
    """A compiler that needs more memory than it may have, or more time."""


class CompilerTimeout(CompilerExhausted):
    """A compiler that needs more time than it may have."""


class CacheError(MissingTool):
    """A folder for compiled code that cannot be used, or that others could write to."""


def near_names(name: str, names: Iterable[str], most: int = 3) -> list[str]:
    """Return the names that are spelt like one, whatever the case of its letters."""
    folded: dict[str, list[str]] = {}
    for known in names:
        folded.setdefault(known.lower(), []).append(known)
    found = get_close_matches(name.lower(), folded, n=most, cutoff=0.5)
    return [known for key in found for known in folded[key]][:most]
