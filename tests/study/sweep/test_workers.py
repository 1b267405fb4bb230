"""Processes of a sweep: what the current folder holds neither hinders nor is missed."""

import subprocess
import sys

import pytest

from cosim.host.processes import was_killed

CALL = """
import sys
import casadi_models
import cosim
sys.path.append("")
from measure import last
found = cosim.sweep("crank_shaft", {"omega": [1.0, 2.0, 3.0]}, outputs=["phi"],
                    stop_time=0.1, workers=1, function=last)
print([round(float(value), 12) for value in found["last"]])
"""


def sweep_in(folder):
    (folder / "measure.py").write_text("def last(run): return {'last': run['phi'][-1]}\n")
    return subprocess.run(
        [sys.executable, "-P", "-c", CALL],
        cwd=folder, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip


@pytest.mark.parametrize("name", ["cosim", "numpy", "pickle", "casadi_models"])
def test_module_of_the_current_folder_shadows_nothing(tmp_path, name):
    (tmp_path / f"{name}.py").write_text("raise SystemExit('shadowed')\n")
    done = sweep_in(tmp_path)
    assert done.stderr == ""
    assert done.stdout == "[0.15, 0.25, 0.35]\n"  # omega t + 5 t^2


def test_function_whose_module_is_nowhere_is_told_in_words(tmp_path, monkeypatch):
    import types

    import cosim

    gone = types.ModuleType("gone_away")
    exec("def last(run): return {'last': 1.0}", gone.__dict__)
    monkeypatch.setitem(sys.modules, "gone_away", gone)
    found = cosim.sweep("crank_shaft", {"omega": [1.0]}, stop_time=0.1, workers=1,
                        function=gone.last)  # fmt: skip
    assert "gone_away" in found.reasons[0]


@pytest.mark.parametrize("end", ["kill", "terminate"])
def test_process_that_was_ended_from_outside_is_told_from_one_that_crashed(end):
    idle = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    getattr(idle, end)()
    idle.communicate()
    assert was_killed(idle.returncode)
    crash = "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)"
    assert not was_killed(subprocess.run([sys.executable, "-c", crash], check=False).returncode)
    assert not was_killed(0)
    assert not was_killed(None)


@pytest.mark.parametrize(
    ("code", "killed"),
    [(1, True), (15, True), (3, False), (0xC0000005, False)],
    ids=["task manager", "Python", "exit", "access violation"],
)
def test_exit_codes_of_windows(code, killed):
    assert was_killed(code, "nt") is killed
