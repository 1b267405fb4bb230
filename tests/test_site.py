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


def imported(name):
    """Return a module of the site's theme."""
    spec = spec_from_file_location(name, ROOT / f"docs/theme/{name}.py")
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_an_entry_of_several_names_is_shown_for_each():
    griffe = pytest.importorskip("griffe")
    module = imported("docstrings")
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


@pytest.mark.parametrize(
    ("address", "expected"),
    [
        (None, "See [events](events.md) and\nthe file."),
        (
            "https://x.org/a",
            "See [events](events.md) and\n[the file](https://x.org/a/blob/HEAD/b/c.py).",
        ),
    ],
    ids=["without an address", "with its address"],
)
def test_links_to_other_files_lead_to_the_repository(address, expected):
    pytest.importorskip("latex2mathml")
    pages = imported("pages")
    text = "See [events](events.md) and\n[the file](../b/c.py)."
    assert pages.on_page_markdown(text, config={"repo_url": address}) == expected
