"""Whose FMUs run: those exported here at once, others after a word of the user."""

import pytest
from helpers.small_models import decay

import cosim
from cosim.cli.main import main
from cosim.errors import FmuError, SecurityError, UsageError
from cosim.fmi import trust


@pytest.fixture
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("COSIM_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("COSIM_TRUST", raising=False)


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    return cosim.export_fmu(decay(), tmp_path_factory.mktemp("trust") / "decay.fmu").read_bytes()


@pytest.fixture
def foreign(own_cache, exported, tmp_path):
    path = tmp_path / "decay.fmu"
    path.write_bytes(exported)
    return path


def test_own_export_needs_no_word(own_cache, tmp_path, capsys):
    path = cosim.export_fmu(decay("own"), tmp_path / "own.fmu")
    assert main(["simulate", str(path), "--stop-time", "0.1"]) == 0
    assert capsys.readouterr().err == ""
    assert trust.is_made_here(path)


@pytest.mark.slow
def test_foreign_file_is_warned_of_until_it_is_trusted(foreign, capsys):
    words = ["simulate", str(foreign), "--stop-time", "0.1"]
    for _ in range(2):
        assert main(words) == 0
        assert capsys.readouterr().err == (
            f"warning: {foreign} was not exported here: its code will run with your rights, in a "
            "process of its own; to trust this file, say --trust once\n"
        )
    assert main([*words, "--trust"]) == 0
    assert main(words) == 0
    assert capsys.readouterr().err == ""
    assert not trust.is_made_here(foreign)
    foreign.write_bytes(foreign.read_bytes() + b"\0")  # another file of that name
    assert not trust.is_trusted(foreign)


def test_policy_known_refuses_what_is_not_trusted(foreign, monkeypatch, capsys):
    monkeypatch.setenv("COSIM_TRUST", "known")
    verbs = ("simulate", "crosscheck", "linearize", "check --run", "sweep -p x=1,2")
    for verb, *options in (words.split() for words in verbs):
        assert main([verb, str(foreign), *options]) == 1, verb
        captured = capsys.readouterr()
        assert "is not run: it was not exported here" in captured.err
        assert captured.out == ""
    assert main(["simulate", str(foreign), "--trust"]) == 0
    assert main(["simulate", str(foreign)]) == 0


def test_policy_all_asks_for_nothing(foreign, monkeypatch, capsys):
    monkeypatch.setenv("COSIM_TRUST", "all")
    assert main(["simulate", str(foreign), "--stop-time", "0.1"]) == 0
    assert capsys.readouterr().err == ""


def test_unknown_policy_is_refused(foreign, monkeypatch):
    monkeypatch.setenv("COSIM_TRUST", "yes")
    with pytest.raises(UsageError, match="COSIM_TRUST = yes is none of ask, known, all"):
        trust.require_trust(foreign)


@pytest.mark.parametrize(("answer", "runs"), [("y\n", True), ("n\n", False), ("", False)])
def test_at_a_terminal_it_is_asked_once(foreign, monkeypatch, answer, runs):
    class Terminal:
        def isatty(self):
            return True

        def readline(self):
            return answer

        def write(self, text):
            return len(text)

        def flush(self):
            pass

    monkeypatch.setattr(trust.sys, "stdin", Terminal())
    monkeypatch.setattr(trust.sys, "stderr", Terminal())
    if runs:
        trust.require_trust(foreign)
        answer = "n\n"
        trust.require_trust(foreign)
    else:
        with pytest.raises(SecurityError, match="is not run"):
            trust.require_trust(foreign)


def test_what_is_no_fmu_cannot_be_trusted(own_cache, tmp_path):
    (tmp_path / "a.fmu").write_bytes(b"no archive")
    with pytest.raises(FmuError, match="not a zip archive"):
        trust.require_trust(tmp_path / "a.fmu", trusted=True)
    assert not trust.is_trusted(tmp_path / "a.fmu")


@pytest.mark.slow
def test_crosscheck_says_whose_word_a_reference_is(own_cache, tmp_path, capsys, monkeypatch):
    from cosim.verify.reference_result import export_with_reference

    path = export_with_reference(decay("proven"), tmp_path / "proven.fmu")
    assert main(["crosscheck", str(path)]) == 0
    assert "maker's own result" not in capsys.readouterr().err
    monkeypatch.setenv("COSIM_CACHE", str(tmp_path / "elsewhere"))  # another machine
    assert main(["crosscheck", str(path)]) == 0
    told = capsys.readouterr()
    assert "own result: it shows that the file runs here as it did there, not that" in told.err
    assert "reference by cosim-rigid" in told.out
