"""Writing files: whole or not at all, and a refusal that says why."""

import os
import signal
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from cosim import files
from cosim.errors import ExportError
from cosim.files import reject_unwritable, write_atomically


def entries(folder):
    return sorted(path.name for path in folder.iterdir())


def test_content_arrives_and_nothing_else_stays(tmp_path):
    assert write_atomically(tmp_path / "a.csv", b"new") == tmp_path / "a.csv"
    assert (tmp_path / "a.csv").read_bytes() == b"new"
    assert entries(tmp_path) == ["a.csv"]


@pytest.mark.parametrize(
    "name", ["with space.csv", "#%20?.csv", "größe.csv", "ü" * 120, "a" * 250, "-p"]
)
def test_unusual_names_are_written_as_they_are(tmp_path, name):
    write_atomically(tmp_path / name, b"1")
    assert entries(tmp_path) == [name]


def test_new_file_gets_the_permissions_of_the_user_s_mask(tmp_path):
    before = os.umask(0o027)
    try:
        write_atomically(tmp_path / "a.csv", b"1")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a.csv").stat().st_mode) == 0o640


def test_replaced_file_keeps_its_permissions(tmp_path):
    target = tmp_path / "a.csv"
    target.write_bytes(b"old")
    target.chmod(0o600)
    write_atomically(target, b"new")
    assert stat.S_IMODE(target.stat().st_mode) == 0o600


def test_link_is_followed(tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "link.csv").symlink_to(tmp_path / "folder" / "real.csv")
    write_atomically(tmp_path / "link.csv", b"1")
    assert (tmp_path / "link.csv").is_symlink()
    assert (tmp_path / "folder" / "real.csv").read_bytes() == b"1"


def test_device_is_written_to_and_not_replaced():
    write_atomically(os.devnull, b"1")
    reject_unwritable(os.devnull)
    assert stat.S_ISCHR(Path(os.devnull).stat().st_mode)


@pytest.mark.skipif(not Path("/dev/fd").exists(), reason="no file has the names of descriptors")
def test_pipe_that_a_link_stands_for_is_written_to():
    reading, writing = os.pipe()  # as /dev/stdout is in `cosim ... -o /dev/stdout | cat`
    try:
        reject_unwritable(f"/dev/fd/{writing}")
        write_atomically(f"/dev/fd/{writing}", b"1")
        assert os.read(reading, 9) == b"1"
    finally:
        os.close(reading)
        os.close(writing)


@pytest.mark.parametrize("act", [lambda path: write_atomically(path, b"1"), reject_unwritable])
def test_file_that_is_read_only_is_not_replaced(tmp_path, monkeypatch, act):
    # as for every user but root, who may write to it
    monkeypatch.setattr(os, "access", lambda path, _: bool(Path(path).stat().st_mode & 0o200))
    target = tmp_path / "a.csv"
    target.write_bytes(b"old")
    target.chmod(0o444)
    with pytest.raises(ExportError, match=r"cannot write .*a\.csv: Permission denied"):
        act(target)
    assert target.read_bytes() == b"old"
    target.chmod(0o644)
    act(target)


@pytest.mark.parametrize("act", [lambda path: write_atomically(path, b"1"), reject_unwritable])
@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("missing/a.csv", "No such file or directory; create .*missing first"),
        ("folder", "it is a directory; give a file name"),
        ("file/a.csv", "Not a directory"),
        ("a" * 300, "File name too long"),
        ("a\0b", "null"),
    ],
)
def test_impossible_target_is_refused_with_its_reason(tmp_path, act, name, reason):
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_bytes(b"old")
    with pytest.raises(ExportError, match=f"cannot write .*: .*{reason}"):
        act(tmp_path / name)
    assert entries(tmp_path) == ["file", "folder"]
    assert (tmp_path / "file").read_bytes() == b"old"


@pytest.mark.parametrize("act", [lambda path: write_atomically(path, b"1"), reject_unwritable])
def test_read_only_folder_is_refused(act):
    # /proc refuses new files to every user, root included
    with pytest.raises(ExportError, match=r"cannot write /proc/a\.csv: "):
        act("/proc/a.csv")


@pytest.mark.parametrize("broken", ["fsync", "replace"])
def test_failure_while_writing_leaves_the_old_file_and_no_rest(tmp_path, monkeypatch, broken):
    target = tmp_path / "a.csv"
    target.write_bytes(b"old")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(
        *((files.os, "fsync") if broken == "fsync" else (files.Path, "replace")), full
    )
    with pytest.raises(ExportError, match="No space left on device"):
        write_atomically(target, b"new")
    assert target.read_bytes() == b"old"
    assert entries(tmp_path) == ["a.csv"]


def test_interrupt_while_writing_leaves_the_old_file_and_no_rest(tmp_path, monkeypatch):
    target = tmp_path / "a.csv"
    target.write_bytes(b"old")

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(files.os, "fsync", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_atomically(target, b"new")
    assert target.read_bytes() == b"old"
    assert entries(tmp_path) == ["a.csv"]


def test_checking_a_target_leaves_it_alone(tmp_path):
    reject_unwritable(tmp_path / "new.csv")
    assert entries(tmp_path) == []
    (tmp_path / "old.csv").write_bytes(b"old")
    reject_unwritable(tmp_path / "old.csv")
    assert (tmp_path / "old.csv").read_bytes() == b"old"


WRITER = """
import sys, time
from cosim.files import written_atomically
with written_atomically(sys.argv[1]) as stream:
    stream.write(b"half")
    print("writing", flush=True)
    time.sleep(60)
"""


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_nothing_stays_of_a_writer_that_was_killed(number, tmp_path):
    target = tmp_path / "o.csv"
    target.write_bytes(b"old")
    with subprocess.Popen([sys.executable, "-c", WRITER, target], stdout=subprocess.PIPE) as writer:
        assert writer.stdout.readline() == b"writing\n"
        assert len(entries(tmp_path)) == 2
        writer.send_signal(number)
        assert writer.wait() == -number
    assert target.read_bytes() == b"old"
    assert len(entries(tmp_path)) == (1 if number == signal.SIGTERM else 2)
    write_atomically(target, b"new")  # and removes what is left
    assert entries(tmp_path) == ["o.csv"]


def test_writing_changes_nothing_that_other_threads_share(tmp_path, monkeypatch):
    called = list[int]()
    monkeypatch.setattr(os, "umask", called.append)
    write_atomically(tmp_path / "new.csv", b"new")
    assert not called
