"""Local processes of a sweep: modules of the current folder shadow none of theirs."""

import os
import subprocess
import sys

import pytest

CALL = """
import sys
import casadi_models
import cosim
sys.path.append("")
from measure import last
found = cosim.sweep("crank_shaft", {"omega": [1.0, 2.0, 3.0]}, outputs=["phi"],
                    stop_time=0.1, workers=1, keep=[last])
print([round(float(value), 12) for value in found["last"]])
"""


def sweep_in(folder):
    (folder / "measure.py").write_text("def last(run): return {'last': run['phi'][-1]}\n")
    return subprocess.run(
        [sys.executable, "-P", "-c", CALL],
        cwd=folder, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cosim", "numpy", "pickle", "casadi_models"])
def test_module_of_the_current_folder_shadows_nothing(tmp_path, name):
    (tmp_path / f"{name}.py").write_text("raise SystemExit('shadowed')\n")
    done = sweep_in(tmp_path)
    assert done.stderr == ""
    assert done.stdout == "[0.15, 0.25, 0.35]\n"  # omega t + 5 t^2


@pytest.mark.slow
def test_workers_that_end_in_the_middle_leave_no_files(tmp_path):
    (tmp_path / "measure.py").write_text("import os\ndef last(run): os._exit(1)\n")
    (tmp_path / "temporary").mkdir()
    call = CALL.replace('print([round(float(value), 12) for value in found["last"]])', "")
    done = subprocess.run(
        [sys.executable, "-P", "-c", call],
        cwd=tmp_path, env=os.environ | {"TMPDIR": str(tmp_path / "temporary")},
        capture_output=True, text=True, timeout=200, check=False,
    )  # fmt: skip
    assert done.stderr == ""
    assert not [*(tmp_path / "temporary").iterdir()]


@pytest.mark.slow
def test_a_function_whose_module_is_missing_fails_its_runs_with_the_module_as_reason(
    tmp_path, monkeypatch
):
    import types

    import cosim

    gone = types.ModuleType("gone_away")
    exec("def last(run): return {'last': 1.0}", gone.__dict__)
    monkeypatch.setitem(sys.modules, "gone_away", gone)
    found = cosim.sweep("crank_shaft", {"omega": [1.0]}, stop_time=0.1, workers=1, keep=[gone.last])
    assert "gone_away" in found.reasons[0]
