"""Signals and time limits: they wait for extension modules, end workers, and reach every verb."""

import os
import pathlib
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
import zipfile
from contextlib import suppress
from math import inf

import pytest

from cosim.cli.main import main
from cosim.errors import ParameterError
from cosim.extensions import deferred_signals
from cosim.files import written_atomically
from cosim.fmi.run.isolated import run_apart
from cosim.host.limits import MOST_WAIT
from cosim.host.signals import TimeLimit, ended_by_signals
from cosim.host.temporary import temporary_folder
from cosim.study.extremes.campaign import explore, select_cases
from cosim.verify.reference_result import MEASURED

posix = pytest.mark.skipif(sys.platform == "win32", reason="needs signals of POSIX")


def test_signals_wait_for_the_end_of_a_deferring_context():
    done = []

    def interrupted():
        with deferred_signals():
            with deferred_signals():
                signal.raise_signal(signal.SIGINT)
                done.append("inner")
            done.append("outer")

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert done == ["inner", "outer"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_signals_are_not_deferred_in_another_thread():
    inside, over = threading.Event(), threading.Event()

    def load():
        with deferred_signals():
            inside.set()
            over.wait(10)

    thread = threading.Thread(target=load)
    thread.start()
    inside.wait(10)
    try:
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    finally:
        over.set()
        thread.join()


@pytest.mark.parametrize(
    ("owner", "name", "held"),
    [
        (shutil, "rmtree", temporary_folder),
        (pathlib.Path, "unlink", lambda place: written_atomically(place / "x.txt")),
    ],
)
def test_ctrl_c_waits_until_temporary_files_are_removed(owner, name, held, tmp_path, monkeypatch):
    remove = getattr(owner, name)

    def interrupted(*arguments, **options):
        signal.raise_signal(signal.SIGINT)
        return remove(*arguments, **options)

    monkeypatch.setattr(owner, name, interrupted)
    with pytest.raises(KeyboardInterrupt), held(tmp_path):
        raise RuntimeError
    assert not [*tmp_path.iterdir()]


EXTENSION = """
import signal
from importlib.machinery import ExtensionFileLoader
from cosim.extensions import load_extensions_whole

def load(loader, spec):
    signal.raise_signal(signal.SIGINT)
    print("loaded")

ExtensionFileLoader.create_module = load
load_extensions_whole()
try:
    ExtensionFileLoader("name", "path").create_module(None)
except KeyboardInterrupt:
    print("interrupted")
"""


class Dropped:
    """In its `__del__`, Python prints an exception and drops it."""

    def __del__(self):
        signal.raise_signal(signal.SIGINT)


def lose_in_bare_except():
    with suppress(BaseException):  # as modules have it around an import
        signal.raise_signal(signal.SIGINT)


@posix
@pytest.mark.parametrize("lose", [lose_in_bare_except, Dropped])
def test_a_lost_interrupt_is_raised_again_but_not_while_it_is_handled(lose, monkeypatch, capfd):
    monkeypatch.setattr("cosim.host.signals._AGAIN", 0.1)
    cleaned = False

    def interrupted():
        nonlocal cleaned
        with ended_by_signals(command=True):
            lose()
            try:
                time.sleep(20)
            finally:
                time.sleep(0.5)
                cleaned = True

    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert cleaned
    assert time.monotonic() - began < 10  # measured 0.6
    assert capfd.readouterr().err == ""
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_ctrl_c_while_a_class_is_made_is_ctrl_c(monkeypatch, capsys):
    class Interrupts:
        def __set_name__(self, owner, name):
            raise KeyboardInterrupt

    monkeypatch.setattr(
        "cosim.cli.verbs.info.run", lambda _args: type("A", (), {"a": Interrupts()})
    )
    assert main(["info", "crank_shaft"]) == 130
    assert capsys.readouterr().err == "interrupted\n"


def test_ctrl_c_waits_until_an_extension_module_is_loaded():
    done = subprocess.run([sys.executable, "-c", EXTENSION], capture_output=True, text=True)
    assert (done.stdout.split(), done.stderr) == (["loaded", "interrupted"], "")


@pytest.mark.slow
@posix
@pytest.mark.parametrize("delay", [0.05 * i for i in range(25)])
def test_ctrl_c_in_the_first_second_of_an_export_ends_it_in_one_word(delay, tmp_path):
    code = "import sys; print(); sys.stdout.flush(); from cosim.__main__ import command; command()"
    words = [sys.executable, "-c", code, "export", "crank_shaft", "-o", "x.fmu"]
    (tmp_path / "temporary").mkdir()
    process = subprocess.Popen(
        words,
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=os.environ | {"TMPDIR": str(tmp_path / "temporary")},
    )
    process.stdout.readline()  # Python itself has started
    time.sleep(0.02 + delay)
    process.send_signal(signal.SIGINT)
    said = process.communicate(timeout=20)[1]
    left = {path.name for path in tmp_path.rglob("*")} - {"temporary"}
    if delay and left:  # the file was in its place, and is whole
        assert re.fullmatch(rb"(x\.fmu \(\d+ kB\)\n)?(interrupted\n)?", said)
        assert said
        assert left == {"x.fmu"}
        assert MEASURED in zipfile.ZipFile(tmp_path / "x.fmu").namelist()
    else:
        assert (said, left) == (b"interrupted\n", set())


@posix
def test_ctrl_c_ends_the_compiler_of_an_export(tmp_path):
    compiler = tmp_path / "compiler"
    compiler.write_text(f"#!/bin/sh\n: >{tmp_path}/began\nsleep 60\n")
    compiler.chmod(0o755)
    words = [sys.executable, "-m", "cosim", "export", "crank_shaft", "-o", f"{tmp_path}/x.fmu"]
    own = os.environ | {"CC": str(compiler), "COSIM_CACHE": str(tmp_path / "cache")}
    process = subprocess.Popen(words, env=own, stderr=subprocess.PIPE)
    while not (tmp_path / "began").exists():
        assert process.poll() is None
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    assert process.communicate(timeout=10)[1] == b"interrupted\n"  # measured 0.3 s
    assert process.returncode == 130


FOLDER = """
import os, signal
from cosim.codegen.compiler import compiling
from cosim.host.temporary import temporary_folder
with compiling(), temporary_folder() as folder:
    print(folder, flush=True)
    os.kill(os.getpid(), signal.SIGTERM)
"""


@posix
def test_sigterm_while_compiling_leaves_no_temporary_folder():
    done = subprocess.run([sys.executable, "-c", FOLDER], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (-signal.SIGTERM, "")
    assert not pathlib.Path(done.stdout.strip()).exists()


@pytest.mark.parametrize("limit", ["1e10", "inf", "1e400"])
def test_a_time_limit_may_be_as_long_as_one_likes(limit, exported, capsys):
    fmu = str(exported("bar_on_frame"))
    for words in (["info", "bar_on_frame"], ["check", fmu], ["list"], ["extremes", "pendulum"]):
        code = main([*words, "--timeout", limit])
        assert code == (3 if words[0] == "extremes" else 0)  # there is no such model
    assert "Error" not in capsys.readouterr().err.replace("UnknownName", "")


@pytest.mark.parametrize("limit", ["0", "-1", "nan", "-inf", "1_0", "abc", ""])
@pytest.mark.parametrize("verb", ["simulate", "check", "crosscheck"])
def test_a_time_limit_that_is_no_positive_time_is_rejected(verb, limit, capsys):
    with pytest.raises(SystemExit) as ended:
        main([verb, "x.fmu", f"--timeout={limit}"])
    assert ended.value.code == 2
    assert "argument --timeout: " in capsys.readouterr().err


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("limit", [None, inf, MOST_WAIT, 2 * MOST_WAIT, 1e10, 10**12])
def test_a_long_limit_of_an_fmu_limits_nothing(limit, exported):
    assert len(run_apart(exported("bar_on_frame"), timeout=limit, stop_time=0.1)) > 1
    with TimeLimit(limit):
        pass


@posix
@pytest.mark.parametrize("limit", [5e-324, 1e-9, 1e-6, 3e-6, 1e-5])
def test_a_time_that_is_over_at_once_ends_in_one_sentence(limit, capsys):
    """It may be over before the work begins, or as it ends."""
    usual = signal.getsignal(signal.SIGALRM)
    for _ in range(20):
        assert main(["info", "--timeout", str(limit)]) == 1
        err = capsys.readouterr().err
        assert err == f"cosim info did not end within {limit:g} s and was stopped\n"
        assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
        assert signal.getsignal(signal.SIGALRM) == usual


@posix
def test_a_time_limit_holds_for_what_is_read_of_a_file(exported, capsys):
    assert main(["info", str(exported("bar_on_frame")), "--timeout", "1e-9"]) == 1
    assert capsys.readouterr().err == "cosim info did not end within 1e-09 s and was stopped\n"


@posix
def test_a_limit_that_is_reached_as_its_work_ends_raises_nothing_later():
    with TimeLimit(60) as limit:
        pass
    limit.interrupt(signal.SIGALRM, None)  # Python calls handlers late
    assert not limit.reached


@pytest.mark.parametrize("limit", [0, -1.0, float("nan"), -inf, True, "5", 10**400])
def test_a_limit_that_is_no_positive_number_is_rejected(limit, exported):
    with pytest.raises(ParameterError, match="timeout = "):
        run_apart(exported("bar_on_frame"), timeout=limit)


@posix
def test_ctrl_c_reaches_extreme_cases_within_a_second(tmp_path, monkeypatch):
    place = tmp_path / "began"
    text = f"def run(*_): open({str(place)!r}, 'w'); import time; time.sleep(60)"
    (tmp_path / "sleeping.py").write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    sent = []

    def interrupt():
        while not place.exists():
            time.sleep(0.05)
        sent.append(time.monotonic())
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    with pytest.raises(KeyboardInterrupt):
        list(explore(select_cases(["bar_on_frame"])[:4], runner="sleeping:run"))
    assert time.monotonic() - sent[0] < 10  # measured 0.1
    thread.join()


@pytest.mark.slow
@posix
@pytest.mark.parametrize("kind", [signal.SIGTERM, signal.SIGHUP])
def test_a_long_compiled_run_ends_with_its_command(kind, tmp_path):
    parts = pathlib.Path(__file__).parents[2] / "examples" / "coupled" / "parts.py"
    part = f'[parts]\nmass = "{parts.as_posix()}:oscillator"\n'
    (tmp_path / "one.toml").write_text(part)
    words = ["simulate", "one.toml", "--stop-time", "1", "--macro-step", "1e-10"]
    process = subprocess.Popen([sys.executable, "-m", "cosim", *words], cwd=tmp_path)
    time.sleep(20)  # it would run for hours
    assert process.poll() is None
    process.send_signal(kind)
    try:
        assert process.wait(20) == -kind
    finally:
        process.kill()


@pytest.mark.slow
@posix
@pytest.mark.parametrize("kind", [signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_workers_of_a_sweep_end_with_it(kind, tmp_path):
    psutil = pytest.importorskip("psutil")
    pytest.importorskip("distributed")
    words = ["sweep", "crank_shaft", "--solver", "cvodes", "-p", "alpha=5:15:30000"]
    process = subprocess.Popen(
        [sys.executable, "-m", "cosim", *words, "--workers", "2", "-o", "x.csv"], cwd=tmp_path
    )
    while len(workers := psutil.Process(process.pid).children()) < 2:
        assert process.poll() is None
        time.sleep(0.1)
    time.sleep(3)  # the workers have loaded their modules
    process.send_signal(kind)
    assert process.wait(10) == -kind
    assert not psutil.wait_procs(workers, timeout=20)[1]  # measured 0.2 to 1.5 s
    assert not [*tmp_path.iterdir()]
