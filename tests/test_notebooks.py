"""The notebooks run from top to bottom, in a kernel where there is one, and hold no outputs."""

import json
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "docs" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
NEEDED = {"ensembles": ("xarray",)}  # extras of the package
IN_A_KERNEL = find_spec("nbclient") is not None and find_spec("ipykernel") is not None


def cells(path):
    """Return the code cells of a notebook."""
    notebook = json.loads(path.read_text(encoding="utf-8"))
    return [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]


def test_there_is_a_notebook_for_each_of_three_people():
    assert [path.stem for path in NOTEBOOKS] == ["ensembles", "student", "system_engineer"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_kept_without_outputs(path):
    assert not any(cell["outputs"] or cell["execution_count"] for cell in cells(path))


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs_from_top_to_bottom(path, tmp_path):
    if missing := [name for name in NEEDED.get(path.stem, ()) if find_spec(name) is None]:
        pytest.skip(f"{', '.join(missing)}: an extra of the package")
    if IN_A_KERNEL:
        code = (
            "import sys, nbformat; from nbclient import NotebookClient; "
            "NotebookClient(nbformat.read(sys.argv[1], 4), timeout=300).execute()"
        )
        command = [sys.executable, "-W", "ignore", "-c", code, str(path)]
    else:
        (tmp_path / "cells.py").write_text("\n".join("".join(c["source"]) for c in cells(path)))
        command = [sys.executable, "-W", "ignore", "cells.py"]
    environment = os.environ | {"MPLBACKEND": "Agg", "IPYTHONDIR": str(tmp_path / "ipython")}
    run = subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, check=False, env=environment
    )
    assert run.returncode == 0, run.stderr[-3000:]
    assert {file.name for file in tmp_path.iterdir()} <= {"cells.py", "ipython"}
