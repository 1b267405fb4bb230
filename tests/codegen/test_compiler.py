"""The compiler search, the cache, and every failure of compiling: reported and limited."""

import ctypes
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path

import pytest

from cosim.codegen import compiler as compiling
from cosim.codegen.compiler import cached_library, compile_library, find_compiler, has_compiler
from cosim.errors import MissingTool

CODE = "int answer(void) { return 42; }\n"


@pytest.fixture
def cache(tmp_path, monkeypatch):
    folder = tmp_path / "cache"
    monkeypatch.setenv("COSIM_CACHE", str(folder))
    monkeypatch.setattr(compiling, "_HIDE_SYMBOLS", ())  # CODE marks nothing for export
    return folder


@pytest.fixture
def script(tmp_path, monkeypatch):
    """Make $CC a shell script of these lines."""

    def install(*lines):
        path = tmp_path / "compiler"
        path.write_text("\n".join(("#!/bin/sh", *lines, "")))
        path.chmod(0o755)
        monkeypatch.setenv("CC", str(path))
        return path

    return install


def names(folder):
    return sorted(path.name for path in folder.iterdir() if path.name != ".lock")


def test_compiled_code_is_stored_and_not_compiled_twice(cache, script):
    library = cached_library("key", lambda: CODE)
    assert ctypes.CDLL(str(library)).answer() == 42
    assert names(cache) == [library.name]
    script("exit 1")  # another compiler: another library
    with pytest.raises(MissingTool):
        cached_library("key", lambda: CODE)


def test_second_library_of_the_same_key_starts_no_compiler(cache, script, tmp_path):
    script(f"echo x >> {tmp_path}/calls", 'exec cc "$@"')
    first = cached_library("key", lambda: CODE)
    assert cached_library("key", lambda: pytest.fail("generated again")) == first
    assert cached_library("other key", lambda: CODE) != first
    assert (tmp_path / "calls").read_text() == "x\nx\n"


def test_library_for_another_processor_is_not_loaded(cache, monkeypatch):
    first = cached_library("key", lambda: CODE)
    options, _ = compiling._own_processor()
    monkeypatch.setattr(compiling, "_own_processor", lambda: (options, "flags: other"))
    assert cached_library("key", lambda: CODE) != first


def test_corrupt_library_is_rebuilt(cache):
    library = cached_library("key", lambda: CODE)
    library.write_bytes(library.read_bytes()[:100])
    with pytest.warns(RuntimeWarning, match="was corrupt and has been rebuilt"):
        again = cached_library("key", lambda: CODE)
    assert again == library
    assert ctypes.CDLL(str(again)).answer() == 42


def test_long_code_is_compiled_with_less_optimization(cache, script, tmp_path):
    script(f'echo "$@" >> {tmp_path}/calls', 'exec cc "$@"')
    cached_library("short", lambda: CODE)
    cached_library("long", lambda: CODE + "/*" + "x" * 200_000 + "*/")
    short, long = (tmp_path / "calls").read_text().splitlines()
    assert [word for word in short.split() if word.startswith("-O")] == ["-O2"]
    assert [word for word in long.split() if word.startswith("-O")][-1] == "-O1"  # which counts


def test_level_of_CC_replaces_those_of_the_package(cache, script, monkeypatch, tmp_path):
    path = script(f'echo "$@" >> {tmp_path}/calls', 'exec cc "$@"')
    monkeypatch.setenv("CC", f"{path} -O0")
    short = cached_library("short", lambda: CODE)
    cached_library("long", lambda: CODE + "/*" + "x" * 200_000 + "*/")
    for call in (tmp_path / "calls").read_text().splitlines():
        assert [word for word in call.split() if word.startswith("-O")] == ["-O0"]
    monkeypatch.setenv("CC", str(path))
    assert cached_library("short", lambda: CODE) != short  # another level: another library


def test_compiler_is_searched_in_the_order_of_the_documentation(monkeypatch, tmp_path):
    for name in ("gcc", "clang"):
        (tmp_path / name).write_text("#!/bin/sh\n")
        (tmp_path / name).chmod(0o755)
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert find_compiler() == (str(tmp_path / "gcc"),)
    (tmp_path / "gcc").unlink()
    assert find_compiler() == (str(tmp_path / "clang"),)
    (tmp_path / "clang").unlink()
    monkeypatch.setattr(compiling, "find_spec", lambda name: name == "ziglang")
    assert find_compiler() == (sys.executable, "-P", "-m", "ziglang", "cc")
    monkeypatch.setenv("CC", "/bin/sh -c")  # a command with an argument, as make takes it
    assert find_compiler() == ("/bin/sh", "-c")


# -- faults ---------------------------------------------------------------------------------------


