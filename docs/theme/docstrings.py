"""Griffe extension: sections and entries of docstrings as griffe reads them."""

import re
from typing import Any

import griffe

# An entry of a section that describes several names: "    start, stop: ..." and its further lines
_JOINT = re.compile(r"^( +)(\w+(?:, \w+)+)(:.*(?:\n\1 +.*)*)", re.MULTILINE)


class Sections(griffe.Extension):
    """Give griffe what it parses: `Examples:` as doctest, and an entry for each name."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rewrite the docstring of an object."""
        if obj.docstring:
            text = re.sub(r"^Example:$", "Examples:", obj.docstring.value, flags=re.MULTILINE)
            obj.docstring.value = _JOINT.sub(_one_each, text)


def _one_each(entry: re.Match[str]) -> str:
    indent, names, meaning = entry.groups()
    return "\n".join(f"{indent}{name}{meaning}" for name in names.split(", "))
