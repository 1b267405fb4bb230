"""The cache: private, bounded, and every entry checked before it is used."""

import ctypes
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from cosim.codegen import cache, compiler
from cosim.codegen.compiler import cached_library
from cosim.errors import CacheError, MissingTool
from cosim.host.temporary import remove_leftovers, temporary_folder

CODE = "int answer(void) { return 42; }\n"
posix = pytest.mark.skipif(os.name == "nt", reason="owners and permissions of POSIX")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    chosen = tmp_path / "cache"
    monkeypatch.setenv("COSIM_CACHE", str(chosen))
    monkeypatch.setattr(compiler, "_HIDE_SYMBOLS", ())  # CODE marks nothing for export
    return chosen


def made(folder):
    return sorted(path for path in folder.iterdir() if path.name != ".lock")


def damage(library, content):
    library.unlink()  # as this process has mapped it
    library.write_bytes(content)


# -- damage ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("offset", [0, 4, 100, 600, 2000, -300, -20, -1])
def test_library_with_one_flipped_bit_is_rebuilt_with_one_warning(folder, offset, recwarn):
    library = cached_library("key", lambda: CODE)
    whole = library.read_bytes()
    changed = bytearray(whole)
    changed[offset] ^= 0x10
    damage(library, changed)
    again = cached_library("key", lambda: CODE)
    assert again.read_bytes() == whole
    assert ctypes.CDLL(str(again)).answer() == 42
    assert cached_library("key", lambda: pytest.fail("made a third time")) == again
    assert [str(w.message) for w in recwarn] == [f"{library} was corrupt and has been rebuilt"]


@pytest.mark.parametrize("content", [b"", b"\x7fELF", bytes(16384)])
def test_truncated_or_zeroed_library_is_rebuilt(folder, content):
    library = cached_library("key", lambda: CODE)
    damage(library, content)
    with pytest.warns(RuntimeWarning, match="was corrupt"):
        assert ctypes.CDLL(str(cached_library("key", lambda: CODE))).answer() == 42


@posix
@pytest.mark.parametrize("kind", ["link", "dangling link", "pipe"])
def test_link_or_pipe_in_place_of_a_library_is_replaced(folder, kind, tmp_path):
    library = cached_library("key", lambda: CODE)
    elsewhere = tmp_path / "elsewhere.so"
    content = library.read_bytes()
    library.unlink()
    if kind == "pipe":
        os.mkfifo(library)
    else:
        library.symlink_to(elsewhere)
        if kind == "link":
            elsewhere.write_bytes(content)
    again = cached_library("key", lambda: CODE)
    assert again.is_file()
    assert not again.is_symlink()
    assert ctypes.CDLL(str(again)).answer() == 42


def test_folder_in_place_of_a_library_is_rejected(folder):
    library = cached_library("key", lambda: CODE)
    library.unlink()
    library.mkdir()
    with pytest.raises(MissingTool, match=r"Is a directory; set COSIM_CACHE|Access"):
        cached_library("key", lambda: CODE)
    assert made(folder) == [library]


@pytest.mark.parametrize("content", [b"", b"\0" * 100, b"{" * 5000, b"cosim-cache 1 \n", None])
def test_corrupt_entry_is_none_with_one_warning(folder, content):
    cache.store("fronts/one", b"content")
    assert cache.content_of("fronts/one") == b"content"
    place = folder / "fronts" / "one"
    place.write_bytes(place.read_bytes()[:-1] if content is None else content)
    with pytest.warns(RuntimeWarning, match="was corrupt"):
        assert cache.content_of("fronts/one") is None
    assert cache.content_of("fronts/one") is None  # and no second warning
    cache.store("fronts/one", b"content")
    assert cache.content_of("fronts/one") == b"content"


@posix
@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir, lambda p: p.symlink_to("/dev/zero")])
def test_pipe_folder_or_device_in_place_of_an_entry_is_not_read(folder, make):
    cache.store("fronts/other", b"")
    make(folder / "fronts" / "one")
    assert cache.content_of("fronts/one") is None


