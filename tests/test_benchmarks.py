"""Every benchmark runs in a short form."""

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "benchmarks"

CRANK = ["crank_shaft/driven", "crank_shaft/multipliers"]

# Name of a benchmark b, code that runs it with fewer repeats or cases, and a text that it prints.
SHORT = [
    ("bare_faults", "b.rows = lambda rows=b.rows: rows()[2:4]; b.main()", "| of 1 |"),
    ("chains", "sys.argv[1:] = ['2']; b.main()", "links"),
    ("communication_steps", "sys.argv[1:] = ['crank_shaft']; b.STEPS = 0.1,; b.main()", "crank"),
    ("coupling", "b.NAMES = ['quarter_car']; b.REPEATS = 1; b.accuracies()", "quarter_car"),
    ("drift", "b.SHORT, b.LONG, b.REPEATS = b.SHORT[:1], (), 1; b.main()", "projection"),
    ("ensembles", "b.ROLLS, b.REPEATS = b.ROLLS[::99], 1; b.outputs()", "the end states alone"),
    ("events", "b.BALLS, b.REPEATS = b.BALLS[:1], 1; b.main()", "times as fast as scipy"),
    (
        "examples",
        "b.casadi_models.CATALOG = CRANK; b.examples = tuple; print(b.algebraic_errors())",
        "crank_shaft/multipliers",
    ),
    ("export", "sys.argv[1:] = ['crank_shaft']; b.main()", "all warm:"),
    (
        "extremes",
        "b.select_cases = lambda _, every=b.select_cases: every([])[:2]; b.main([])",
        "fmpy",
    ),
    ("fmu_cost", "sys.argv[1:] = ['--short']; b.main()", "co-simulation from C, a step of 0.01 s"),
    (
        "importers.importers",
        "b.CLIENTS = {name: row for name, row in b.CLIENTS.items() if 'fmpy' in name}; b.main()",
        "| fmpy, ME |",
    ),
    ("large_exports", "sys.argv[1:] = ['ball:2']; b.main()", "ball:2"),
    ("live_pages", "b.casadi_models.CATALOG = CRANK; b.main()", "crank_shaft"),
    ("native_runs", "b.REPEATS = 1; b.main()", "dop853 compiled"),
    ("operations", "b.main()", "double_pendulum/multipliers"),
    ("predicted_errors", "sys.argv[1:] = ['crank_shaft', '--samples=1']; b.main()", "crank_shaft"),
    ("promises", "sys.argv[1:] = ['--short', 'spring']; b.main()", "spring"),
    ("proportionality", "b.CASES = b.CASES[:1]; b.main()", "crank_shaft"),
    (
        "recorded_runs",
        "sys.argv[1:] = [os.devnull]; b.casadi_models.CATALOG = CRANK; b.main()",
        " runs",
    ),
    (
        "reduction",
        "b.CASES, b.REPEATS, b.CALLS = b.CASES[:1], 1, 9; b.main()",
        "crank_shaft/driven",
    ),
    ("relations", "b.main(1)", "of 1 relations"),
    ("sensitivity", "b.ROUNDS = 1; b.main(0.1)", "central differences"),
    ("sessions", "b.main(200)", "session: save"),
    ("steps", "b.main(6)", "cosim dop853              0 (0)"),
    ("steps", "b.outputs(6)", "mean: {'dop853': 0, 'cvodes': 0}"),
    ("structure", "b.main(b.Path.cwd())", "files entered"),
    ("tail", "b.REPEATS = 1; b.main()", "two outputs, validity ignored"),
]
ELSEWHERE = {"against", "figures"}  # it installs two commits; tests/test_figures_of_docs.py
NEEDS = {
    "chains": "pinocchio",
    "events": "scipy",
    "live_pages": "ziglang",
    "bare_faults": "resource",
}


def test_every_benchmark_has_a_short_form():
    names = {path.stem for path in FOLDER.glob("*.py")}
    assert names <= {*(row[0] for row in SHORT), *ELSEWHERE}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "code", "printed"), SHORT, ids=[row[0] for row in SHORT])
def test_benchmark_runs_in_its_short_form(name, code, printed, tmp_path):
    needed = NEEDS.get(name, name)
    if name in NEEDS and not importlib.util.find_spec(needed):
        pytest.skip(f"{needed} is missing")
    if name == "live_pages" and not shutil.which("node"):
        pytest.skip("node is missing")
    found = f"import os, sys; sys.path[0] = {str(FOLDER)!r}; import {name} as b"
    program = f"{found}; CRANK = {CRANK}; {code}"
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=FOLDER.parent,
        env={**os.environ, "TMPDIR": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    assert printed in done.stdout
