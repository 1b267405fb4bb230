"""The documentation site: every page is in its menu, every public name in its API reference."""

import re
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest

import cosim

ROOT = Path(__file__).parents[1]
PAGES = sorted((ROOT / "docs").glob("*.md"))


def test_every_page_has_one_place_in_the_menu():
    menu = (
        (ROOT / "mkdocs.yml").read_text().partition("nav:")[2].partition("markdown_extensions")[0]
    )
    assert sorted(re.findall(r"(\w+\.md)$", menu, re.MULTILINE)) == [p.name for p in PAGES]


def test_api_reference_has_every_public_name():
    text = "".join(path.read_text() for path in (ROOT / "docs").glob("reference*.md"))
    listed = re.findall(r"^::: cosim\.(\w+)$", text, re.MULTILINE)
    assert sorted(listed) == sorted(cosim.__all__)


def test_an_entry_of_several_names_is_shown_for_each():
    griffe = pytest.importorskip("griffe")
    place = ROOT / "docs/theme/docstrings.py"
    spec = spec_from_file_location("docstrings", place)
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    text = (
        "Say x, y: well.\n\nArgs:\n    a, b: Two\n        numbers.\n    c: One.\n\nExample:\n"
        "    >>> 1\n    1"
    )
    f = griffe.Function("f", docstring=griffe.Docstring(text))
    module.Sections().on_object(obj=f)
    assert f.docstring.value == (
        "Say x, y: well.\n\nArgs:\n    a: Two\n        numbers.\n    b: Two\n        numbers.\n"
        "    c: One.\n\nExamples:\n    >>> 1\n    1"
    )
