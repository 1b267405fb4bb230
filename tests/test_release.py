"""What a release states about itself: one version, one list of needs, an address, a paper."""

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
RECIPE = (ROOT / "conda/recipe.yaml").read_text(encoding="utf-8")
CONDA_NAMES = {"matplotlib": "matplotlib-base"}


def test_version_is_the_same_everywhere():
    version = PROJECT["version"]
    assert f'version: "{version}"' in RECIPE
    assert f"version: {version}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"## {version}" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def test_recipe_needs_what_the_package_needs():
    run = RECIPE.partition("  run:\n")[2].partition("\n\n")[0]
    listed = set(re.findall(r"- (.+)", run)) - {
        "c-compiler",
        f"python {PROJECT['requires-python']}",
    }
    needed = {re.fullmatch(r"([\w-]+)(.*)", need).groups() for need in PROJECT["dependencies"]}
    assert listed == {f"{CONDA_NAMES.get(name, name)} {bound}" for name, bound in needed}


def test_address_is_entered_once_in_every_place(tmp_path):
    for name in ("pyproject.toml", "CITATION.cff", "mkdocs.yml"):
        shutil.copy(ROOT / name, tmp_path)
    address = "https://example.org/owner/name"
    command = [sys.executable, ROOT / ".ci/addresses", address, tmp_path]
    for _ in range(2):
        subprocess.run(command, check=True)
    written = tomllib.loads((tmp_path / "pyproject.toml").read_text(encoding="utf-8"))
    assert written["project"]["urls"]["Source"] == address
    assert written["project"]["urls"]["Issues"] == f"{address}/issues"
    assert (tmp_path / "CITATION.cff").read_text().count(f'repository-code: "{address}"') == 1
    assert (tmp_path / "mkdocs.yml").read_text().count(f"repo_url: {address}") == 1
    wrong = subprocess.run([*command[:2], "owner/name"], capture_output=True, check=False)
    assert wrong.returncode == 1


def test_paper_has_the_fields_and_sections_that_the_journal_asks_for():
    text = (ROOT / "paper.md").read_text(encoding="utf-8")
    _, head, body = text.split("---\n", 2)
    for field in ("title", "tags", "authors", "affiliations", "date", "bibliography"):
        assert re.search(rf"^{field}:", head, re.MULTILINE)
    for section in ("Summary", "Statement of need", "References"):
        assert f"\n# {section}" in body
    cited = set(re.findall(r"@(\w+)", body))
    known = set(re.findall(r"@\w+\{(\w+),", (ROOT / "paper.bib").read_text(encoding="utf-8")))
    assert cited == known
    assert 250 < len(body.split()) < 1000  # the journal's bounds


def test_recipe_renders():
    tool = pytest.importorskip("rattler_build")  # pip install py-rattler-build
    [rendered] = tool.Stage0Recipe.from_file(str(ROOT / "conda/recipe.yaml")).render()
    assert f"version='{PROJECT['version']}'" in repr(rendered)
