"""Whether an argument has the type that its annotation names; asked after a call has failed."""

import os
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence, Sized
from contextlib import suppress
from inspect import Parameter, isclass, signature
from numbers import Integral, Real
from types import NoneType, UnionType
from typing import IO, Any, BinaryIO, TextIO, Union, get_args, get_origin

import numpy as np
from numpy.typing import ArrayLike

_WORDS = {
    NoneType: "None",
    bool: "True or False",
    float: "a number",
    int: "a whole number",
    str: "a text",
    os.PathLike: "a path",
    Mapping: "values by name",
    Callable: "a function",
}
_MANY = (Sequence, Collection, Iterable, list, tuple, set, frozenset)


def wrong_argument(
    function: Callable[..., Any],
    annotations: Mapping[str, Any],
    values: Sequence[Any],
    keywords: Mapping[str, Any],
) -> tuple[str, object, str] | None:
    """Return the first argument that does not fit its annotation, for `UsageError.of_type`.

    Args:
        function: What was called.
        annotations: By name; those that cannot be resolved fit everything.
        values, keywords: The arguments.

    Returns:
        The argument as FUNCTION: NAME, its value, and what to give; None if all fit.
    """
    try:
        given = signature(function).bind_partial(*values).arguments | dict(keywords)
    except TypeError:  # too many: Python's own message says so
        return None
    for name, value in given.items():
        kind = annotations.get(name, Any)
        if isinstance(kind, str):
            kind = _resolved(kind, function.__globals__)
        if not _fits(value, kind):
            return f"{function.__qualname__}: {name}", value, " or ".join(_words(kind))
    return None


def _resolved(text: str, names: dict[str, Any]) -> Any:
    with suppress(NameError, AttributeError, TypeError):  # of names for type checkers only
        return eval(text, names)
    return Any


def _fits(value: Any, kind: Any) -> bool:
    """Tell whether a value can be used as an annotated type; unknown types fit everything."""
    own, inner = get_origin(kind) or kind, get_args(kind)
    if own in (Any, Parameter.empty):
        return True
    if kind == ArrayLike:
        return _is_numeric(value)
    if own in (Union, UnionType):
        return any(_fits(value, each) for each in _alternatives(inner))
    if own in (None, NoneType):
        return value is None
    if own is bool:
        return isinstance(value, bool | np.bool_)
    if own in (float, int):
        number = Real if own is float else Integral
        return isinstance(value, number) and not isinstance(value, bool) and _is_numeric(value)
    if own is Mapping:
        return isinstance(value, Mapping) and all(
            _fits(part, each)
            for each, parts in zip(inner, (value, value.values()), strict=False)
            for part in parts
        )
    if own is tuple and inner and inner[1:] != (...,):
        several = _is_iterable(value, ()) and isinstance(value, Sized)
        return several and len(value) == len(inner) and all(map(_fits, value, inner))
    if own in _MANY:
        parts = inner[:1]
        return _is_iterable(value, parts) and all(
            _fits(part, each) for each in parts for part in value
        )
    if own is Callable:
        return callable(value)
    if own in (IO, TextIO, BinaryIO):  # of which no file is an instance
        return hasattr(value, "read") or hasattr(value, "write")
    return not isclass(own) or getattr(own, "_is_protocol", False) or _is_one(value, own)


def _alternatives(kinds: tuple[Any, ...]) -> list[Any]:
    """Return the types of a union, in which what makes up `ArrayLike` is one type."""
    arrays = get_args(ArrayLike)
    if not {*arrays} <= {*kinds}:
        return [*kinds]
    return [ArrayLike, *(kind for kind in kinds if kind not in arrays)]


def _is_one(value: Any, kind: type) -> bool:
    return isinstance(value, kind) and (kind is not np.ndarray or _is_numeric(value))


def _is_numeric(value: Any) -> bool:
    try:
        is_complex = np.asarray(value).dtype.kind == "c"
        return not is_complex and np.asarray(value, dtype=float).size >= 0
    except (ValueError, TypeError, OverflowError, RuntimeError, NotImplementedError):
        return False


def _is_iterable(value: Any, parts: tuple[Any, ...]) -> bool:
    if isinstance(value, str | bytes):
        return False
    if isinstance(value, np.ndarray) and parts == (str,):
        return value.dtype.kind in "UO"
    try:
        iter(value)
    except TypeError:
        return False
    return True


def _words(kind: Any) -> list[str]:
    """Return what may be given, in words."""
    own, inner = get_origin(kind) or kind, get_args(kind)
    if kind == ArrayLike:
        return ["numbers"]
    if own in (Union, UnionType):
        return list(dict.fromkeys(word for each in _alternatives(inner) for word in _words(each)))
    if own in _MANY:
        several = f"{len(inner)} values" if own is tuple and inner[1:] != (...,) else "a list"
        return ["a list of texts" if str in inner else several]
    name = getattr(own, "__name__", str(own))
    return [_WORDS.get(own, f"{'an' if name[0] in 'AEIOU' else 'a'} {name}")]
