"""Who may know whom: a module imports only from layers below its own.

Imports inside functions and `import_module` count. The two backends share a layer, so that they
stay independent and meet in `Trajectory` only.
"""

import inspect
import re
import sys
import tomllib

import pytest
from helpers.import_graph import FOLDERS, MODULES, ROOT, imports

import cosim
from cosim.presenters import presenter

# One line per layer, the lowest first; an indented line goes on with it. `|` parts what does not
# know each other; names without one between them are one part. A name stands for all modules of
# its folder ("cosim" does not).
TABLE = """
cosim._fmu | casadi_models | cosim.text | cosim.extensions | cosim.argument_types
cosim.errors | cosim.memo | cosim.arrays | cosim.presenters | cosim.colors
cosim.host | cosim.model.quantities
cosim.files
cosim.toml_file
cosim.plotting | cosim.series
cosim.trajectory
cosim.model | cosim.codegen
cosim.drawing
cosim.integrate | cosim.fmi
cosim.backend | cosim.coupling
cosim.scene
cosim.verify
cosim.study
cosim.session
cosim.api
cosim.present
cosim cosim.solvers cosim.contact cosim.kane cosim.rotations | cosim.cli
cosim.__main__
"""
LAYERS = {
    name: (layer, part)
    for layer, line in enumerate(TABLE.replace("\n  ", " ").split("\n"))
    for part, names in enumerate(line.split("|"))
    for name in names.split()
}


def place(module: str) -> tuple[int, int] | None:
    """Return layer and part of a module; None when the table does not have it."""
    if module in LAYERS:
        return LAYERS[module]
    parents = [name for name in LAYERS if name != "cosim" and module.startswith(f"{name}.")]
    return LAYERS[parents[0]] if parents else None


def violations(module: str, source: str) -> list[str]:
    """Return what a module imports against the direction of the layers, in words."""
    own, found = place(module), []
    if own is None:
        return [f"{module} has no layer"]
    for name in imports(source):
        if name.startswith("."):
            found.append(f"{module} imports {name} by a relative name")
        elif name.partition(".")[0] in FOLDERS:
            other = place(name)
            if other is None:
                found.append(f"{module} imports {name}, which has no layer")
            elif other != own and other[0] >= own[0]:
                found.append(f"{module} (layer {own[0]}) imports {name} (layer {other[0]})")
    return found


def third_party(source: str) -> set[str]:
    """Return the top names of what is imported from outside the project and Python."""
    roots = {name.partition(".")[0] for name in imports(source)}
    return roots - sys.stdlib_module_names - set(FOLDERS)


@pytest.mark.parametrize("module", MODULES)
def test_module_imports_only_from_lower_layers(module):
    assert violations(module, MODULES[module]) == []


@pytest.mark.parametrize("module", [m for m in MODULES if m.startswith("casadi_models")])
def test_models_import_casadi_and_nothing_of_the_product(module):
    assert third_party(MODULES[module]) <= {"casadi"}


@pytest.mark.slow
def test_what_is_imported_is_declared_as_a_dependency():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    declared = [*project["dependencies"], *extras["data"], *extras["zig"], *extras["check"]]
    names = {re.match(r"[\w-]+", requirement)[0] for requirement in declared}
    names |= {"PIL"} if "pillow" in names else set()  # the one whose import name is another
    assert set().union(*map(third_party, MODULES.values())) <= names


def test_only_the_package_names_what_presents_results():
    naming = [m for m, source in MODULES.items() if "present_by(" in source]
    assert sorted(naming) == ["cosim", "cosim.presenters"]


def test_what_presents_results_is_there():
    assert presenter("animate") is inspect.unwrap(cosim.animate)


def test_only_one_module_knows_where_the_c_sources_are():
    knowing = [m for m, source in MODULES.items() if "cosim._fmu" in source]
    assert knowing == ["cosim.codegen.c_sources"]


@pytest.mark.parametrize(
    ("module", "source"),
    [
        pytest.param("casadi_models.dae", "import cosim", id="upward"),
        pytest.param("casadi_models.dae", "from cosim.errors import X", id="upward from"),
        pytest.param("cosim.errors", "from cosim import integrate", id="module from package"),
        pytest.param("cosim.errors", "def f():\n    import cosim.cli.main", id="in a function"),
        pytest.param("cosim.errors", "from importlib import import_module as m, import_module\n"
                     "import_module('cosim.cli.main')", id="by name"),
        pytest.param("cosim.integrate.call", "import cosim.fmi.ssp", id="backends"),
        pytest.param("cosim.fmi.ssp", "import cosim.integrate.solvers", id="backends, back"),
        pytest.param("cosim.codegen.compiler", "import cosim.model.values", id="same layer"),
        pytest.param("cosim.fmi.ssp", "from . import archive", id="relative"),
        pytest.param("cosim.verify.comparison", "import cosim.new", id="import without a layer"),
        pytest.param("cosim.new", "", id="without a layer"),
        pytest.param("cosim._fmu", "import casadi_models", id="C sources"),
    ],
)  # fmt: skip
def test_guard_sees_a_violation(module, source):
    assert len(violations(module, source)) == 1


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("cosim.verify.comparison", "import cosim.trajectory\nimport casadi_models.dae"),
        ("cosim.fmi.export.package", "from cosim.fmi.export import variables"),
        ("cosim.integrate.run", "from cosim.integrate import solvers"),
        ("casadi_models", "import_module(f'casadi_models.{model}')"),
    ],
)
def test_guard_lets_downward_imports_pass(module, source):
    assert violations(module, source) == []
