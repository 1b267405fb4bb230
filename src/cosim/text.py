"""Text output: escaped foreign text, shortened lists, tables as text, HTML and CSV."""

import csv
import io
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from html import escape
from textwrap import fill
from typing import Any

LONGEST_SENTENCE = 600  # characters of one message
LONGEST_MESSAGE = 6000  # of an error, with what a compiler or a library says
LONGEST_WORD = 300  # of a word, a list or a quoted text in it
_ENDLESS = re.compile(r"(?<!\w)'[^'\n]{300,}'|\[[^][\n]{300,}\]|\S{300,}")
# Control characters, escapes of terminals among them, and those that turn the writing direction
_UNSEEN = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\u200e\u200f\u202a-\u202e\u2066-\u2069]")
_INSTEAD = re.compile(r".*? \(([^()]*)\)")


def visible(text: str, *, lines: bool = False) -> str:
    r"""Return a text with escapes, e.g. `\x1b`, for control characters; `lines` keeps line ends."""
    return _UNSEEN.sub(lambda m: m[0] if lines and m[0] in "\n\t" else ascii(m[0])[1:-1], text)


def counted(number: int, noun: str) -> str:
    """Return a number with its noun, e.g. "1 run", "2 runs" or "no runs"."""
    return f"{number or 'no'} {noun}{'s' * (number != 1)}"


def sentence(text: str) -> str:
    """Return a foreign message as one line of bounded length."""
    line = visible(" ".join(text.split()))
    return line if len(line) <= LONGEST_SENTENCE else f"{line[: LONGEST_SENTENCE - 4]} ..."


def one_note(*notes: str | None) -> str:
    """Return notes in one line, without empty ones; "" if all are."""
    return "; ".join(filter(None, notes))


def with_unit(value: float, unit: str, digits: int = 6) -> str:
    """Return a number, with its unit if it has one."""
    return f"{value:.{digits}g}" if unit == "1" else f"{value:.{digits}g} {unit}"


def axis_label(label: str, unit: str, letters: int = 100) -> str:
    """Return the label of an axis, in lines of at most so many letters.

    A number has no unit, and nor has a column of a file that names none.
    """
    brackets = [] if unit == "1" else [f"[{unit}]"]
    text = " ".join([label, *brackets])
    return text if len(text) <= letters else "\n".join([fill(label, letters), *brackets])


def described(error: BaseException) -> str:
    """Return type and message of a foreign exception as one line of bounded length."""
    try:
        message = str(error)
    except Exception:  # of a class of the user
        message = ""
    return sentence(f"{type(error).__name__}: {message}").removesuffix(":")


def bounded(text: str, most: int = LONGEST_MESSAGE) -> str:
    """Return a text without its middle if that is long."""
    return text if len(text) <= most else f"{text[: most // 2]} ... {text[-most // 2 :]}"


def readable(message: str, *, lines: bool = True) -> str:
    """Return a visible message of bounded length, without the middle of endless texts and lists."""
    shown = visible(message, lines=lines)
    return bounded(_ENDLESS.sub(lambda found: bounded(found[0], LONGEST_WORD), shown))


def violated(condition: str) -> str:
    """Return what is wrong where a validity condition does not hold.

    If the condition ends with what happens instead, in parentheses, that is the answer.
    """
    found = _INSTEAD.fullmatch(condition)
    return found[1] if found else f"not fulfilled: {condition}"


class Violation(str):
    """A reason why a run is invalid from a time on: a text that knows its parts.

    Attributes:
        time: The time, s.
        what: What is wrong; without the time, unless the text is a sentence of its own.
    """

    time: float
    what: str

    def __new__(cls, time: float, what: str, text: str | None = None) -> "Violation":
        """Return the text: by default "invalid from TIME s: WHAT"."""
        self = super().__new__(cls, text or f"invalid from {moment(time, 6)} s: {what}")
        self.time, self.what = time, what
        return self

    def __reduce__(self) -> tuple[type["Violation"], tuple[float, str, str]]:
        return Violation, (self.time, self.what, str(self))


def violations_in(texts: Iterable[str]) -> list[tuple[int, float, str, str]]:
    """Return position, time, s, what is wrong, and text of each `Violation` among texts."""
    return [(i, t.time, t.what, str(t)) for i, t in enumerate(texts) if isinstance(t, Violation)]


class EndKind(StrEnum):
    """What ended a run early."""

    INTERRUPTED = "interrupted"  # Ctrl-C
    SINGULAR = "singular"  # the solver found no solution with steps of any size
    TOO_MANY_STEPS = "too many steps"
    STIFF = "stiff"  # for a solver that then leaves the run to another one
    INVALID = "invalid"  # a validity condition
    EVENT = "event"  # one without a result, which is so with every solver
    FAILED = "failed"


class Ending(str):
    """Why a run stopped early: a text that knows its parts; empty if it did not.

    Attributes:
        kind: What ended it.
        remedy: The last part of the text, what helps; empty if that is not known.
    """

    kind: EndKind
    remedy: str

    def __new__(cls, why: str = "", kind: EndKind = EndKind.FAILED, remedy: str = "") -> "Ending":
        """Return the text "WHY; REMEDY"."""
        self = super().__new__(cls, f"{why}; {remedy}" if remedy else why)
        self.kind, self.remedy = kind, remedy
        return self

    def after(self, time: float | None) -> "Ending":
        """Return the status of a run: this text with the last time of a result, s, or None."""
        last = "the start" if time is None else f"{moment(time, 6)} s"
        return Ending(f"stopped after {last}: {self}", self.kind)

    def __reduce__(self) -> tuple[type["Ending"], tuple[str, EndKind, str]]:
        return Ending, (self.removesuffix(f"; {self.remedy}"), self.kind, self.remedy)


