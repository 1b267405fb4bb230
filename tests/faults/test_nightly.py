"""The long attack, `pytest -m nightly tests/faults`: rows at random, fuzzed calls, kills.

`helpers.nightly` reads its scale and its seed from the environment.
"""

import os
import random
import signal
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import pytest
from helpers.harness import SANITIZED, THREADED, fuzzers, run
from helpers.left_processes import left_processes
from helpers.nightly import SCALE, SEED
from helpers.random_rows import random_rows
from helpers.thread_cases import faults_of_threads, systems

from cosim.cli.main import main

ROWS, PARTS = 3000, 30
CALLS, SLICES = 50_000_000, 20
KILLS = 200
THREADS = 30  # cases of each kind

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.skipif(sys.platform != "linux", reason="pipes, devices and /proc of Linux"),
]


@pytest.mark.parametrize("part", range(PARTS))
def test_random_fault_ends_in_one_sentence(part, ends_well, exported):
    content = exported("crank_shaft").read_bytes()
    rows = random_rows(PARTS * SEED + part, max(1, round(SCALE * ROWS / PARTS)), content)
    found = ((row, ends_well(row)) for row in rows)
    assert {f"{row.name}: {row.words}": wrong for row, wrong in found if wrong} == {}


@pytest.mark.usefixtures("optimized")  # whose compiler knows variables of a thread
@pytest.mark.parametrize("kind", ["models", "file", "ssp"])
def test_threads_end_as_each_would_alone(kind, exported, tmp_path, counts):
    made = systems(tmp_path, exported("crank_shaft"))[kind]
    wrong, known = {}, {}
    for number in range(max(1, round(SCALE * THREADS))):
        found = faults_of_threads(THREADS * SEED + number, made, known)
        counts.update({"rows": 1, **found})
        if found:
            wrong[number] = found
    assert wrong == {}


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
    seed = 1000 + SLICES * SEED + part
    done, _, longest = run([program, seed, calls, threads], timeout=7200).split()
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
    draw = random.Random(SEED)
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


LONG_VERBS = {
    "simulate": "bicycle --solver cvodes --stop-time 3000 -o run.csv",
    "simulate an FMU": "crank.fmu --trust --stop-time 1e5 -o run.csv",
    "simulate a system": "pair.toml --method iterated --stop-time 1e5 -o run.csv",
    "export": "bicycle -o bicycle.fmu",
    "plot": "bicycle --solver dop853 --stop-time 3000 -o run.png",
    "animate": "bicycle -o run.html",
    "report": "crank_shaft -o run.html",
    "crosscheck": "bicycle",
    "tradeoff": "crank_shaft",
    "extremes": "crank_shaft",
    "sweep": "bicycle -p phi_dot=0:1:4000 --workers 2 -o runs.csv",
    "sensitivity": "bicycle -o s.csv",
    "linearize": "bicycle --along thetaR_dot=-3:-30:400 -o l.csv",
    "check": "crank.fmu --run --trust",
    "fit": "crank_shaft data.csv --free alpha,omega --starts 400 -o fitted.toml",
}
SIGNALS = 30
WRITTEN = {"run.csv", "bicycle.fmu", "run.png", "run.html", "runs.csv", "s.csv", "l.csv"}


@pytest.mark.parametrize("verb", LONG_VERBS)
def test_a_signal_at_any_moment_ends_a_verb_in_one_sentence(verb, exported, tmp_path, counts):
    words = [verb.split()[0], *LONG_VERBS[verb].split()]
    pair = "[parts]\na = 'crank_shaft'\nb = 'bar_on_frame'\n[connections]\n'b.T2' = 'a.T'\n"
    files = {"crank.fmu": exported("crank_shaft").read_bytes(), "pair.toml": pair.encode()}
    files["data.csv"] = "".join(["time,phi\n", *(f"{k},{k * k}\n" for k in range(4))]).encode()
    draw = random.Random(f"{SEED} {verb}")
    wrong = {}
    for number in range(max(1, round(SCALE * SIGNALS))):
        place, temporary = tmp_path / f"{number}", tmp_path / f"{number} temporary"
        for folder in (place, temporary):
            folder.mkdir()
        for name, content in files.items():
            (place / name).write_bytes(content)
        # before 0.1 s Python itself starts, which ends with a traceback
        kind, delay = draw.choice((signal.SIGINT, signal.SIGTERM)), draw.uniform(0.1, 3)
        found = _signaled(words, place, temporary, kind, delay)
        counts.update(["rows", *found])
        if found:
            wrong[f"{number}: {kind.name} after {delay:.3f} s"] = found
    assert wrong == {}


def _signaled(words, place, temporary, kind, delay):
    """Return what is wrong with the end of a command that gets a signal."""
    code = "import sys; print(flush=True); from cosim.__main__ import command; sys.exit(command())"
    process = subprocess.Popen(
        [sys.executable, "-P", "-c", code, *words],
        cwd=place, env=os.environ | {"TMPDIR": str(temporary)},
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    before = {path.name for path in place.iterdir()}
    process.stdout.readline()  # Python itself has started
    time.sleep(delay)
    process.send_signal(kind)
    began = time.monotonic()
    try:
        _, err = process.communicate(timeout=30)
    except subprocess.TimeoutExpired:
        process.kill()
        return {"hang": process.communicate()[1]}
    wrong = {}
    if time.monotonic() - began > 5:
        wrong["hang"] = f"{time.monotonic() - began:.1f} s"
    if "Traceback" in err or "Exception ignored" in err:
        wrong["traceback"] = err
    code, done = process.returncode, {path.name for path in place.iterdir()} - before
    if code not in (130, -signal.SIGTERM, 0, 4):  # it may have ended before
        wrong["other"] = f"{code}: {err}"
    if code == 130 and [line for line in err.splitlines() if "interrupted" in line] == []:
        wrong["other"] = f"not told: {err}"
    if done - WRITTEN or any(temporary.iterdir()):
        wrong["leftover"] = str([*done, *temporary.rglob("*")])
    if orphans := left_processes(str(temporary)):
        wrong["orphan"] = str(orphans)
    return wrong


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
