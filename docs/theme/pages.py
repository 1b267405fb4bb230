"""MkDocs hook: turn formulas into MathML, and prepare the Markdown of the pages for it.

MathML is part of HTML: the pages show their formulas without a script and without a network.
"""

import re
from html import unescape
from typing import Any

from latex2mathml.converter import convert

ADJACENT_FORMULAS = re.compile(r"(?<=\S)\$\$\n\$\$(?=\S)")
FORMULA = re.compile(
    r'<(?P<tag>span|div) class="arithmatex">\\[(\[](?P<latex>.*?)\\[)\]]</(?P=tag)>', re.DOTALL
)


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Return the text of a page with fences and formulas as Python-Markdown reads them."""
    markdown = markdown.replace("```python fragment", "```python")  # a mark of tests/test_docs.py
    return ADJACENT_FORMULAS.sub("$$\n\n$$", markdown)


def on_page_content(html: str, **_: Any) -> str:
    """Return the HTML of a page with a `<math>` element in place of each formula."""
    return FORMULA.sub(_mathml, html)


def _mathml(formula: re.Match[str]) -> str:
    display = "inline" if formula["tag"] == "span" else "block"
    return convert(unescape(formula["latex"]).strip(), display=display)
