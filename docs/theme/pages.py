"""MkDocs hook: formulas become MathML, links to the repository lead there, and pages compute.

MathML is part of HTML: the pages show their formulas without a script and without a network.
"""

import re
from html import unescape
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert

ADJACENT_FORMULAS = re.compile(r"(?<=\S)\$\$\n\$\$(?=\S)")
OUTSIDE = re.compile(r"\[([^\]]+)\]\(\.\./([^)\s]+)\)")  # a link to a file that is no page
FORMULA = re.compile(
    r'<(?P<tag>span|div) class="arithmatex">\\[(\[](?P<latex>.*?)\\[)\]]</(?P=tag)>', re.DOTALL
)

LIVE = (
    "crank_shaft",
    "bar_on_frame",
    "bicycle",
    "disk_two_bars",
    "double_pendulum",
    "examples/coupled/ride.toml",
    "examples/coupled/quarter_car.toml",
    "examples/furuta.py:build",
)


def on_page_markdown(markdown: str, config: Any, **_: Any) -> str:
    """Return the text of a page with fences and formulas as Python-Markdown reads them.

    Links to other files of the repository lead to its address, or are plain text without one.
    """
    markdown = markdown.replace("```python fragment", "```python")  # a mark of tests/test_docs.py
    address = config["repo_url"]
    markdown = OUTSIDE.sub(rf"[\1]({address}/blob/HEAD/\2)" if address else r"\1", markdown)
    return ADJACENT_FORMULAS.sub("$$\n\n$$", markdown)


def on_page_content(html: str, **_: Any) -> str:
    """Return the HTML of a page with a `<math>` element in place of each formula."""
    return FORMULA.sub(_mathml, html)


def _mathml(formula: re.Match[str]) -> str:
    display = "inline" if formula["tag"] == "span" else "block"
    return convert(unescape(formula["latex"]).strip(), display=display)


def on_post_build(config: Any, **_: Any) -> None:
    """Write the pages that compute; a sentence instead where their tools are missing."""
    from cosim.cli.main import main

    folder = Path(config["site_dir"]) / "live"
    folder.mkdir(exist_ok=True)
    for source in LIVE:
        path = folder / f"{Path(source.partition(':')[0]).stem}.html"
        if main(["animate", source, "--live", "-q", "-o", str(path)]) != 0:
            path.write_text("This page needs the tools of cosim-rigid[live].", encoding="utf-8")
