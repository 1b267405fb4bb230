"""The tree as a whole: no circle of imports, no overlong file, and tests where their code is."""

from graphlib import CycleError, TopologicalSorter

import pytest
from helpers.import_graph import FOLDERS, MODULES, ROOT, needs

MOST_FILES, MOST_LINES, LONGEST = 240, 35_500, 500

# Folders under tests/ beside those of packages
CROSSING = {
    "clients": "what other programs make of our files",
    "cross": "backends against each other",
    "dae": "casadi_models.dae",
    "examples": "programs of the documentation",
    "faults": "cosim.host",
    "helpers": "what tests share",
    "mechanics": "casadi_models.mechanics",
    "physics": "the systems of casadi_models",
    "runtime": "cosim._fmu",
}


def circle(graph: dict[str, set[str]]) -> list[str]:
    """Return modules that load each other, in their order; none where there is no circle."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        found: list[str] = error.args[1]
        return found
    return []


def lines() -> dict[str, int]:
    """Return the number of lines of every file of `src/cosim`."""
    found = FOLDERS["cosim"].rglob("*.py")
    return {str(p.relative_to(ROOT)): p.read_text().count("\n") for p in found}


def test_no_module_loads_one_that_loads_it():
    assert circle(needs(MODULES)) == []


@pytest.mark.parametrize(
    "source",
    ["import b", "from b import x", "def f():\n    import b", "import importlib\n"
     "importlib.import_module('b')"],
)  # fmt: skip
def test_guard_sees_a_circle(source):
    assert circle(needs({"a": source, "b": "import c", "c": "import a"})) != []


def test_guard_lets_types_pass():
    a = "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import b"
    assert circle(needs({"a": a, "b": "import a"})) == []


def test_the_product_stays_within_its_budget():
    assert len(lines()) <= MOST_FILES
    assert sum(lines().values()) <= MOST_LINES


def test_no_file_is_overlong():
    assert {name: n for name, n in lines().items() if n > LONGEST} == {}


def test_every_folder_of_tests_belongs_to_a_package():
    folders = {p.name for p in (ROOT / "tests").iterdir() if p.is_dir() and p.name[0] not in "_."}
    packages = {p.name for p in FOLDERS["cosim"].iterdir() if p.is_dir() and p.name[0] not in "_."}
    assert folders - set(CROSSING) <= packages


def test_every_test_listed_as_slow_exists():
    for line in (ROOT / "tests/slow.txt").read_text(encoding="utf-8").splitlines():
        path, _, name = line.partition("::")
        function = name.partition("[")[0].rpartition("::")[2]
        assert f"def {function}(" in (ROOT / path).read_text(encoding="utf-8"), line
