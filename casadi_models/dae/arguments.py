"""Refusals of arguments that a method of `Model` cannot use, whatever fails inside it."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import wraps
from inspect import Parameter, isfunction, signature
from numbers import Real
from typing import Any, TypeVar, get_origin

from casadi import SX

from casadi_models.dae.variables import Facts
from casadi_models.units import represented

_Class = TypeVar("_Class")
_FITTING: dict[Any, tuple[Any, str]] = {  # by annotation: the types that fit, and what to give
    str: (str, "a text"),
    float: (Real, "a number"),
    bool: (bool, "True or False"),
    SX: (SX, "symbols of this model"),
    Mapping: (Mapping, "new values by state"),
    Sequence: (Sequence, "a list"),
    Any: ((Real, SX), "a number or an SX expression"),
}


def refusing_arguments(kind: type[_Class]) -> type[_Class]:
    """Let the public methods of a builder raise its `ValueError`, naming a wrong argument.

    Flags are True or False, as a text like "no" would count as true.
    """
    for name in dir(kind):
        method = getattr(kind, name)
        if isfunction(method) and not name.startswith("_"):
            setattr(kind, name, _refusing(method))
    return kind


def _refusing(method: Callable[..., Any]) -> Callable[..., Any]:
    known = signature(method)
    kinds = {name: one.annotation for name, one in known.parameters.items()}
    if any(one.kind is Parameter.VAR_KEYWORD for one in known.parameters.values()):
        kinds |= Facts.__annotations__
    flags = [name for name, kind in kinds.items() if kind is bool]

    @wraps(method)
    def refusing(self: Any, *values: Any, **named: Any) -> Any:
        for flag in flags:
            if not isinstance(named.get(flag, False), bool):
                raise self._refusal(_needed(method, flag, named[flag], bool))
        try:
            return method(self, *values, **named)
        except Exception as error:
            is_own = isinstance(error, ValueError) and str(error).startswith(self._full_name)
            if is_own or not (values or named):
                raise
            try:
                given = known.bind(self, *values, **named).arguments
            except TypeError:
                raise error from None  # Python says what is missing, or too much
            given |= given.pop("facts", {})
            del given[next(iter(given))]  # self
            every = ", ".join(f"{name} = {represented(value)}" for name, value in given.items())
            reasons = (_needed(method, *wrong) for wrong in _misfits(given, kinds))
            raise self._refusal(next(reasons, f"{method.__name__} cannot use {every}")) from error

    return refusing


def _misfits(
    given: Mapping[str, Any], kinds: Mapping[str, Any]
) -> Iterator[tuple[str, object, Any]]:
    """Yield the arguments that do not fit their annotations, with these; expressions last."""
    for is_expression in (False, True):
        for name, value in given.items():
            kind = get_origin(kinds[name]) or kinds[name]
            if (kind is Any) is is_expression and not _fits(value, kind):
                yield name, value, kind


def _fits(value: object, kind: Any) -> bool:
    if kind not in _FITTING:
        return True
    return isinstance(value, _FITTING[kind][0]) and isinstance(value, bool) is (kind is bool)


def _needed(method: Callable[..., Any], name: str, value: object, kind: Any) -> str:
    return f"{method.__name__}: {name} is {represented(value)}; give {_FITTING[kind][1]}"
