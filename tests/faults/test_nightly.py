"""The long attack, `pytest -m nightly tests/faults`: rows at random, fuzzed calls, kills.

The environment's COSIM_NIGHTLY scales it: 0.01 is a hundredth.
"""

import os
import random
import signal
import sys
import time
import zipfile
from pathlib import Path

import pytest
from helpers.harness import SANITIZED, THREADED, fuzzers, run
from helpers.random_rows import random_rows

from cosim.cli.main import main

SCALE = float(os.environ.get("COSIM_NIGHTLY", "1"))
ROWS, PARTS = 3000, 30
CALLS, SLICES = 50_000_000, 20
KILLS = 200

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.skipif(sys.platform != "linux", reason="pipes, devices and /proc of Linux"),
]


@pytest.mark.parametrize("part", range(PARTS))
def test_random_fault_ends_in_one_sentence(part, ends_well, exported):
    content = exported("crank_shaft").read_bytes()
    rows = random_rows(part, max(1, round(SCALE * ROWS / PARTS)), content)
    found = ((row, ends_well(row)) for row in rows)
    assert {f"{row.name}: {row.words}": wrong for row, wrong in found if wrong} == {}


@pytest.fixture(scope="session")
def fuzzer(tmp_path_factory):
    return fuzzers(tmp_path_factory.mktemp)


@pytest.mark.parametrize("part", range(SLICES))
@pytest.mark.parametrize("solver", ["step", "dop853"])
@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize(
    ("flags", "threads"), [(SANITIZED, 1), (THREADED, 4)], ids=["asan", "tsan"]
)
def test_random_calls_do_no_harm(part, solver, version, flags, threads, fuzzer, counts):
    program = fuzzer(solver, version, *flags)
    calls = max(4000, round(SCALE * CALLS / 8 / SLICES))
    done, _, longest = run([program, 1000 + part, calls, threads], timeout=7200).split()
    counts["calls"] += int(done)
    assert float(longest) < 1.0  # s of processor time; measured 0.02 and 0.08


def test_killed_command_leaves_the_old_file_or_the_new_one(tmp_path, monkeypatch, counts):
    """Killed while it writes the same files again and again, one of two contents each."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    words = [
        [
            "simulate",
            "crank_shaft",
            "--backend",
            "native-interpreted",
            "-o",
            "run.csv",
            "--stop-time",
        ],
        ["plot", "crank_shaft", "--backend", "native-interpreted", "-o", "run.png", "--stop-time"],
        ["export", "crank_shaft", "-o", "crank.fmu", "-q", "--outputs"],
    ]
    ends = [("1", "2"), ("1", "2"), ("phi", "omega")]
    whole: dict[str, set[bytes]] = {}
    for command, two in zip(words, ends, strict=True):
        for end in two:
            assert main([*command, end]) == 0
            name = command[command.index("-o") + 1]
            whole.setdefault(name, set()).add(Path(name).read_bytes())
    before = sorted(path.name for path in tmp_path.iterdir())
    draw = random.Random(1)
    for _ in range(max(1, round(SCALE * KILLS))):
        _kill_while_writing(words, ends, draw.uniform(0, 0.4))
        counts["kills"] += 1
        torn = [name for name, known in whole.items() if Path(name).read_bytes() not in known]
        counts["torn"] += len(torn)
        assert torn == []
    for command, two in zip(words, ends, strict=True):
        assert main([*command, two[0]]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == before
    with zipfile.ZipFile("crank.fmu") as archive:
        assert archive.testzip() is None


def _kill_while_writing(words, ends, seconds):
    child = os.fork()
    if child == 0:
        try:
            while True:
                for command, two in zip(words, ends, strict=True):
                    for end in two:
                        main([*command, end])
        finally:
            os._exit(1)
    time.sleep(seconds)
    os.kill(child, signal.SIGKILL)
    assert os.waitpid(child, 0)[1] == signal.SIGKILL
