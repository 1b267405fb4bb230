"""TOML files with the line number of each key, for error messages."""

import re
import tomllib
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cosim.errors import CosimError, ParameterError, UnknownName, UsageError
from cosim.files import read_text

Key = tuple[str | int, ...]

_HEADER = re.compile(r"\[(\[?)([^\[\]]+)\]")
_NAME = r"[\w-]+|\"[^\"]*\"|'[^']*'"
_ASSIGNMENT = re.compile(rf"((?:{_NAME})(?:\s*\.\s*(?:{_NAME}))*)\s*=(.*)")
_NAMES = re.compile(_NAME)  # a quoted one may hold dots
_QUOTED_OR_COMMENT = re.compile(r"\"(?:\\.|[^\"\\])*\"|'[^']*'|#.*")
_PLACE = re.compile(r" \(at (line \d+, column \d+|end of document)\)$")


@dataclass(frozen=True)
class TomlFile:
    """Content of a TOML file.

    Attributes:
        path: The file.
        data: What it says, as `tomllib` reads it.
        lines: Line of every key; tables of an array are counted from 0.
        text: The lines themselves.
    """

    path: Path
    data: Mapping[str, Any]
    lines: Mapping[Key, int]
    text: tuple[str, ...]

    def at(self, *key: str | int, word: str | None = None) -> str:
        """Return where a key stands, as "FILE, line N".

        Args:
            key: Path of the key, e.g. ("figures", 0, "panels"); its nearest parent counts when it
                has no line of its own.
            word: A string within a value of several lines, whose line number is reported.
        """
        while key and key not in self.lines:
            key = key[:-1]
        if not key:
            return str(self.path)
        line = self.lines[key]
        if word is not None:
            quoted = (f'"{word}"', f"'{word}'")
            found = (n for n in range(line, len(self.text) + 1)
                     if any(q in self.text[n - 1] for q in quoted))  # fmt: skip
            line = next(found, line)
        return f"{self.path}, line {line}"

    @contextmanager
    def naming(self, *key: str | int, word: str | None = None) -> Iterator[None]:
        """Put the place of a key before the message of what goes wrong within; see `at`."""
        try:
            yield
        except CosimError as error:
            raise type(error)(f"{self.at(*key, word=word)}: {error}") from error

    def reject_unknown(self, table: Key, found: Iterable[str], known: Collection[str]) -> None:
        """Reject keys of a table that it does not have."""
        whole = "a system" if "parts" in self.data else "a scene"
        owner = f"[{table[0]}]" if table else whole
        for key in found:
            UnknownName.reject(f"{self.at(*table, key)}: {owner}", "key", known, key)


def read_toml(path: Path) -> TomlFile:
    """Read a TOML file; a byte order mark is tolerated.

    Raises:
        UsageError: It cannot be read or is no TOML; line and column are named.
    """
    text = read_text(path)
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        place = _PLACE.search(str(error))
        where = f", {place[1]}" if place else ""
        raise UsageError(f"{path}{where}: {_PLACE.sub('', str(error))}") from error
    except ValueError as error:
        raise UsageError(f"{path}: a number has too many digits; write it as 1e300") from error
    except RecursionError as error:
        raise UsageError(f"{path}: brackets are nested too deeply; write fewer") from error
    rows = tuple(text.splitlines())
    return TomlFile(path, data, dict(reversed(list(_lines(rows)))), rows)


def typed(value: Any, kind: type, form: str, where: str) -> Any:
    """Return a value of the required type.

    Raises:
        ParameterError: It is of another one; `where` and how to write it are named.
    """
    if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
        raise ParameterError(f"{where}{': ' if where else ''}{value!r} does not fit; write {form}")
    return value


def texts(value: Any, where: str) -> tuple[str, ...]:
    """Return a list of texts; raise `ParameterError` for any other value."""
    names = typed(value, list, "a list of texts", where)
    return tuple(typed(name, str, "a list of texts", where) for name in names)


def text_rows(value: Any, where: str) -> tuple[tuple[str, ...], ...]:
    """Return a list of lists of texts; raise `ParameterError` for any other value."""
    rows = typed(value, list, "a list of lists of texts", where)
    return tuple(texts(typed(row, list, "a list of lists of texts", where), where) for row in rows)


def _lines(rows: tuple[str, ...]) -> Iterator[tuple[Key, int]]:
    """Yield every key with its line; values of several lines are skipped."""
    table: Key = ()
    counts: dict[str, int] = {}
    depth = 0
    for number, row in enumerate(rows, start=1):
        stripped = row.strip()
        if depth:
            depth += _brackets(stripped)
        elif header := _HEADER.match(stripped):
            name = header[2].strip()
            table = _parts(name)
            if header[1]:
                table += (counts.setdefault(name, 0),)
                counts[name] += 1
            yield table, number
        elif assignment := _ASSIGNMENT.match(stripped):
            yield (*table, *_parts(assignment[1])), number
            depth = _brackets(assignment[2])


def _parts(name: str) -> Key:
    """Return the parts of a dotted name without their quotes."""
    return tuple(part.strip("\"'") for part in _NAMES.findall(name))


def _brackets(code: str) -> int:
    bare = _QUOTED_OR_COMMENT.sub("", code)
    return sum(bare.count(c) for c in "[{") - sum(bare.count(c) for c in "]}")
