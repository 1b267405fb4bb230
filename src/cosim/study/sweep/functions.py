"""`function_name`: what identifies a user's function of a run in a stored sweep."""

from collections.abc import Iterator
from functools import partial
from types import CodeType, FunctionType, MethodType
from typing import Any

import numpy as np

from cosim.memo import digest_of

_PLAIN = bool | int | float | complex | str | bytes | None


def function_name(function: Any) -> str:
    """Return the name of a function and a digest of its code and of the values that it uses."""
    name = getattr(function, "__qualname__", type(function).__qualname__)
    is_plain = isinstance(function, FunctionType | MethodType | partial)
    parts = [function] if is_plain else [*_of_object(function)]  # with a method __call__
    return f"{name} {digest_of(map(str.encode, _facts(parts, {})))[:16]}"


def _of_object(owner: Any) -> Iterator[Any]:
    """Yield the values of an object, and methods and values of its class."""
    yield getattr(owner, "__dict__", None)
    for kind in (owner if isinstance(owner, type) else type(owner)).__mro__:
        for name, value in vars(kind).items():
            if isinstance(value, FunctionType) or not name.startswith("__"):
                yield from (name, value)


def _facts(value: Any, known: dict[int, tuple[int, Any]]) -> Iterator[str]:
    """Yield texts that are the same in every process; of values of other types, their type."""
    if isinstance(value, _PLAIN):
        yield repr(value)
    elif isinstance(value, np.ndarray | np.generic) and value.dtype != object:
        yield f"{value.dtype} {value.shape} {digest_of((value.tobytes(),))}"
    elif id(value) in known:
        yield f"again {known[id(value)][0]}"
    else:
        known[id(value)] = len(known), value  # which keeps its id
        yield type(value).__qualname__
        for part in _parts(value):
            yield from _facts(part, known)


def _parts(value: Any) -> Iterator[Any]:
    if isinstance(value, CodeType):
        yield from (value.co_code, *value.co_names, *value.co_varnames, *value.co_consts)
    elif isinstance(value, FunctionType):
        yield from (value.__code__, value.__defaults__, value.__kwdefaults__)
        yield from (cell.cell_contents for cell in value.__closure__ or ())
        for name in _names(value.__code__):
            used = value.__globals__.get(name)
            # not what it imports: a package is known by its name
            if getattr(used, "__module__", value.__module__) == value.__module__:
                yield used
    elif isinstance(value, MethodType):
        yield value.__func__
        yield from _of_object(value.__self__)
    elif isinstance(value, partial):
        yield from (value.func, value.args, value.keywords)
    elif isinstance(value, tuple | list):
        yield from value
    elif isinstance(value, dict):
        yield from (one for item in value.items() for one in item)
    elif isinstance(value, frozenset | set):
        yield from sorted(map(repr, value))


def _names(code: CodeType) -> Iterator[str]:
    """Yield the names that a function and those within it look up, as of a comprehension."""
    yield from code.co_names
    for inner in code.co_consts:
        if isinstance(inner, CodeType):
            yield from _names(inner)
