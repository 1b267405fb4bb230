"""Faults of the machine: a small stack, a time limit, folders mounted noexec, a full disk."""

import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="mounts and limits of Linux")

CALL = f"{sys.executable} -P -m cosim"


def shell(line, **variables):
    return subprocess.run(
        ["sh", "-c", line], env={**os.environ, **variables}, capture_output=True, text=True,
        timeout=100, check=False,
    )  # fmt: skip


@pytest.fixture
def mounted(tmp_path):
    """Return what mounts a file system in memory with some options, and yields its folder."""
    folder = tmp_path / "mounted"
    folder.mkdir()

    def mount(options):
        done = shell(f"mount -t tmpfs -o {options} tmpfs {folder}")
        if done.returncode:
            pytest.skip(f"mounting is not permitted here: {done.stderr.strip()}")
        folder.chmod(0o700)
        return folder

    yield mount
    shell(f"umount {folder}")


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        "simulate bicycle -q --solver dop853 --relative-tolerance 1e-12 --stop-time 1e7"
        " --output-interval 1000 --timeout 10",
        "simulate {own}:loop --timeout 10",
    ],
)
def test_time_limit_ends_a_run_and_code_of_the_user(tmp_path, words):
    own = tmp_path / "own.py"
    own.write_text("def loop():\n    while True: pass\n")
    assert shell(f"{CALL} simulate bicycle -q --solver dop853 --stop-time 1").returncode == 0
    done = shell(f"exec {CALL} {words.format(own=own)}")
    assert done.returncode == 1
    assert bool(done.stdout) == ("bicycle" in words)  # what was computed
    last = done.stderr.splitlines()[-1]
    assert last == "cosim simulate did not end within 10 s and was stopped"


def test_small_stack_is_enough():
    done = shell(f"ulimit -s 256; exec {CALL} simulate crank_shaft -q --stop-time 0.01")
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.slow_rows("check {} --run --trust")
@pytest.mark.parametrize(
    "words", ["simulate {} --trust", "check {} --run --trust", "linearize {} --trust"]
)
def test_binary_in_a_folder_mounted_noexec_is_told(mounted, exported, words):
    line = f"{CALL} {words.format(exported('crank_shaft'))}"
    done = shell(line, TMPDIR=str(mounted("noexec")))
    told = done.stdout + done.stderr
    assert done.returncode in (0, 1)  # of check: it found nothing wrong in the file
    assert "on a file system mounted noexec" in told
    assert "set TMPDIR to another folder" in told


def test_full_folder_for_temporary_files_is_told(mounted, exported):
    place = mounted("size=32k")
    done = shell(f"{CALL} simulate {exported('crank_shaft')} --trust", TMPDIR=str(place))
    assert done.returncode == 1
    assert "No space left on device; make room, or set TMPDIR" in done.stderr
    assert list(place.iterdir()) == []


def cosim_list(code: str) -> subprocess.CompletedProcess[str]:
    """Run `cosim list` by Python code that calls its `main`."""
    return subprocess.run(
        [sys.executable, "-c", code, "list"], capture_output=True, text=True, check=False
    )


def test_ctrl_c_while_modules_are_loaded_is_one_word():
    code = (
        "import sys\n"
        "class Interrupting:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'cosim.cli.options':\n"
        "            raise KeyboardInterrupt\n"
        "sys.meta_path.insert(0, Interrupting())\n"
        "from cosim.__main__ import main\n"
        "sys.exit(main())\n"
    )
    done = cosim_list(code)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "interrupted\n")


def test_ctrl_c_while_python_leaves_changes_nothing():
    code = (
        "import atexit, os, signal, sys\n"
        "from cosim.__main__ import command\n"
        "atexit.register(os.kill, os.getpid(), signal.SIGINT)\n"
        "sys.exit(command())\n"
    )
    done = cosim_list(code)
    assert (done.returncode, done.stderr) == (0, "")
    assert "bicycle" in done.stdout


def test_exit_code_after_ctrl_c_is_130_wherever_it_was_raised():
    code = (
        "import sys\n"
        "from cosim.cli.verbs import info\n"
        "def run(args): exec('raise KeyboardInterrupt')\n"
        "info.run = run\n"
        "from cosim.__main__ import command\n"
        "sys.exit(command())\n"
    )
    done = cosim_list(code)
    assert (done.returncode, done.stderr) == (130, "interrupted\n")


def test_command_line_leaves_ctrl_c_to_the_program_that_calls_it():
    code = (
        "import signal, sys\n"
        "from cosim.__main__ import main\n"
        "usual = signal.getsignal(signal.SIGINT)\n"
        "sys.exit(main() or signal.getsignal(signal.SIGINT) is not usual)\n"
    )
    assert cosim_list(code).returncode == 0


def test_little_is_loaded_before_ctrl_c_is_looked_after():
    code = (
        "import sys\n"
        "before = {*sys.modules}\n"
        "import cosim.__main__\n"
        "print(*sorted({*sys.modules} - before))\n"
    )
    loaded = {*cosim_list(code).stdout.split()}
    assert {name for name in loaded if name.startswith("cosim")} == {
        "cosim",
        "cosim.__main__",
        "cosim.presenters",
    }
    assert not loaded & {"typing", "argparse", "pathlib", "importlib.metadata"}
