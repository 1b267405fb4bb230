"""Models for pickle: CasADi's expressions cannot be pickled one by one, for they share symbols."""

import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields, is_dataclass
from typing import Any, NamedTuple

import casadi as ca
from casadi import SX


class _Expression:
    """Stands, as a class, for the next expression."""


class _Value(NamedTuple):
    """A dataclass whose expressions are elsewhere."""

    kind: type
    own: dict[str, Any]


def packed(value: Any) -> tuple[str, Any]:
    """Return the expressions of a value as text, and the value with placeholders for them.

    Args:
        value: A dataclass of plain values, tuples, dataclasses and SX expressions.
    """
    expressions: list[SX] = []
    rest = _without(value, expressions)
    serializer = ca.StringSerializer()
    serializer.pack(expressions)
    return serializer.encode(), rest


def digest(value: Any) -> str:
    """Return a hash of a value that `packed` takes, the same in every process."""
    content, rest = packed(value)
    return hashlib.sha256(f"{content}\0{rest!r}".encode()).hexdigest()


def unpacked(content: str, rest: Any) -> Any:
    """Return the value that `packed` was given; its symbols are its own."""
    return _with(rest, iter(ca.StringDeserializer(content).unpack()))


def rewritten(value: Any, rewrite: Callable[[list[SX]], Sequence[SX]]) -> Any:
    """Return a value with its expressions rewritten, all of them at once."""
    expressions: list[SX] = []
    rest = _without(value, expressions)
    return _with(rest, iter(rewrite(expressions)))


def _without(value: Any, found: list[SX]) -> Any:
    if isinstance(value, SX):
        found.append(value)
        return _Expression
    if isinstance(value, tuple):
        return tuple(_without(item, found) for item in value)
    if is_dataclass(value) and not isinstance(value, type):
        own = {f.name: _without(getattr(value, f.name), found) for f in fields(value)}
        return _Value(type(value), own)
    return value


def _with(value: Any, expressions: Iterator[SX]) -> Any:
    if value is _Expression:
        return next(expressions)
    if isinstance(value, _Value):
        return value.kind(**{name: _with(item, expressions) for name, item in value.own.items()})
    if isinstance(value, tuple):
        return tuple(_with(item, expressions) for item in value)
    return value