def test_missing_compiler_is_reported_with_attempts_and_remedy(monkeypatch, tmp_path):
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(compiling, "find_spec", lambda name: None)
    assert not has_compiler()
    with pytest.raises(MissingTool, match=r"tried \$CC, cc, gcc, clang, ziglang.*pip install"):
        find_compiler()


@pytest.mark.parametrize("chosen", ["no_such_compiler", "/no/such/gcc -m64", "gcc 'open", " "])
def test_wrong_CC_is_an_error_and_not_ignored(monkeypatch, chosen):
    monkeypatch.setenv("CC", chosen)
    with pytest.raises(MissingTool, match="unset CC"):
        has_compiler()


def test_failing_compiler_is_quoted_with_its_command_and_its_last_lines(cache, script):
    script("for i in $(seq 100); do echo line $i >&2; done", "exit 3")
    with pytest.raises(MissingTool) as caught:
        cached_library("key", lambda: CODE)
    message = str(caught.value)
    assert "compiler -O2" in message
    assert "line 100" in message
    assert "line 81" in message
    assert "line 80" not in message
    assert "CC=" in message
    assert "--backend native-interpreted" in message
    assert names(cache) == []


def test_compiler_error_in_the_code_is_quoted(cache):
    with pytest.raises(MissingTool, match=r"(?s)failed:.*error"):
        cached_library("key", lambda: "this is no C")


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (r"printf '\n \n\nreal error\n\n'; exit 1", r"failed:\nreal error\nuse another compiler"),
        ("echo; exit 1", "failed without a message; use another compiler"),
    ],
    ids=["blank lines first", "nothing"],
)
def test_blank_lines_of_a_compiler_are_left_out(line, words, cache, script):
    script(line)
    with pytest.raises(MissingTool, match=words):
        cached_library("key", lambda: CODE)


def test_compiler_that_writes_nothing_has_failed(cache, script):
    script("exit 0")
    with pytest.raises(MissingTool, match="failed"):
        cached_library("key", lambda: CODE)
    assert names(cache) == []


def test_file_that_is_no_program_cannot_be_run(cache, monkeypatch, tmp_path):
    program = tmp_path / "cc"
    program.write_bytes(b"\x7fELF nonsense")
    program.chmod(0o755)
    monkeypatch.setenv("CC", str(program))
    with pytest.raises(MissingTool, match=r"could not be run: .*Exec format error"):
        cached_library("key", lambda: CODE)


def test_hanging_compiler_is_stopped_with_its_children(cache, script, tmp_path, monkeypatch):
    # A shell whose child keeps the output open, as a hanging ccache does
    script(f"sleep 60 & echo $! > {tmp_path}/child", "wait")
    monkeypatch.setattr(compiling, "TIMEOUT", 0.5)
    began = time.monotonic()
    with pytest.raises(MissingTool, match=r"was stopped after 0\.5 s"):
        cached_library("key", lambda: CODE)
    assert time.monotonic() - began < 10
    child = Path("/proc", (tmp_path / "child").read_text().strip(), "stat")
    with suppress(FileNotFoundError):  # gone, or dead and not collected
        while ") Z " not in child.read_text():
            assert time.monotonic() - began < 20
            time.sleep(0.05)
    assert names(cache) == []


CALLER = """
import os, sys
from cosim.codegen.compiler import cached_library
print(os.getpid(), flush=True)
cached_library("key", lambda: "int answer(void) { return 42; }")
"""
signals = pytest.mark.parametrize(
    "ending", [signal.SIGTERM, signal.SIGINT, signal.SIGKILL], ids=lambda each: each.name
)


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
@signals
def test_compiler_ends_with_its_caller_and_the_next_one_cleans_up(ending, cache, script, tmp_path):
    script(f"echo $$ > {tmp_path}/pid", f"sleep 60 & echo $! > {tmp_path}/child", "wait")
    caller = subprocess.Popen([sys.executable, "-c", CALLER], stderr=subprocess.DEVNULL)
    processes = [tmp_path / "pid", tmp_path / "child"]
    wait_until(lambda: all(path.exists() and path.read_text() for path in processes))
    caller.send_signal(ending)
    assert caller.wait(20) != 0
    wait_until(lambda: not any(runs(int(path.read_text())) for path in processes))
    script('exec cc "$@"')
    library = cached_library("key", lambda: CODE)
    assert names(cache) == [library.name]


def wait_until(condition, seconds=20):
    began = time.monotonic()
    while not condition():
        assert time.monotonic() - began < seconds
        time.sleep(0.05)


def runs(process):
    try:
        return ") Z " not in Path("/proc", str(process), "stat").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return False


