"""Scalar variables of vector and matrix symbols: `y` has `y_1` ... `y_n`, `A` has `A_1_2`."""

import re
import unicodedata
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
from casadi import MX, SX

from cosim.errors import UsageError

_NUMBERED = re.compile(r"(.+)_(\d+)")
_LETTER = re.compile(  # Unicode's names: GREEK SMALL LETTER FINAL SIGMA, LATIN SMALL LIGATURE OE
    r"(?:GREEK|LATIN) (SMALL|CAPITAL) (?:LETTER|LIGATURE) (?:FINAL )?([A-Z]+)(?: WITH [A-Z ]+)?"
)
_SPELT = {"ß": "ss", "λ": "lambda", "Λ": "Lambda", "ħ": "hbar"}  # Unicode has lamda
_SPELT |= {"\u2206": "Delta", "\u2202": "partial", "\u2207": "nabla"}
_DOTS = {"\u0307": "_dot", "\u0308": "_ddot", "\u20db": "_dddot"}
_UMLAUT = re.compile("(?<=[aeiou])\u0308", flags=re.IGNORECASE)


@dataclass(frozen=True, eq=False)  # CasADi's == builds an expression
class Symbol:
    """A scalar, vector or matrix of variables.

    Attributes:
        name: As its author wrote it.
        shape: Rows and columns.
        symbol: SX or MX of that shape, or the scalars of it as a column.
    """

    name: str
    shape: tuple[int, int]
    symbol: SX | MX

    @cached_property
    def entries(self) -> tuple[str, ...]:
        """Names of its variables, column by column as in `ca.vec`."""
        rows, columns = self.shape
        base = identifier(self.name)
        if rows == columns == 1:
            return (base,)
        if 1 in self.shape:
            return tuple(f"{base}_{i + 1}" for i in range(rows * columns))
        return tuple(f"{base}_{i + 1}_{j + 1}" for j in range(columns) for i in range(rows))


def identifier(name: str) -> str:
    """Return a name that C, XML and Python take: `body.x` is `body_x`, `v[1]` `v_1`, `φ` `phi`."""
    plain = re.sub(r"\W+", "_", _in_ascii(name), flags=re.ASCII).strip("_") or "v"
    return plain if plain[0].isalpha() else f"v_{plain}"


def _in_ascii(name: str) -> str:
    """Write out Greek letters and a rate's dots; leave other marks out, and those of umlauts.

    A letter that is neither Latin nor Greek has no spelling, and is written by its number.
    """
    return "".join(map(_letter, _UMLAUT.sub("", unicodedata.normalize("NFKD", name))))


def _letter(character: str) -> str:
    if character.isascii():
        return character
    if character in _SPELT:
        return _SPELT[character]
    if unicodedata.combining(character):
        return _DOTS.get(character, "")
    letter = _LETTER.fullmatch(unicodedata.name(character, ""))
    if letter:
        return letter[2].lower() if letter[1] == "SMALL" else letter[2].title()
    return f"u{ord(character):04x}" if character.isalnum() else character


def named_symbols(who: str, kind: str, value: Any) -> tuple[Symbol, ...]:
    """Return the symbols of a column, a matrix or a list of them.

    Raises:
        UsageError: It holds something else.
    """
    if isinstance(value, Sequence) and not isinstance(value, str):
        return tuple(symbol for item in value for symbol in named_symbols(who, kind, item))
    if not isinstance(value, SX | MX):
        raise UsageError(f"{who}: {kind} is {value!r}; give symbols, SX.sym or MX.sym")
    if not value.is_valid_input():
        raise UsageError(f"{who}: {kind} is the expression {value}; give symbols only")
    if isinstance(value, SX):
        return tuple(_of_sx(who, kind, value))
    return tuple(Symbol(s.name(), s.shape, s) for s in value.primitives() if s.numel())


def named_apart(groups: Sequence[tuple[Symbol, ...]]) -> list[tuple[Symbol, ...]]:
    """Return groups of symbols with the scalars of a vector apart if names would be equal.

    `d_0`, `d_1` in one group are the vector d with entries `d_1`, `d_2`; a `d_2` in another one is
    what an index reduction leaves of it. CasADi's own names tell them apart.
    """
    every = Counter(entry for group in groups for symbol in group for entry in symbol.entries)
    return [
        tuple(
            part
            for symbol in group
            for part in (
                _scalars(symbol) if any(every[e] > 1 for e in symbol.entries) else [symbol]
            )
        )
        for group in groups
    ]


def reject_duplicates(who: str, groups: Sequence[tuple[Symbol, ...]]) -> None:
    """Reject symbols whose names become equal in C and XML.

    Raises:
        UsageError: Names both, and what they would be called.
    """
    owners: dict[str, str] = {}
    for symbol in (symbol for group in groups for symbol in group):
        for entry in symbol.entries:
            other = owners.setdefault(entry, symbol.name)
            if other != symbol.name:
                raise UsageError(
                    f"{who}: '{other}' and '{symbol.name}' are both called '{entry}' in letters, "
                    "digits and _; choose other names"
                )


def _scalars(symbol: Symbol) -> list[Symbol]:
    if not isinstance(symbol.symbol, SX) or 1 not in symbol.shape:
        return [symbol]
    return [Symbol(s.name(), (1, 1), s) for s in ca.vertsplit(ca.vec(symbol.symbol))]


def _of_sx(who: str, kind: str, value: SX) -> Iterator[Symbol]:
    if not value.is_dense():
        raise UsageError(f"{who}: {kind} is sparse; give dense symbols, or a list of its entries")
    scalars = ca.vertsplit(ca.vec(value)) if value.numel() else []
    names = [scalar.name() for scalar in scalars]
    if 1 not in value.shape and value.numel():
        numbered = [_NUMBERED.fullmatch(name) for name in names]
        base = numbered[0][1] if numbered[0] else names[0]
        if [f"{base}_{i}" for i in range(len(names))] == names:
            yield Symbol(base, value.shape, ca.vec(value))
            return
    i = 0
    while i < len(scalars):
        size = _scalars_of_vector(names[i:])
        name = names[i] if size == 1 else names[i].rpartition("_")[0]
        yield Symbol(name, (size, 1), ca.vertcat(*scalars[i : i + size]))
        i += size


def _scalars_of_vector(names: list[str]) -> int:
    """Return how many leading names are y_0, y_1, ...: the scalars of one vector symbol."""
    match = _NUMBERED.fullmatch(names[0])
    if match is None or match[2] != "0":
        return 1
    size = 1
    while size < len(names) and names[size] == f"{match[1]}_{size}":
        size += 1
    return size
