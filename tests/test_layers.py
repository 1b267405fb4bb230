"""Who may know whom: a module imports only from layers below its own.

Imports inside functions and `import_module` count. The two roads share a layer, so that they
stay independent and meet in `Trajectory` only.
"""

import ast
import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = {
    "casadi_models": ROOT / "casadi_models",
    "cosim": ROOT / "src" / "cosim",
    "cosim._fmu": ROOT / "fmu",
}

# One line per layer, the lowest first; an indented line goes on with it. `|` parts what does not
# know each other; names without one between them are one part. A name stands for all modules of
# its folder ("cosim" does not).
TABLE = """
cosim._fmu
casadi_models
cosim.errors | cosim.keeping
cosim.files | cosim.inputs | cosim.loading cosim.dae_builder | cosim.resources
  | cosim.toml_file | cosim.values cosim.goals
cosim.trajectory
cosim.archive | cosim.buffers | cosim.compile | cosim.consistent | cosim.drift
  | cosim.dop853 cosim.stage_sums | cosim.generated | cosim.projection
cosim.reduction | cosim.scene cosim.scene_figures
cosim.grids cosim.externals cosim.runge_kutta cosim.explicit cosim.solvers cosim.engines
  cosim.calling cosim.observation cosim.monitors cosim.integrate
  | cosim.export | cosim.fmpy_run cosim.fmpy_inputs cosim.fmpy_instance cosim.isolated
cosim.comparison | cosim.inspection | cosim.roads | cosim.scene_file
cosim.references
cosim.crosschecks | cosim.tradeoffs | cosim.extremes cosim.limit_cases cosim.limit_oracles
cosim.fronts cosim.checked_runs cosim.accurate_runs cosim.budgeted_runs cosim.promises
cosim.plots cosim.figures cosim.picture_files cosim.tradeoff_figure cosim.limit_map
cosim.proof | cosim.ssp
cosim.fmu_promises
cosim
cosim.cli cosim.commands cosim.commands_tradeoff cosim.commands_extremes cosim.arguments
  cosim.tables
cosim.__main__
"""
LAYERS = {
    name: (layer, part)
    for layer, line in enumerate(TABLE.replace("\n  ", " ").split("\n"))
    for part, names in enumerate(line.split("|"))
    for name in names.split()
}
# Upward all the same, each with its reason
EXCEPTIONS = {
    ("cosim.errors", "cosim.trajectory"): "annotation only: a failed run carries what it computed",
    ("cosim.integrate", "cosim.promises"): "simulate(accuracy=...); loaded when it is asked for",
    ("cosim.trajectory", "cosim.plots"): "run.plot() is in the contract; loaded when it is called",
}


def modules() -> dict[str, str]:
    """Return the source of every module by its import name."""
    sources = {}
    for package, folder in FOLDERS.items():
        for path in folder.rglob("*.py"):
            parts = path.relative_to(folder).with_suffix("").parts
            name = ".".join((package, *parts)).removesuffix(".__init__")
            sources[name] = path.read_text(encoding="utf-8")
    return sources


MODULES = modules()


def place(module: str) -> tuple[int, int] | None:
    """Return layer and part of a module; None when the table does not have it."""
    if module in LAYERS:
        return LAYERS[module]
    parents = [name for name in LAYERS if name != "cosim" and module.startswith(f"{name}.")]
    return LAYERS[parents[0]] if parents else None


def imports(source: str) -> Iterator[str]:
    """Yield the names of the modules that a source imports; a relative one begins with a dot."""
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Import(names=names):
                yield from (alias.name for alias in names)
            case ast.ImportFrom(module=base, names=names, level=level):
                base = "." * level + (base or "")
                inner = [f"{base}.{alias.name}" for alias in names]
                yield from (name if name in MODULES else base for name in inner)
            case ast.Call(
                func=ast.Name(id="import_module" | "__import__")
                | ast.Attribute(attr="import_module"),
                args=[ast.Constant(value=str(name)), *_]
                | [ast.JoinedStr(values=[ast.Constant(value=str(name)), *_]), *_],
            ):
                yield name.rstrip(".")


def violations(module: str, source: str) -> list[str]:
    """Return what a module imports against the direction of the layers, in words."""
    own, found = place(module), []
    if own is None:
        return [f"{module} has no layer"]
    for name in imports(source):
        if name.startswith("."):
            found.append(f"{module} imports {name} by a relative name")
        elif name.partition(".")[0] in FOLDERS and (module, name) not in EXCEPTIONS:
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


def test_what_is_imported_is_declared_as_a_dependency():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    declared = [*project["dependencies"], *extras["data"], *extras["zig"]]
    names = {re.match(r"[\w-]+", requirement)[0] for requirement in declared}
    names |= {"PIL"} if "pillow" in names else set()  # the one whose import name is another
    assert set().union(*map(third_party, MODULES.values())) <= names


def test_only_one_module_knows_where_the_c_sources_are():
    assert [m for m, source in MODULES.items() if "cosim._fmu" in source] == ["cosim.resources"]


@pytest.mark.parametrize(("module", "imported"), EXCEPTIONS)
def test_exception_is_still_needed(module, imported):
    assert imported in imports(MODULES[module])


@pytest.mark.parametrize(
    ("module", "source"),
    [
        pytest.param("casadi_models.dae", "import cosim", id="upward"),
        pytest.param("casadi_models.dae", "from cosim.errors import X", id="upward from"),
        pytest.param("cosim.errors", "from cosim import integrate", id="module from package"),
        pytest.param("cosim.errors", "def f():\n    import cosim.cli", id="in a function"),
        pytest.param("cosim.errors", "from importlib import import_module as m, import_module\n"
                     "import_module('cosim.cli')", id="by name"),
        pytest.param("cosim.integrate", "from cosim.export.package import export_fmu", id="roads"),
        pytest.param("cosim.export.package", "import cosim.solvers", id="roads, the other way"),
        pytest.param("cosim.export.package", "from . import variables", id="relative"),
        pytest.param("cosim.comparison", "import cosim.new", id="import of what has no layer"),
        pytest.param("cosim.new", "", id="without a layer"),
        pytest.param("cosim._fmu", "import casadi_models", id="C sources"),
    ],
)  # fmt: skip
def test_guard_sees_a_violation(module, source):
    assert len(violations(module, source)) == 1


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("cosim.comparison", "from cosim.trajectory import Trajectory\nimport casadi_models.dae"),
        ("cosim.export.package", "from cosim.export import variables"),
        ("cosim.integrate", "from cosim import solvers"),
        ("casadi_models", "import_module(f'casadi_models.{model}')"),
    ],
)
def test_guard_lets_downward_imports_pass(module, source):
    assert violations(module, source) == []
