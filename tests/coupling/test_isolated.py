"""Parts that crash or hang: the run ends with one message, and nothing is left behind."""

import os
import subprocess
import sys
import zipfile

import pytest
from helpers.fmu_files import misbehaving

import cosim

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")

BEHAVIOR = {"crash": "abort();", "hang": "for (volatile int i = 0;; i = 1) {}"}


def steady(unit):
    """Return a part with a constant state."""
    model = cosim.Model("steady")
    x = model.state("x", unit, 0.0, "constant")
    model.derivative(x, 0)
    return model.freeze()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "limit", "message"),
    [
        ("crash", "90", "part 'bad' crashed (SIGABRT) while it ran"),
        ("hang", "3", "did not end within 3 s and was stopped"),
    ],
)
def test_foreign_part_ends_the_run_with_one_message(kind, limit, message, tmp_path):
    bad = misbehaving(tmp_path / "bad.fmu", f"    if (from > 0.4) {BEHAVIOR[kind]}\n")
    system = cosim.couple({"bad": bad, "good": steady("m/s")}, {"bad.force": "good.x"})
    ssp = system.write_ssp(tmp_path / "bad.ssp")
    call = [sys.executable, "-m", "cosim", "simulate", str(ssp), "--stop-time", "1", "--timeout",
            limit, "-o", str(tmp_path / "run.csv")]  # fmt: skip
    done = subprocess.run(call, capture_output=True, text=True, check=False, timeout=100)
    assert done.returncode == 1
    assert message in done.stderr
    assert not (tmp_path / "run.csv").exists()


@pytest.mark.slow
def test_part_that_fails_in_a_process_of_its_own_leaves_its_results(tmp_path):
    """A file that was not exported here: the singularity of x' = x^2 at 1 s."""
    model = cosim.Model("growth", stop_time=2.0)
    x, u = model.state("x", "1", 1.0, "grows"), model.input("u", "1", 0.0, "input")
    model.derivative(x, x**2 + 0 * u)
    path = cosim.export_fmu(model.freeze(), tmp_path / "growth.fmu")
    with zipfile.ZipFile(path, "a") as archive:  # other bytes: another file
        archive.writestr("extra.txt", "")
    system = cosim.couple({"growth": path, "good": steady("1")}, {"growth.u": "good.x"})
    ssp = system.write_ssp(tmp_path / "growth.ssp")
    out = tmp_path / "run.csv"
    call = [sys.executable, "-m", "cosim", "simulate", str(ssp), "--stop-time", "2", "-o", str(out)]
    call += ["--output-interval", "0.1", "--macro-step", "0.1"]
    done = subprocess.run(call, capture_output=True, text=True, check=False, timeout=100)
    assert done.returncode != 0
    assert "part 'growth' failed" in done.stderr
    assert 5 <= len(cosim.Trajectory.read_csv(out)) <= 11
