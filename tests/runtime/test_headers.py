"""The C files as parts: each header stands alone, and no part needs one that needs it."""

import re
import subprocess
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest
from helpers import event_models, harness
from helpers.harness import HEADERS, INCLUDES, RUNTIME, SOLVERS, STRICT, compiler, sources

pytestmark = pytest.mark.skipif(compiler() is None, reason="needs a C compiler")

MASTER = SOLVERS.parent / "master"
KERNEL = SOLVERS / "hybrid"
FILES = [*RUNTIME.iterdir(), *SOLVERS.glob("*.h"), *KERNEL.iterdir(), *MASTER.iterdir()]
SIZES = {
    "NX": 2,
    "NZ": 1,
    "NU": 1,
    "NC": 1,
    "NP": 1,
    "NN": 1,
    "NY": 1,
    "NL": 1,
    "LANES": 1,
    "NB": 1,
    "LIMITS_OF_TIME": 1,
}
SIZES |= {"WORK_ARG": 9, "WORK_RES": 5, "WORK_IW": 1, "WORK_W": 1}
SIZES |= dict.fromkeys(("MODES", "EVENTS", "ASSIGNED", "DEFECTS", "BOUNDED", "ENCLOSED"), 1)
DEFINED = [f"-D{name}={size}" for name, size in SIZES.items()]
# A file of the runtime alone, whose static functions may be defined in another one
ALONE = ["-Wno-error", "-Werror=implicit-function-declaration", "-Werror=missing-prototypes"]
INCLUDE = re.compile(r'^#include "(\w+)\.h"', re.MULTILINE)


def includes(files: list[Path]) -> dict[str, set[str]]:
    """Return by part, a source and the header of its name, the parts of ours that it includes."""
    parts = {path.stem for path in files}
    needs: dict[str, set[str]] = {part: set() for part in parts}
    for path in files:
        needs[path.stem] |= (set(INCLUDE.findall(path.read_text())) & parts) - {path.stem}
    return needs


def compiled(header: Path, include: list[str]) -> subprocess.CompletedProcess[str]:
    call = [compiler(), *STRICT, *include, "-include", str(header), "-fsyntax-only", "-xc", "-"]
    something = "typedef int something;\n"  # C knows no empty file
    return subprocess.run(call, input=something, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("header", sorted(SOLVERS.rglob("*.h")), ids=lambda path: path.name)
def test_a_solver_header_compiles_with_nothing_but_sizes(header):
    own = ["-DSETTINGS=2"] if header.name in ("casadi_driver.h", "shapes.h") else []
    done = compiled(header, [*DEFINED, *INCLUDES, *own])
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("header", sorted(MASTER.glob("*.h")), ids=lambda path: path.name)
def test_a_header_of_the_master_compiles_with_sizes_and_the_solvers(header):
    done = compiled(header, [*DEFINED, *INCLUDES])
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("header", "missing"),
    [
        ("dop853.h", "NX"), ("fixed.h", "NX"), ("problem.h", "NC"), ("lanes.h", "LANES"),
        ("lanes_dop853.h", "NL"), ("lanes_outputs.h", "NY"), ("hybrid/laws.h", "MODES"),
        ("lanes_start.h", "WORK_W"), ("lanes_limits.h", "NB"),
    ],
)  # fmt: skip
def test_a_forgotten_size_is_an_error_and_no_default(header, missing):
    done = compiled(SOLVERS / header, [d for d in DEFINED if not d.startswith(f"-D{missing}=")])
    assert done.returncode != 0
    assert re.search(rf"#error .*\b{missing}\b", done.stderr)


@pytest.mark.parametrize("solver", ["step", "dop853"], indirect=True, scope="session")
@pytest.mark.parametrize("header", sorted(RUNTIME.glob("*.h")), ids=lambda path: path.name)
def test_a_header_of_the_runtime_compiles_with_nothing_but_a_model(header, model):
    done = compiled(header, [f"-I{model}", *INCLUDES, f"-isystem{HEADERS}", *ALONE])
    assert done.returncode == 0, done.stderr


def test_no_part_needs_one_that_needs_it():
    needs = includes(FILES)
    assert needs["evaluation"] >= {"logging", "validity"}  # the graph is not empty
    list(TopologicalSorter(needs).static_order())


def test_a_circle_is_found(tmp_path):
    (tmp_path / "upper.c").write_text('#include "lower.h"\n')
    (tmp_path / "lower.h").write_text("")
    (tmp_path / "lower.c").write_text('#include "upper.h"\n')
    with pytest.raises(CycleError):
        list(TopologicalSorter(includes(list(tmp_path.iterdir()))).static_order())


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("solver", ["step", "dop853"], indirect=True, scope="session")
def test_every_function_is_declared_in_a_header(model, version):
    """So that the graph of includes is that of calls."""
    include = [f"-I{model}", f"-I{RUNTIME}", *INCLUDES, f"-isystem{HEADERS}"]
    for source in sources(model, version):
        done = subprocess.run(
            [compiler(), *STRICT, *ALONE, *include, "-fsyntax-only", str(source)],
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr


def test_a_model_with_limits_and_no_relations_compiles_without_a_warning(tmp_path):
    event_models.write(tmp_path, event_models.limited(), "dop853", fmi=2, most_trials=100)
    assert harness.compiled(tmp_path, 2, ["-O0"], tmp_path).is_file()  # before: unused 'looks'
