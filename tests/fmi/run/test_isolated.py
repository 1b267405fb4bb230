"""FMUs that crash, hang, exit or shout: the process of the user goes on, in one sentence."""

import json
import os
import shlex
import signal
import subprocess
import sys
import time
import zipfile
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from helpers.fmu_files import misbehaving
from helpers.small_models import decay

import cosim
from cosim.codegen.compiler import find_compiler
from cosim.errors import FmuError, ParameterError, SolverError, UnknownName
from cosim.fmi.run.isolated import run_apart
from cosim.host import child
from cosim.host.child import MOST_OUTPUT

POSIX = pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
LINUX = pytest.mark.skipif(sys.platform != "linux", reason="looks at processes in /proc")

# What the FMU does in a communication step of this length
BAD_STEPS = {"crash": 0.5, "hang": 0.25, "exit": 0.125, "shout": 0.0625, "late": 0.03125}
BEHAVIOR = """
    if (length == 0.5) abort();
    if (length == 0.25) for (volatile int i = 0;; i = 1) {}
    if (length == 0.125) exit(7);
    static int steps = 0;
    if (length == 0.03125 && ++steps > 3) for (volatile int i = 0;; i = 1) {}
    if (length == 0.0625) for (int i = 0; i < 100000; i++) puts("here I am");
"""


@pytest.fixture(scope="module")
def bad(tmp_path_factory) -> Path:
    """An FMU that misbehaves at some step sizes."""
    return misbehaving(tmp_path_factory.mktemp("bad") / "bad.fmu", BEHAVIOR)


def command(*words, **more):
    call = [sys.executable, "-m", "cosim", *map(str, words)]
    return subprocess.run(call, capture_output=True, text=True, timeout=60, check=False, **more)


def simulate(path, behavior, *words):
    step = ["--output-interval", str(BAD_STEPS[behavior])]
    return command("simulate", path, "--trust", "--stop-time", "1", *step, *words)


@pytest.mark.slow
@POSIX
def test_a_crash_is_one_sentence_with_the_signal(bad):
    done = simulate(bad, "crash")
    assert done.returncode == 1
    assert done.stdout == ""
    assert done.stderr.splitlines()[-1] == (
        f"FmuError: {bad}: the FMU crashed (SIGABRT) while it ran; do not use it"
    )


def test_an_exit_is_told(bad):
    with pytest.raises(FmuError, match=r"bad\.fmu: the FMU ended the process with exit code 7"):
        run_apart(bad, output_interval=BAD_STEPS["exit"], stop_time=1)


@pytest.mark.slow
def test_a_hang_ends_at_the_time_limit(bad):
    began = time.monotonic()
    done = simulate(bad, "hang", "--timeout", "2")
    assert time.monotonic() - began < 20  # s; measured 3 on a busy machine
    assert done.returncode == 1
    assert done.stderr == f"FmuError: {bad}: the FMU did not end within 2 s and was stopped\n"


@pytest.mark.slow
def test_rows_before_a_time_limit_are_kept(bad, tmp_path):
    with pytest.raises(FmuError, match="did not end within 2 s") as raised:
        run_apart(bad, output_interval=BAD_STEPS["late"], stop_time=1, timeout=2)
    kept = raised.value.partial
    assert kept.status == "the FMU did not end within 2 s and was stopped"
    whole = cosim.simulate_fmu(bad, output_interval=0.015625, stop_time=1)
    np.testing.assert_array_equal(kept.time, [0.0, 0.03125, 0.0625, 0.09375])
    assert kept.names == whole.names
    for name in kept.names:
        np.testing.assert_allclose(kept[name], whole[name][:7:2], rtol=1e-5)  # measured 3e-7
    file = tmp_path / "kept.csv"
    done = simulate(bad, "late", "--timeout", "2", "-o", file)
    assert done.returncode == 1
    assert len(cosim.Trajectory.read_csv(file)) == 4


@pytest.mark.slow
@LINUX
@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGKILL])
def test_a_hang_ends_with_the_command(bad, kind):
    words = ["simulate", bad, "--stop-time", "1", "--output-interval", BAD_STEPS["hang"]]
    call = [sys.executable, "-m", "cosim", *map(str, words)]
    with subprocess.Popen(call, stderr=subprocess.DEVNULL) as process:
        child = waited_for(lambda: children(process.pid))
        waited_for(lambda: processor_time(child[0]) > 1.0)  # it hangs
        process.send_signal(kind)
        assert process.wait(10) == (130 if kind == signal.SIGINT else -kind)
    waited_for(lambda: not Path(f"/proc/{child[0]}").exists())


def waited_for(condition):
    end = time.monotonic() + 30
    while not (found := condition()):
        assert time.monotonic() < end
        time.sleep(0.05)
    return found


