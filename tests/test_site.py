"""The documentation site: every page is in its menu, every public name in its API reference."""

import re
from pathlib import Path

import cosim

ROOT = Path(__file__).parents[1]
PAGES = sorted((ROOT / "docs").glob("*.md"))


def test_every_page_has_one_place_in_the_menu():
    menu = (
        (ROOT / "mkdocs.yml").read_text().partition("nav:")[2].partition("markdown_extensions")[0]
    )
    assert sorted(re.findall(r"(\w+\.md)$", menu, re.MULTILINE)) == [p.name for p in PAGES]


def test_api_reference_has_every_public_name():
    listed = re.findall(
        r"^::: cosim\.(\w+)$", (ROOT / "docs" / "reference.md").read_text(), re.MULTILINE
    )
    assert sorted(listed) == sorted(cosim.__all__)
