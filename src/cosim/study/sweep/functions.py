"""`function_name`: what identifies a user's function of a run in a stored sweep."""

from collections.abc import Iterator
from functools import partial
from types import CodeType, FunctionType
from typing import Any

import numpy as np

from cosim.memo import digest_of

_PLAIN = bool | int | float | complex | str | bytes | None


def function_name(function: Any) -> str:
    """Return the name of a function and a digest of its code and of the values that it uses."""
    name = getattr(function, "__qualname__", type(function).__qualname__)
    parts = [function]
    if not isinstance(function, FunctionType | partial):  # a method, or an object with __call__
        owner = getattr(function, "__self__", function)
        call = getattr(function, "__func__", None)
        kind = owner if isinstance(owner, type) else type(owner)
        parts = [call, getattr(owner, "__dict__", None), *map(_members, kind.__mro__)]
    return f"{name} {digest_of(map(str.encode, _facts(parts, {})))[:16]}"


def _members(kind: type) -> dict[str, Any]:
    """Return the methods and values of a class, without what Python adds."""
    return {
        name: value
        for name, value in vars(kind).items()
        if isinstance(value, FunctionType) or not name.startswith("__")
    }


def _facts(value: Any, known: dict[int, int]) -> Iterator[str]:
    """Yield texts that are the same in every process; of values of other types, their type."""
    if isinstance(value, _PLAIN):
        yield repr(value)
    elif isinstance(value, np.ndarray | np.generic) and value.dtype != object:
        yield f"{value.dtype} {value.shape} {digest_of((value.tobytes(),))}"
    elif id(value) in known:
        yield f"again {known[id(value)]}"
    else:
        known[id(value)] = len(known)
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