@pytest.mark.parametrize("place", ["/proc/cache", "/dev/null/cache"])
def test_unwritable_cache_is_reported(monkeypatch, place):
    # /proc and a device refuse a folder to every user, root included
    monkeypatch.setenv("COSIM_CACHE", place)
    with pytest.raises(MissingTool, match=f"cannot store compiled code in {place}: .*COSIM_CACHE"):
        cached_library("key", lambda: CODE)


def test_full_disk_is_reported(cache, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(compiling.Path, "write_text", full)
    with pytest.raises(MissingTool, match="No space left on device; set COSIM_CACHE"):
        cached_library("key", lambda: CODE)
    assert names(cache) == []


def test_two_processes_may_make_the_same_library(cache):
    program = (
        "from cosim.codegen import compiler as c; c._HIDDEN = ();"
        f"print(c.cached_library('key', lambda: {CODE!r}).name)"
    )
    command = [sys.executable, "-c", program]
    both = [subprocess.Popen(command, stdout=subprocess.PIPE, env=os.environ) for _ in "12"]
    first, second = (process.communicate()[0] for process in both)
    assert first == second
    assert names(cache) == [first.decode().strip()]


# -- Windows, as far as it can be played here ------------------------------------------------------


@pytest.mark.parametrize(("bundled", "given"), [(False, False), (True, True)])
def test_windows_compilers_but_the_bundled_one_get_neither_fpic_nor_libm(
    bundled, given, script, tmp_path, monkeypatch
):
    script(f'echo "$@" >> {tmp_path}/calls', 'printf MZ >"$WANTED"')
    monkeypatch.setenv("WANTED", str(tmp_path / "code.dll"))
    monkeypatch.setattr(compiling.sys, "platform", "win32")
    command = [str(tmp_path / "compiler"), *["ziglang"] * bundled]
    compile_library([tmp_path / "code.c"], tmp_path / "code.dll", command=command)
    words = (tmp_path / "calls").read_text().split()
    assert ("-fPIC" in words, "-lm" in words) == (given, given)


@pytest.mark.parametrize("path", [r"C:\LLVM\bin\clang.exe", r"C:\Program Files\clang.exe"])
def test_paths_with_backslashes_and_spaces_are_read_as_windows_writes_them(path, monkeypatch):
    chosen = f'"{path}" -m64' if " " in path else f"{path} -m64"
    monkeypatch.setenv("CC", chosen)
    monkeypatch.setattr(compiling.shutil, "which", lambda name: name)
    monkeypatch.setattr(compiling.sys, "platform", "win32")
    assert find_compiler() == (path, "-m64")


def test_library_that_another_process_has_made_and_loaded_meanwhile_is_taken(cache, monkeypatch):
    def refuse(self, target):  # as Windows does where the target is loaded
        target.write_bytes(self.read_bytes())
        raise PermissionError(13, "Access is denied")

    monkeypatch.setattr(Path, "replace", refuse)
    assert ctypes.CDLL(str(cached_library("key", lambda: CODE))).answer() == 42


def test_temporary_files_of_a_compiler_are_removed(cache, script, tmp_path, monkeypatch):
    theirs = tmp_path / "temporary"
    theirs.mkdir()
    for name in ("TMPDIR", "TEMP", "TMP"):
        monkeypatch.setenv(name, str(theirs))
    script('echo half > "${TMPDIR:-/tmp}/cc123.s"', "exit 1")  # as one that is interrupted
    with pytest.raises(MissingTool):
        cached_library("key", lambda: CODE)
    assert (names(cache), names(theirs)) == ([], [])


# -- The compiler in ziglang -----------------------------------------------------------------------

needs_zig = pytest.mark.skipif(find_spec("ziglang") is None, reason="no ziglang")
ZIG = (sys.executable, "-m", "ziglang", "cc")


@needs_zig
@pytest.mark.skipif(sys.platform == "win32", reason="needs the runtime library there")
def test_bundled_compiler_builds_its_runtime_library_only_for_code_that_needs_it(
    tmp_path, monkeypatch
):
    built = tmp_path / "zig"
    monkeypatch.setenv("ZIG_GLOBAL_CACHE_DIR", str(built))
    source = tmp_path / "code.c"
    source.write_text(CODE)
    compile_library([source], tmp_path / "code.so", command=ZIG)
    assert ctypes.CDLL(str(tmp_path / "code.so")).answer() == 42
    assert not [*built.rglob("*compiler_rt*")]


@needs_zig
@pytest.mark.slow
def test_code_that_needs_the_runtime_library_of_the_bundled_compiler_gets_it(tmp_path):
    source = tmp_path / "code.c"
    source.write_text(
        "int answer(int n) { return (int)(((unsigned __int128)84 << 90) / n >> 90); }"
    )
    compile_library([source], tmp_path / "code.so", command=ZIG)
    assert ctypes.CDLL(str(tmp_path / "code.so")).answer(2) == 42
