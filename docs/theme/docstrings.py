"""Griffe extension: show the `Example:` sections of docstrings as code."""

import re
from typing import Any

import griffe


class Examples(griffe.Extension):
    """Give the section the name that griffe parses as doctest; Google's guide allows both."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rename the section in the docstring of an object."""
        if obj.docstring:
            text = re.sub(r"^Example:$", "Examples:", obj.docstring.value, flags=re.MULTILINE)
            obj.docstring.value = text
