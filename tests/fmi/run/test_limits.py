"""Limits of foreign FMUs, and what is left of them when their parent is ended."""

import os
import signal
import subprocess
import sys
import time

import pytest
from helpers.hostile import hostile, hostile_binary

from cosim.errors import FmuError, UsageError
from cosim.fmi.run.isolated import run_apart
from cosim.host.limits import chosen_limits

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="limits and /proc of Linux")


@pytest.fixture(scope="module")
def bad(tmp_path_factory):
    return hostile(hostile_binary(tmp_path_factory.mktemp("hostile")))


@pytest.mark.slow_rows(
    "memory=1.5e9-fmi2DoStep memory-SIGABRT|memory",
    "cpu=2-fmi2DoStep hang-time on the processor|SIGKILL",
)
@pytest.mark.parametrize(
    ("limit", "fault", "told"),
    [
        ("memory=1.5e9", "fmi2DoStep memory", "SIGABRT|memory"),
        ("cpu=2", "fmi2DoStep hang", "time on the processor|SIGKILL"),
        ("file=1e6", "fmi2DoStep disk", "size of a file"),
        ("files=50", "fmi2DoStep files", "SIGABRT"),
    ],
)
def test_run_ends_at_its_limit(bad, monkeypatch, limit, fault, told):
    monkeypatch.setenv("COSIM_FMU_LIMITS", limit)
    with pytest.raises(FmuError, match=told):
        run_apart(bad(fault), interface="CoSimulation", timeout=50)


@pytest.mark.parametrize("text", ["memory", "memory=", "memory=-1", "disk=3", "cpu=nan"])
def test_limit_that_is_none_is_refused(monkeypatch, text):
    monkeypatch.setenv("COSIM_FMU_LIMITS", text)
    with pytest.raises(UsageError, match="is no limit; give some of memory, cpu, file"):
        chosen_limits()


def test_limit_below_one_is_not_none(monkeypatch):
    monkeypatch.setenv("COSIM_FMU_LIMITS", "cpu=0.5,memory=0")
    assert (chosen_limits()["cpu"], chosen_limits()["memory"]) == (1, 0)


def begun(path, folder):
    """Return the process of a run once it has unpacked the FMU in a folder."""
    call = [sys.executable, "-m", "cosim", "simulate", str(path), "--trust"]
    environment = {**os.environ, "TMPDIR": str(folder)}
    process = subprocess.Popen(call, env=environment, stderr=subprocess.PIPE, text=True)
    end = time.monotonic() + 40
    while not list(folder.glob("*/temporary/cosim-*/resources")):
        assert time.monotonic() < end
        time.sleep(0.05)
    return process


@pytest.mark.parametrize("kind", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_signal_leaves_neither_folder_nor_process(bad, tmp_path, kind):
    path = bad("fmi2DoStep deaf")
    process = begun(path, tmp_path)
    process.send_signal(kind)
    _, told = process.communicate(timeout=30)
    assert process.returncode == (130 if kind == signal.SIGINT else -kind)
    assert told.splitlines() in (["interrupted"], [f"{path}: interrupted"])  # with a first row
    assert list(tmp_path.iterdir()) == []


def test_what_a_killed_command_left_is_removed_by_the_next(bad, tmp_path, monkeypatch):
    process = begun(bad("fmi2DoStep hang"), tmp_path)
    process.kill()
    process.communicate()
    assert len(list(tmp_path.iterdir())) == 1
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    run_apart(bad("none at all"), interface="CoSimulation")
    assert list(tmp_path.iterdir()) == []