# -- whose it is ----------------------------------------------------------------------------------


@posix
@pytest.mark.parametrize("mask", [0o000, 0o022, 0o077])
def test_cache_is_the_users_alone_whatever_the_umask(tmp_path, monkeypatch, mask):
    monkeypatch.setenv("COSIM_CACHE", str(tmp_path / "a" / "b"))
    before = os.umask(mask)
    try:
        private = cache.private_folder()
    finally:
        os.umask(before)
    assert [p.stat().st_mode & 0o777 for p in (private, private.parent)] == [0o700, 0o700]


@posix
def test_older_cache_that_others_can_read_is_closed(folder):
    folder.mkdir(mode=0o755)
    assert cache.private_folder().stat().st_mode & 0o777 == 0o700


@posix
@pytest.mark.parametrize("mode", [0o777, 0o757, 0o1777])
def test_cache_writable_by_others_is_rejected_before_anything_is_loaded(folder, mode):
    folder.mkdir()
    folder.chmod(mode)
    with pytest.raises(CacheError, match=r"other users can write to .*set COSIM_CACHE"):
        cached_library("key", lambda: pytest.fail("generated"))
    assert made(folder) == []


@posix
def test_cache_below_a_folder_writable_by_others_is_rejected(folder):
    folder.parent.chmod(0o777)
    with pytest.raises(CacheError, match=f"other users can write to {folder.parent}; set"):
        cache.private_folder()
    folder.parent.chmod(0o1777)  # where nobody can move what is another's
    cache.private_folder()


@posix
@pytest.mark.skipif(os.name == "nt" or os.geteuid() != 0, reason="only root gives files away")
@pytest.mark.parametrize("which", ["cache", "above"])
def test_cache_of_another_user_is_rejected(folder, which):
    folder.mkdir(mode=0o700)
    os.chown(folder if which == "cache" else folder.parent, 12345, -1)
    with pytest.raises(CacheError, match="is another user's; set COSIM_CACHE"):
        cache.private_folder()


def test_missing_home_folder_is_reported_with_a_remedy(monkeypatch):
    for name in ("COSIM_CACHE", "XDG_CACHE_HOME", "LOCALAPPDATA"):
        monkeypatch.delenv(name, raising=False)

    def homeless():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", homeless)
    with pytest.raises(MissingTool, match=r"no home folder .*set COSIM_CACHE"):
        cached_library("key", lambda: CODE)


@posix
def test_noexec_is_reported_before_anything_is_compiled(folder, monkeypatch):
    class Noexec:
        f_flag = os.ST_NOEXEC

    monkeypatch.setattr(compiler.os, "statvfs", lambda place: Noexec)
    with pytest.raises(
        MissingTool, match=r"mounted noexec.*set COSIM_CACHE .*--backend native-interpreted"
    ):
        cached_library("key", lambda: pytest.fail("generated"))
    assert made(folder) == []


# -- how large it is ------------------------------------------------------------------------------


def test_entries_used_longest_ago_go_first(folder):
    for age, name in ((3, "a"), (2, "b"), (1, "c")):
        cache.store(f"fronts/{name}", bytes(1000))
        when = time.time() - age * 3600
        os.utime(folder / "fronts" / name, (when, when))
    cache.content_of("fronts/a")  # is use
    cache.prune(2200)
    assert sorted(p.name for p in (folder / "fronts").iterdir()) == ["a", "c"]


def test_size_is_bounded_by_the_environment(folder, monkeypatch):
    monkeypatch.setenv("COSIM_CACHE_SIZE", "2500")
    for name in "abcd":
        cache.store(f"fronts/{name}", bytes(1000))
        when = time.time() - 3600
        os.utime(folder / "fronts" / name, (when, when))
    cache.store("fronts/e", bytes(1000))
    assert [p.name for p in (folder / "fronts").iterdir() if p.name == "e"] == ["e"]
    assert cache.contents().files == 2