def short_reason(reason: str) -> str:
    """Return a reason, with few digits of its time if it is a `Violation`."""
    if not isinstance(reason, Violation) or reason.what == reason:
        return reason
    return f"invalid from {moment(reason.time)} s: {reason.what}"


def moment(time: float, digits: int = 3) -> str:
    """Return a time, s, with a few digits, and at least with hundredths from 1 s on."""
    short = abs(time) < 10 ** (digits - 2)
    return f"{time:.{digits}g}" if short else f"{time:.2f}".rstrip("0").rstrip(".")


def csv_cell(text: str) -> str:
    """Return a text that no spreadsheet takes for a formula."""
    shown = visible(text)
    return f"'{shown}" if shown.startswith(("=", "+", "-", "@")) else shown


MOST_NAMES = 8  # in a line


def shortened(names: Sequence[str], most: int) -> str:
    """Return names with commas between them, and dots for those beyond `most`."""
    return ", ".join(names[:most]) + (", ..." if len(names) > most else "")


MOST_LINES = 15  # of a value's summary at a prompt
GAP = "  "


@dataclass(frozen=True)
class Table:
    """Rows with the same keys, e.g. for `pandas.DataFrame(table.rows)`; shown as a table.

    Attributes:
        rows: One mapping per line.
        caption: What stands above them.
        digits: Of numbers, where they are shown.
    """

    rows: tuple[Mapping[str, Any], ...]
    caption: str = ""
    digits: int = 3

    def __iter__(self) -> Iterator[Mapping[str, Any]]:
        return iter(self.rows)

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, position: int) -> Mapping[str, Any]:
        return self.rows[position]

    def to_csv(self) -> str:
        """Return the rows as CSV."""
        return csv_text(self.rows)

    def to_json(self) -> str:
        """Return the rows as JSON."""
        return json_text([*self.rows], indent=1) + "\n"

    def __repr__(self) -> str:
        text = text_table(self.rows, digits=self.digits)
        return "\n".join(part for part in (self.caption, text) if part)

    def _repr_html_(self) -> str:
        return html_table(self.rows, self.caption, digits=self.digits)


def cell(value: Any, digits: int = 3) -> str:
    """Return a value as it stands in a table: numbers with a few digits."""
    if isinstance(value, float):
        return f"{value + 0.0:.{digits}g}"  # -0.0 as 0
    return "" if value is None else visible(str(value))


def text_table(
    rows: Sequence[Mapping[str, Any]],
    *,
    width: int | None = None,
    most: int | None = None,
    digits: int = 3,
) -> str:
    """Return rows that have the same keys as aligned lines under a header; "" without rows.

    Args:
        rows: One mapping per line.
        width: Number of letters of a line; the longest cells are cut for it.
        most: Number of lines; what is left out is counted in the last one.
        digits: Of numbers.
    """
    if not rows:
        return ""
    left_out = 0 if most is None else max(0, len(rows) + 1 - most)
    shown = rows[: len(rows) - left_out - 1] if left_out else rows
    lines = [[*rows[0]], *([cell(value, digits) for value in row.values()] for row in shown)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    if width is not None:
        widths = _fitting_widths(widths, width - len(GAP) * (len(widths) - 1))
    text = [
        GAP.join(_cut(c, w).ljust(w) for c, w in zip(line, widths, strict=True)).rstrip()
        for line in lines
    ]
    if left_out:
        text.append(f"... and {left_out + 1} more")
    return "\n".join(text)


def html_table(rows: Sequence[Mapping[str, Any]], caption: str = "", *, digits: int = 3) -> str:
    """Return rows that have the same keys as an HTML table."""
    if not rows:
        return f"<p>{escape(caption)}</p>"
    head = "".join(f"<th>{escape(str(key))}</th>" for key in rows[0])
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(cell(v, digits))}</td>" for v in row.values()) + "</tr>"
        for row in rows
    )
    above = f"<caption>{escape(caption)}</caption>" if caption else ""
    return f"<table>{above}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def html_list(heading: str, texts: Iterable[str]) -> str:
    """Return texts as an HTML list below a heading; "" if there are none."""
    items = "".join(f"<li>{escape(text)}</li>\n" for text in texts)
    return f"<p>{escape(heading)}</p>\n<ul>\n{items}</ul>\n" if items else ""


def json_text(facts: Any, indent: int | None = None) -> str:
    """Return plain values as JSON, which has null where a number is not finite."""
    plain = json.loads(json.dumps(facts, default=dict), parse_constant=lambda _: None)
    return json.dumps(plain, indent=indent)


def csv_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return rows that have the same keys as CSV; reading returns the same numbers."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    names = [*rows[0]] if rows else []
    for line in (names, *([row[name] for name in names] for row in rows)):
        writer.writerow([csv_cell(c) if isinstance(c, str) else c for c in line])
    return text.getvalue()


def _fitting_widths(widths: Sequence[int], width: int, least: int = 8) -> list[int]:
    """Return column widths that fit into a line; the widest columns are narrowed."""
    fitted = [*widths]
    while sum(fitted) > width and max(fitted) > least:
        fitted[fitted.index(max(fitted))] -= 1
    return fitted


def _cut(text: str, width: int) -> str:
    return text if len(text) <= width else f"{text[: max(0, width - 1)]}\u2026"
