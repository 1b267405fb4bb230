"""Text of foreign origin, made harmless for terminals and spreadsheets."""

import re

LONGEST_SENTENCE = 600  # characters of one message
# Control characters, escapes of terminals among them, and those that turn the writing direction
_UNSEEN = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\u200e\u200f\u202a-\u202e\u2066-\u2069]")


def visible(text: str, *, lines: bool = False) -> str:
    r"""Return a text with control characters shown as escapes, e.g. `\x1b`.

    Args:
        text: Of any origin.
        lines: Keep the ends of lines and tabs.
    """
    return _UNSEEN.sub(lambda m: m[0] if lines and m[0] in "\n\t" else ascii(m[0])[1:-1], text)


def sentence(text: str) -> str:
    """Return a foreign message as one line of bounded length."""
    told = visible(" ".join(text.split()))
    return told if len(told) <= LONGEST_SENTENCE else f"{told[: LONGEST_SENTENCE - 4]} ..."


def csv_cell(text: str) -> str:
    """Return a text that no spreadsheet takes for a formula."""
    shown = visible(text)
    return f"'{shown}" if shown.startswith(("=", "+", "-", "@")) else shown