def test_entries_of_a_few_bytes_are_written_without_a_look_at_all_others(folder, monkeypatch):
    looks = []
    monkeypatch.setattr(cache, "prune", lambda: looks.append(1))
    cache.store("fronts/little", b"exported here")
    assert not looks
    cache.store("fronts/large", bytes(10_000))
    assert looks


def test_every_folder_that_is_written_to_is_pruned_and_cleared(folder):
    for name in ("pictures", "made", "fronts"):
        cache.store(f"{name}/a", b"x")
    assert cache.clear().files == 3


@pytest.mark.parametrize("size", ["-1", "2GB", "1e9"])
def test_invalid_size_is_rejected(folder, monkeypatch, size):
    monkeypatch.setenv("COSIM_CACHE_SIZE", size)
    with pytest.raises(CacheError, match=r"COSIM_CACHE_SIZE = .* is not a number of bytes"):
        cache.store("fronts/a", b"")


def test_clear_removes_what_the_cache_made_and_nothing_else(folder):
    cached_library("key", lambda: CODE)
    cache.store("fronts/a", b"x")
    (folder / "mine").mkdir()
    (folder / "mine" / "thesis.tex").write_text("all of it")
    assert cache.clear().files == 2
    assert cache.contents().files == 0
    assert (folder / "mine" / "thesis.tex").exists()


# -- what killed processes leave ------------------------------------------------------------------

KILLED = """
import os, signal
from pathlib import Path
from cosim.host.temporary import temporary_folder
with temporary_folder(Path({place!r})) as folder:
    (folder / "half").write_text("made")
    os.kill(os.getpid(), signal.SIGKILL)
"""


@posix
def test_folder_of_a_killed_process_is_removed_by_the_next(tmp_path):
    for _ in range(3):
        subprocess.run([sys.executable, "-c", KILLED.format(place=str(tmp_path))], check=False)
        assert len(list(tmp_path.iterdir())) == 1
    with temporary_folder(tmp_path) as own:
        assert list(tmp_path.iterdir()) == [own]
        assert remove_leftovers(tmp_path) == 0  # a living process keeps its own
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["cosim-1-2", "cosim-", "cosim-a-b-c", "cosimulation", "mine"])
def test_folders_of_other_names_are_left_alone(tmp_path, name):
    (tmp_path / name).mkdir()
    assert remove_leftovers(tmp_path) == 0


# -- many at once ---------------------------------------------------------------------------------


@pytest.mark.slow
@posix
def test_twenty_processes_with_a_cold_cache_compile_once(folder, tmp_path):
    program = f"""
from cosim.codegen import compiler
compiler._HIDE_SYMBOLS = ()
def generate():
    with open({str(tmp_path / "calls")!r}, "a") as file:
        file.write("x")
    return {CODE!r}
import ctypes
assert ctypes.CDLL(str(compiler.cached_library("key", generate))).answer() == 42
"""
    many = [subprocess.Popen([sys.executable, "-c", program]) for _ in range(20)]
    assert [process.wait(60) for process in many] == [0] * 20
    assert (tmp_path / "calls").read_text() == "x"
    assert len(made(folder)) == 1


@posix
def test_home_that_cannot_be_written_is_replaced_by_a_temporary_folder(tmp_path, monkeypatch):
    (tmp_path / "home").write_text("no folder", encoding="utf-8")
    monkeypatch.setenv("COSIM_CACHE", "")
    for name in ("HOME", "XDG_CACHE_HOME", "TMPDIR"):
        monkeypatch.setenv(name, str(tmp_path / "home"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with pytest.warns(RuntimeWarning, match="Not a directory; .* is used instead") as warned:
        library = cached_library("key", lambda: CODE)
    assert library.parent.parent == tmp_path
    assert len(warned) == 1
    assert cached_library("key", lambda: pytest.fail("made again")) == library
