"""A name means one thing: it has one home in the product.

Counted are functions, classes and constants of modules. Methods are not: they belong to their
class. A private name may occur in a second module, by chance; in a third one it is a habit.
"""

import ast
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from fnmatch import fnmatch
from math import inf
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1] / "src" / "cosim"
# What several modules define on purpose, and which ones
ALLOWED = {
    # A verb: its options, and what it does
    "add_options": ("cli/verbs/*.py",),
    "run": ("cli/verbs/*.py",),
    # The command line; what loads it, under the name that scripts have
    "main": ("cli/main.py", "__main__.py"),
    # What every command imports has no time for `typing`
    "TYPE_CHECKING": ("__init__.py", "presenters.py"),
    # What `cosim` offers, over that of road one: accuracy and budget besides
    "simulate": ("api.py", "integrate/simulate.py"),
}


def sources() -> dict[str, str]:
    """Return the text of every module by its path in `src/cosim`."""
    return {
        path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8")
        for path in sorted(ROOT.rglob("*.py"))
    }


def defined(source: str) -> Iterator[str]:
    """Yield the names that a module defines."""
    for node in ast.parse(source).body:
        match node:
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name):
                yield name
            case ast.ClassDef(name=name):
                yield name
            case ast.Assign(targets=targets):
                yield from (t.id for t in targets if isinstance(t, ast.Name))
            case ast.AnnAssign(target=ast.Name(id=name)):
                yield name


def shared(modules: Mapping[str, str]) -> dict[str, list[str]]:
    """Return the names with more homes than they may have, with these modules."""
    homes: dict[str, list[str]] = defaultdict(list)
    for module, source in modules.items():
        for name in set(defined(source)):
            homes[name].append(module)
    return {n: found for n, found in homes.items() if len(found) > _most(n)}


def _most(name: str) -> float:
    """Return how many modules may define a name; Python's own (`__all__`) belong to each."""
    return inf if name.startswith("__") else 2 if name.startswith("_") else 1


def unexplained(found: Mapping[str, list[str]]) -> dict[str, list[str]]:
    """Return the names with a home that nobody allowed, and their homes."""
    return {name: homes for name, homes in found.items() if not _allowed(name, homes)}


def _allowed(name: str, homes: Iterable[str]) -> bool:
    patterns = ALLOWED.get(name, ())
    return all(any(fnmatch(home, p) for p in patterns) for home in homes)


def test_a_name_has_one_home():
    assert unexplained(shared(sources())) == {}


def test_every_allowed_name_is_needed():
    assert set(ALLOWED) - set(shared(sources())) == set()


@pytest.mark.parametrize(
    "text", ["def same(): ...", "class same: ...", "same = 1", "same: int = 1", "a = same = 1"]
)
def test_guard_sees_a_second_home(text):
    found = shared({"a.py": text, "b.py": "def same(): ..."})
    assert set(unexplained(found)) == {"same"}


def test_guard_sees_an_allowed_name_elsewhere():
    modules = {"cli/verbs/plot.py": "def run(): ...", "memo.py": "def run(): ..."}
    assert set(unexplained(shared(modules))) == {"run"}


def test_guard_sees_a_private_name_in_a_third_module():
    two = {"a.py": "_same = 1", "b.py": "def _same(): ..."}
    assert shared(two) == {}
    found = shared({**two, "c.py": "class _same: ..."})
    assert set(unexplained(found)) == {"_same"}


def test_guard_leaves_methods_and_locals_alone():
    module = "class {}:\n    def same(self):\n        same = 1"
    assert shared({"a.py": module.format("A"), "b.py": module.format("B")}) == {}
