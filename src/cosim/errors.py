"""Exceptions: `CosimError` and its subclasses, each with an exit code."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from difflib import get_close_matches
from functools import wraps
from inspect import isfunction, signature
from typing import Any, TypeVar

from casadi_models import CATALOG
from casadi_models.units import represented
from cosim.text import Ending, EndKind, readable, shortened, visible

_Call = TypeVar("_Call", bound=Callable[..., Any])
_Class = TypeVar("_Class")


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
    has_lines = False

    def __init__(self, message: object = "") -> None:
        super().__init__(readable(str(message), lines=self.has_lines))


class UsageError(CosimError):
    """A call that contradicts itself or the documentation."""

    exit_code = 2

    @classmethod
    def of_type(cls, call: str, value: object, expected: str) -> UsageError:
        """Say that a call was given something of a type that it cannot use."""
        given = f"{represented(value)}, of type {type(value).__name__}"
        return cls(f"{call} was given {given}; give {expected}")

    @classmethod
    def reject(cls, call: str, value: object, kind: Any, expected: str) -> None:
        """Raise this error unless a value is of a type."""
        if not isinstance(value, kind):
            raise cls.of_type(call, value, expected)


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
        hint = f"it has {shortened(names, 12) or 'none'}"
        if near:
            hint = f"did you mean {' or '.join(near)}?"
        return cls(f"{owner} has no {kind} '{name}'; {hint}")

    @classmethod
    def reject(cls, owner: str, kind: str, known: Collection[str], *names: str) -> None:
        """Raise the error of the first name that does not exist."""
        for name in names:
            if name not in known:
                raise cls.among(owner, kind, name, known)

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
        ending: Why it stopped, without the name of the model.
    """

    def __init__(self, message: str, partial: Any = None, ending: Ending | None = None) -> None:
        super().__init__(message)
        self.partial, self.ending = partial, ending or Ending(message)

    @classmethod
    def of(cls, owner: str, *ending: str, kind: EndKind = EndKind.FAILED) -> SolverError:
        """Return the error of a model: why a run cannot go on, and what helps."""
        why, remedy = ending if len(ending) > 1 else (*ending, "")
        found = Ending(why, kind, remedy)
        return cls(f"{owner}: {found}", ending=found)


class Interrupted(KeyboardInterrupt):
    """A simulation that Ctrl-C stopped.

    Attributes:
        partial: Every output up to there: a `Trajectory`, or the results of many runs.
    """

    def __init__(self, message: str, partial: Any = None) -> None:
        super().__init__(message)
        self.partial = partial


class ExportError(CosimError):
    """An FMU that could not be written."""


class FmuError(CosimError):
    """An FMU that cannot be read or run; its own message is shown as one escaped line.

    Attributes:
        partial: Every output of a run that was ended, a `Trajectory`; None if there is nothing.
    """

    def __init__(self, message: object, partial: Any = None) -> None:
        super().__init__(visible(" ".join(str(message).splitlines())))
        self.partial = partial


class SecurityError(FmuError):
    """A file that would reach beyond its own folder."""


class MissingTool(CosimError):
    """A missing compiler or optional package; the message says how to install it."""

    exit_code = 5
    has_lines = True  # of a compiler


class CompilerTimeout(MissingTool):
    """A compiler that needs more time than it may have."""


class CacheError(MissingTool):
    """A folder for compiled code that cannot be used, or that others could write to."""


def near_names(name: str, names: Iterable[str]) -> list[str]:
    """Return up to three names that are spelt like one, whatever the case of its letters."""
    folded: dict[str, list[str]] = {}
    for known in names:
        folded.setdefault(known.lower(), []).append(known)
    found = get_close_matches(name.lower(), folded, n=3, cutoff=0.5)
    return [known for key in found for known in folded[key]][:3]


_ELSEWHERE = {  # keywords of other tools, by ours; the first that a function has is meant
    "relative_tolerance": "rtol reltol rel_tol tol tolerance",
    "tolerance": "rtol reltol rel_tol tol relative_tolerance",
    "bound": "rtol reltol rel_tol tol tolerance atol abstol abs_tol",
    "absolute_tolerance": "atol abstol abs_tol",
    "grid": "t_eval teval t tspan t_span t_end stop_time output_times",
    "stop_time": "t_end tend tf t_final final_time tspan t_span duration t_max end_time tstop",
    "output_interval": "dt saveat",
    "output_times": "t_eval teval t grid",
    "parameters": "params p p0",
    "start_values": "parameters params p p0 x0 y0 u0 initial_values initial_conditions",
    "solver": "method integrator",
}


def meant_elsewhere(name: str, known: Collection[str]) -> list[str] | None:
    """Return the known keywords for one of another tool; None if no tool is known to have it."""
    meant = [own for own, others in _ELSEWHERE.items() if name in others.split()]
    return [own for own in meant if own in known] if meant else None


def naming_arguments(function: _Call) -> _Call:
    """Return a function that names a wrong argument.

    It answers an unknown keyword with the one that is meant, or with all. Where it fails with an
    exception that is not ours, and an argument is not of the annotated type, it says so.

    Raises:
        TypeError: The function has no such keyword.
        UsageError: An argument has a type that it cannot use.
    """
    known, rest = dict[str, Any](), None
    for own, one in signature(function).parameters.items():
        fields = getattr(one.annotation, "__args__", (None,))[0]
        if one.kind is not one.VAR_KEYWORD:
            known[own] = one.annotation
        elif hasattr(fields, "__required_keys__"):  # Unpack[TypedDict]
            known |= fields.__annotations__
        else:
            rest = one.annotation
    flags = [name for name, kind in known.items() if kind in (bool, "bool")]

    @wraps(function)
    def named(*values: Any, **keywords: Any) -> Any:
        more = keywords.keys() - known
        for name in more if rest is None else ():
            near = meant_elsewhere(name, known)
            near = near if near is not None else get_close_matches(name, known, 1)
            every = shortened([*known], 12) or "none"
            hint = f"did you mean {near[0]}?" if near else f"it has {every}"
            call = f"{function.__name__}() got an unexpected keyword argument"
            raise TypeError(readable(f"{call} '{name}'; {hint}"))
        for name in flags:  # as a text like "no" would count as true
            if type(keywords.get(name)).__name__ not in ("NoneType", "bool", "bool_"):
                call = f"{function.__qualname__}: {name}"
                raise UsageError.of_type(call, keywords[name], "True or False")
        try:
            return function(*values, **keywords)
        except CosimError:
            raise
        except Exception as error:
            from cosim.argument_types import wrong_argument

            if wrong := wrong_argument(
                function, known | dict.fromkeys(more, rest), values, keywords
            ):
                raise UsageError.of_type(*wrong) from error
            raise

    return named  # type: ignore[return-value]


def naming_arguments_of(kind: type[_Class]) -> type[_Class]:
    """Decorate the constructor and the public methods of a class by `naming_arguments`."""
    for name, method in list(vars(kind).items()):
        own = name in ("__init__", "__getitem__") or not name.startswith("_")
        if not own or isinstance(method, staticmethod):
            continue
        if isinstance(method, classmethod):
            setattr(kind, name, classmethod(naming_arguments(method.__func__)))
        elif isfunction(method):
            setattr(kind, name, naming_arguments(method))
    return kind
