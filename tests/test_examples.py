"""The examples in docstrings of what `import cosim` offers run and give what they print."""

import doctest
import inspect
from importlib import import_module

import pytest

import cosim

# Public names without an example, and why
WITHOUT = {
    "extremes": "its cases take minutes",
    "from_sympy": "docs/user_models.md has one",
    "mechanism": "docs/user_models.md has one",
}
MODULES = ("contact", "errors", "kane", "rotations", "solvers")


def examples(value, name):
    """Return the doctests of a value and of its own methods."""
    module = inspect.getmodule(value)
    found = doctest.DocTestFinder(recurse=True).find(value, name, module=module)
    return [test for test in found if test.examples]


@pytest.mark.slow_rows("Comparison", "couple", "reference", "sensitivity", "simulate_many")
@pytest.mark.parametrize("name", [n for n in cosim.__all__ if n not in MODULES])
def test_examples_of_a_public_name_hold(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = examples(getattr(cosim, name), name)
    assert found or name in WITHOUT, f"{name} needs an example in its docstring"
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS)
    for test in found:
        runner.run(test)
    assert runner.summarize(verbose=False).failed == 0


@pytest.mark.parametrize("module", ["cosim", "cosim.model.quantities"])
def test_examples_of_a_module_hold(module, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # those of names that are loaded already write files
    assert doctest.testmod(import_module(module)).failed == 0


@pytest.mark.parametrize("module", MODULES)
def test_a_public_module_can_be_imported_from(module):
    imported = import_module(f"cosim.{module}")
    offered = getattr(cosim, module)
    public = [name for name in vars(offered) if not name.startswith("_")]
    assert all(getattr(imported, name) is getattr(offered, name) for name in public)


def test_public_names_are_the_only_ones():
    assert {*dir(cosim)} == {*cosim.__all__, "__version__"}
    assert all(getattr(cosim, name) is not None for name in dir(cosim))
    with pytest.raises(AttributeError, match="did you mean simulate"):
        _ = cosim.similate
