"""`cosim export` in the same words: the bytes of the first, and CasADi is not even loaded."""

import subprocess
import sys

import pytest

from cosim.cli.main import main
from cosim.fmi.trust import is_made_here
from cosim.verify import kept_export
from cosim.verify.repeated_export import ExportNote, note_export, repeat_export, words_tell_all

WORDS = ["export", "crank_shaft", "--reference", "none", "--json"]


@pytest.fixture(autouse=True)
def own_cache(monkeypatch, tmp_path):
    monkeypatch.setenv("COSIM_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)


def test_the_second_export_is_the_first_one_without_casadi(tmp_path, capfd):
    assert main(WORDS) == 0
    first = (tmp_path / "crank_shaft.fmu").read_bytes()
    (tmp_path / "crank_shaft.fmu").unlink()
    told = capfd.readouterr()
    loads = "assert not {'casadi', 'numpy', 'fmpy'} & set(sys.modules)"
    program = f"import sys; from cosim.cli.main import main; main({WORDS}); {loads}"
    subprocess.run([sys.executable, "-c", program], check=True)
    assert (tmp_path / "crank_shaft.fmu").read_bytes() == first
    assert is_made_here(tmp_path / "crank_shaft.fmu")
    assert capfd.readouterr() == told


@pytest.mark.parametrize(
    ("more", "matters"),
    [
        (["--fmi", "3"], True),
        (["--tunable", "none"], True),
        (["--date", "2026-01-01"], True),
        (["-q", "-o", "elsewhere.fmu"], False),
    ],
)
def test_options_that_matter_are_other_words(more, matters, monkeypatch, tmp_path):
    asked = []

    def noted(words, target):
        asked.append(words)
        return tmp_path, ExportNote("", "", "")

    monkeypatch.setattr("cosim.verify.repeated_export.repeat_export", noted)
    assert main(WORDS) == main([*WORDS, *more]) == 0
    assert (asked[0] != asked[1]) is matters


def test_a_file_that_is_gone_from_the_cache_is_made_again(tmp_path, monkeypatch):
    made = []
    keep = kept_export.keep
    monkeypatch.setattr(kept_export, "keep", lambda *entry: made.append(entry) or keep(*entry))
    assert main(WORDS) == main(WORDS) == 0
    assert len(made) == 1
    for entry in (tmp_path / "cache" / "exports").iterdir():
        if not entry.name.startswith("words-"):
            entry.unlink()
    assert main(WORDS) == 0
    assert len(made) == 2


def test_changed_code_makes_another_file(monkeypatch, tmp_path):
    words = {"model": "bicycle"}
    kept_export.keep("exports/file", b"content")
    note_export(words, ExportNote("exports/file", "bicycle", "bicycle/independent"))
    path, note = repeat_export(words, None)
    assert (path.read_bytes(), note.model) == (b"content", "bicycle/independent")
    monkeypatch.setattr("cosim.verify.made_with._code", lambda: iter([("changed", 1, 2)]))
    assert repeat_export(words, None) is None


def test_words_do_not_tell_what_a_users_file_holds(tmp_path):
    assert words_tell_all("bicycle_path.toml")
    (tmp_path / "bicycle_path.toml").touch()
    for name in ("bicycle_path.toml", "./bicycle_path.toml", "m.py:f", "model.casadi"):
        assert not words_tell_all(name)
