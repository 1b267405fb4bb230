"""Benchmarks run in their short form, as far as they have one."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "printed"),
    [
        ("fmu_cost.py --short", "co-simulation from C, a step of 0.01 s"),
        ("export.py crank_shaft", "all warm:"),
        ("sessions.py --short", "session: save"),
        ("predicted_errors.py crank_shaft --samples 1", "crank_shaft/driven"),
        ("operations.py", "double_pendulum/multipliers"),
        ("steps.py --short", "cosim dop853              0 (0)"),
        ("structure.py", "files entered"),
    ],
)
def test_benchmark_runs_in_its_short_form(command, printed):
    name, *words = command.split()
    call = [sys.executable, str(ROOT / "benchmarks" / name), *words]
    done = subprocess.run(call, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    assert printed in done.stdout