def children(process):
    lists = Path(f"/proc/{process}/task").glob("*/children")
    return [int(word) for file in lists for word in file.read_text().split()]


def processor_time(process):
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def test_what_it_prints_is_kept_out_of_the_results_and_short(bad):
    done = simulate(bad, "shout")
    assert done.returncode == 0
    assert "here I am" not in done.stdout
    assert 0 < len(done.stderr) <= MOST_OUTPUT


def test_a_good_run_is_that_of_our_own_process(bad):
    options = {"output_interval": 0.1, "stop_time": 0.5, "interface": "CoSimulation"}
    here, there = cosim.simulate_fmu(bad, **options), run_apart(bad, **options)
    np.testing.assert_array_equal(there.values, here.values)
    np.testing.assert_array_equal(there.time, here.time)
    assert there.columns == here.columns
    assert there.stats.keys() == here.stats.keys()


def test_errors_of_the_run_keep_their_kind(bad):
    with pytest.raises(UnknownName, match="interface"):
        run_apart(bad, interface="ModelExchanges")
    with pytest.raises(ParameterError, match="timeout"):
        run_apart(bad, timeout=float("nan"))
    with pytest.raises(FmuError, match=r"^nowhere\.fmu|^cannot read nowhere\.fmu"):
        run_apart("nowhere.fmu")


def test_an_error_of_a_kind_within_another_arrives_as_that_one(bad, tmp_path, monkeypatch):
    raising = "raise EndlessEvents('events cause each other without end', None, 'a')"
    code = f"from cosim.coupling.failures import EndlessEvents\ndef run(path):\n    {raising}\n"
    (tmp_path / "endless_run.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    with pytest.raises(SolverError, match=r"^events cause each other without end$"):
        run_apart(bad, function=import_module("endless_run").run)


def test_a_child_sees_few_variables_of_the_environment(bad, monkeypatch):
    monkeypatch.setenv("SECRET_TOKEN", "x")
    seen = {}

    class Spy(subprocess.Popen):
        def __init__(self, *arguments, **options):
            seen.update(options["env"])
            super().__init__(*arguments, **options)

    monkeypatch.setattr(subprocess, "Popen", Spy)
    run_apart(bad, output_interval=0.1, stop_time=0.1)
    assert "PATH" in seen
    assert "SECRET_TOKEN" not in seen


def test_a_child_has_the_cache_of_its_parent(bad, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("COSIM_CACHE", "own")
    run_apart(bad, output_interval=0.1, stop_time=0.1)
    assert not (tmp_path / "home").exists()
    assert (tmp_path / "own").is_dir()


@POSIX
def test_a_child_has_the_compiler_of_its_parent(bad, tmp_path, monkeypatch):
    """Before: another one than $CC, and none where only $CC names one."""
    called, compiler = tmp_path / "called", tmp_path / "compiler"
    compiler.write_text(f'#!/bin/sh\ntouch {called}\nexec {shlex.join(find_compiler())} "$@"\n')
    compiler.chmod(0o700)
    monkeypatch.setenv("CC", str(compiler))
    run_apart(bad, output_interval=0.1, stop_time=0.1, master="c")
    assert called.exists()


@pytest.mark.slow
def test_crosscheck_goes_on_after_a_crash(bad, tmp_path):
    path = tmp_path / "proven.fmu"
    with_reference(bad, path, interval=0.5)
    done = command("crosscheck", path, "--json")
    rows = json.loads(done.stdout)
    assert [row["verdict"] for row in rows] == ["ok", "FAILED"]
    assert "the FMU crashed" in done.stderr
    assert done.returncode == 1


def with_reference(bad, path, interval):
    """Write the FMU with a reference whose check takes communication steps of this length, s."""
    run = cosim.simulate(decay(), stop_time=2 * interval, output_interval=interval)
    table = "\n".join(
        [",".join(("time", *run.names))]
        + [",".join(map(repr, map(float, row))) for row in np.column_stack((run.time, run.values))]
    )
    facts = {
        "model": "decay", "solver": "cvodes", "relative_tolerance": 1e-9, "bound": 1e-6,
        "unit": {c.name: c.unit for c in run.columns},
        "nominal": {c.name: c.nominal for c in run.columns},
    }  # fmt: skip
    path.write_bytes(bad.read_bytes())
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("documentation/reference.csv", table + "\n")
        archive.writestr("documentation/reference.json", json.dumps(facts))


def test_children_are_found_although_a_thread_ends_meanwhile(tmp_path, monkeypatch):
    (tmp_path / "children").write_text("7 8 ")
    lists = [tmp_path / "ended" / "children", tmp_path / "children"]
    monkeypatch.setattr(Path, "glob", lambda *_: lists)
    assert child._children() == [7, 8]
