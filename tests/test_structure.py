"""The tree as a whole: no circle of imports, its size and density, tests where their code is."""

import ast
import fnmatch
import re
from graphlib import CycleError, TopologicalSorter

import pytest
from helpers.import_graph import FOLDERS, MODULES, ROOT, needs

LONGEST = 500
# Lines of the product in all its languages together, as none of them may be exchanged for another.
# The bound falls with work that adds no capability.
MOST_LINES = 81_506
LANGUAGES = {".py", ".c", ".h", ".js", ".toml", ".css", ".html"}
# Per 1000 lines of Python. Dense lines are no short code; ruff bounds branches and statements.
MOST_NESTED, MOST_TUPLES = 2.0, 15.0  # measured 1.88 and 14.7

# Folders under tests/ beside those of packages
CROSSING = {
    "clients": "what other programs make of our files",
    "cross": "backends against each other",
    "dae": "casadi_models.dae",
    "examples": "programs of the documentation",
    "faults": "cosim.host",
    "helpers": "what tests share",
    "hybrid": "the kernel of events in cosim._fmu, on every backend",
    "mechanics": "casadi_models.mechanics",
    "physics": "the systems of casadi_models",
    "runtime": "cosim._fmu",
    "strangers": "public files of other tools",
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
    files = [path for folder in FOLDERS.values() for path in folder.rglob("*")]
    texts = [path.read_text(encoding="utf-8") for path in files if path.suffix in LANGUAGES]
    assert sum(text.count("\n") for text in texts) <= MOST_LINES


COMPREHENSIONS = ast.ListComp | ast.SetComp | ast.DictComp | ast.GeneratorExp


def nested_comprehensions(tree: ast.AST) -> int:
    """Return the number of comprehensions within another one."""
    outer = (node for node in ast.walk(tree) if isinstance(node, COMPREHENSIONS))
    inner = {
        id(n)
        for node in outer
        for n in ast.walk(node)
        if n is not node and isinstance(n, COMPREHENSIONS)
    }
    return len(inner)


def tuple_assignments(tree: ast.AST) -> int:
    """Return the number of assignments of a written tuple to a tuple of names."""
    nodes = (node for node in ast.walk(tree) if isinstance(node, ast.Assign))
    return sum(
        isinstance(n.targets[0], ast.Tuple) and isinstance(n.value, ast.Tuple) for n in nodes
    )


def test_lines_do_not_grow_denser():
    total = sum(source.count("\n") for source in MODULES.values())
    nested = tuples = 0
    for tree in map(ast.parse, MODULES.values()):
        nested += nested_comprehensions(tree)
        tuples += tuple_assignments(tree)
    assert 1000 * nested / total <= MOST_NESTED
    assert 1000 * tuples / total <= MOST_TUPLES


@pytest.mark.parametrize(
    ("count", "source", "found"),
    [
        (nested_comprehensions, "[[x for x in row] for row in rows]", 1),
        (nested_comprehensions, "[x for row in rows for x in row]", 0),
        (tuple_assignments, "a, b = 1, 2", 1),
        (tuple_assignments, "a, b = f()", 0),
    ],
)
def test_guard_counts_dense_lines(count, source, found):
    assert count(ast.parse(source)) == found


def test_no_file_is_overlong():
    assert {name: n for name, n in lines().items() if n > LONGEST} == {}


def test_architecture_names_files_that_exist():
    page = (ROOT / "docs" / "architecture.md").read_text()
    rows = "".join(re.findall(r"^\| .*", page, re.MULTILINE))
    named = re.findall(r"`([\w/*.]+(?:/|\.(?:py|toml|c|h|js|css|mplstyle)))`", rows)
    folders = [*FOLDERS.values(), ROOT / "docs" / "theme", ROOT / "tests"]
    known = [f"/{p.relative_to(ROOT).as_posix()}" for folder in folders for p in folder.rglob("*")]
    patterns = {name: f"*/{name.rstrip('/')}" for name in named if "SYSTEM" not in name}
    assert [name for name, pattern in patterns.items() if not fnmatch.filter(known, pattern)] == []


def test_every_folder_of_tests_belongs_to_a_package():
    folders = {p.name for p in (ROOT / "tests").iterdir() if p.is_dir() and p.name[0] not in "_."}
    packages = {p.name for p in FOLDERS["cosim"].iterdir() if p.is_dir() and p.name[0] not in "_."}
    assert folders - set(CROSSING) <= packages
