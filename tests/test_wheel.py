"""The wheel holds what the tree holds: a forgotten folder in pyproject.toml is otherwise silent."""

import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PLACES = {"casadi_models": "casadi_models", "src/cosim": "cosim", "fmu": "cosim/_fmu"}


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    """Return a copy of the tree, without what earlier builds left there."""
    copy = tmp_path_factory.mktemp("tree") / "copy"
    unwanted = shutil.ignore_patterns(".*", "build", "dist", "*.egg-info", "__pycache__")
    return shutil.copytree(ROOT, copy, ignore=unwanted)


@pytest.fixture(scope="module")
def wheel(tree, tmp_path_factory):
    """Build the wheel from the sdist."""
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", folder, tree]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout[-3000:] + run.stderr[-3000:]
    (built,) = folder.glob("*.whl")
    return built


def files_of(tree):
    """Return the bytes of every file that the wheel should hold, by its name there."""
    return {
        f"{there}/{path.relative_to(tree / here).as_posix()}": path.read_bytes()
        for here, there in PLACES.items()
        for path in (tree / here).rglob("*")
        if path.is_file()
    }


def test_wheel_holds_every_file_of_the_packages_and_nothing_else(tree, wheel):
    with zipfile.ZipFile(wheel) as archive:
        held = {
            name: archive.read(name)
            for name in archive.namelist()
            if not name.partition("/")[0].endswith(".dist-info")
        }
    expected = files_of(tree)
    assert set(held) ^ set(expected) == set()
    assert held == expected


@pytest.mark.slow
def test_installed_wheel_brings_two_import_names(tree, wheel, tmp_path):
    site = tmp_path / "site"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    assert {entry.name for entry in site.iterdir() if entry.suffix != ".dist-info"} == {
        "casadi_models",
        "cosim",
    }
    question = (
        "import sys, casadi_models.dae, cosim.codegen.c_sources\n"
        "from importlib.util import find_spec\n"
        "assert not find_spec('fmu') and not find_spec('tests')\n"
        "print(*(source.name for source in cosim.codegen.c_sources.runtime_sources()))\n"
        "ours = [m for n, m in sys.modules.items() if n.startswith(('casadi_models', 'cosim'))]\n"
        "print(*(module.__file__ for module in ours), sep='\\n')"
    )
    run = subprocess.run(
        [sys.executable, "-c", question],
        cwd=tmp_path,
        env={"PYTHONPATH": str(site)},
        capture_output=True,
        text=True,
        check=True,
    )
    sources, *files = run.stdout.splitlines()
    assert sources.split() == sorted(p.name for p in (tree / "fmu/runtime").glob("*.[ch]"))
    assert all(Path(file).is_relative_to(site) for file in files)
