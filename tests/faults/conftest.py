"""Runs rows of the table and counts how they end badly: `pytest tests/faults` prints the counts."""

import itertools
import re
import shlex
import signal
import subprocess
import sys
import tempfile
from collections import Counter

import pytest
from helpers.fault_rows import ANY, HERE, WRONG, Row
from helpers.hostile import hostile, hostile_binary
from helpers.left_processes import left_processes

from cosim.cli.main import main

BAD = ("silent", "nan", "hang", "crash", "traceback", "leftover", "orphan", "other")
LIMIT = 60  # s
_NAN = re.compile(r"(?:^|[,\s])nan(?=[,\s]|$)", re.MULTILINE)  # a cell of a table
_NAN_WORDS = re.compile(r"finite|no value|nan", re.IGNORECASE)
COUNTS: Counter[str] = Counter()  # of what a test says with `record_property`


def pytest_runtest_logreport(report):
    if report.when == "teardown":  # xdist hands the reports of its workers on
        COUNTS.update(dict(report.user_properties).get("faults", {}))


def pytest_terminal_summary(terminalreporter):
    if COUNTS["rows"]:
        told = ", ".join(f"{name} {COUNTS[name]}" for name in BAD)
        terminalreporter.write_line(f"{COUNTS['rows']} faults: {told}")
    if COUNTS["calls"]:
        terminalreporter.write_line(f"{COUNTS['calls']} random calls of FMUs under sanitizers")
    if COUNTS["kills"]:
        terminalreporter.write_line(f"{COUNTS['kills']} kills during writes: torn {COUNTS['torn']}")


@pytest.fixture
def counts(record_property):
    """Return where a test counts what the summary adds up."""
    own: Counter[str] = Counter()
    yield own
    record_property("faults", dict(own))


@pytest.fixture(scope="session")
def misbehaving(tmp_path_factory):
    return hostile(hostile_binary(tmp_path_factory.mktemp("hostile")))


@pytest.fixture
def ends_well(request, tmp_path, monkeypatch, capfd, counts):
    """Return what runs a row and returns what is wrong with its end, by kind."""
    numbers = itertools.count()

    def run(row: Row) -> dict[str, str]:
        own = tmp_path / str(next(numbers))
        place, temporary = own / "he r\u00e9", own / "temp r\u00e9"  # as users name their folders
        place.mkdir(parents=True)
        temporary.mkdir()
        monkeypatch.chdir(place)
        monkeypatch.setenv("TMPDIR", str(temporary))
        monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")  # else Python writes beside own.py
        monkeypatch.setattr(tempfile, "tempdir", str(temporary))
        if row.prepare:
            row.prepare(place)
        before = sorted(place.iterdir())
        words = list(row.words)
        if len(words) > 1 and words[1].startswith("fmi2"):
            words[1] = str(request.getfixturevalue("misbehaving")(words[1]))
        code = _here(words) if row.where == HERE else _apart(words, row.shell)
        printed = capfd.readouterr()
        wrong = _wrong(row, code, printed.out, printed.err)
        if code == 0 and row.expected and (place / row.expected[0]).read_bytes() != row.expected[1]:
            wrong["silent"] = f"{row.expected[0]} has other results: {printed.err}"
        if sorted(place.iterdir()) != before or any(temporary.iterdir()):
            wrong["leftover"] = str([*place.iterdir(), *temporary.iterdir()])
        if orphans := left_processes(str(temporary)):
            wrong["orphan"] = str(orphans)
        counts.update(["rows", *wrong])
        return wrong

    return run


def _wrong(row: Row, code: int | str, out: str, err: str) -> dict[str, str]:
    wrong: dict[str, str] = {}
    lines = [line for line in err.splitlines() if not line.startswith(("warning: ", "note: "))]
    allowed = {WRONG: (1, 2, 3, 5), ANY: (0, 1, 2, 3, 4, 5)}.get(row.code, (row.code,))
    if code == "hang":
        wrong["hang"] = err
    elif isinstance(code, int) and code < 0:
        wrong["crash"] = f"signal {-code}"
    elif code == 0 and 0 not in allowed:
        wrong["silent"] = out
    elif code not in allowed:
        wrong["other"] = f"exit code {code}: {err}"
    if "Traceback" in err or "Exception ignored" in err:
        wrong["traceback"] = err
    shows_file = row.words[:1] == ("info",)  # what it says, without a result; `check` judges it
    if code == 0 and not shows_file and _NAN.search(out) and not _NAN_WORDS.search(err):
        wrong["nan"] = out
    if row.told and not re.search(row.told, err):
        wrong["other"] = f"not told: {err}"
    if out and not row.output:
        wrong["other"] = f"on standard output: {out}"
    if code not in (0, 4) and len(lines) > 1:
        wrong["other"] = f"more than a sentence: {err}"
    return wrong


def _here(words: list[str]) -> int | str:
    def late(*_):
        raise _Late

    usual = signal.signal(signal.SIGALRM, late)
    signal.alarm(LIMIT)
    try:
        return main(words)
    except SystemExit as end:  # of argparse
        return end.code if isinstance(end.code, int) else 1
    except _Late:
        return "hang"
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, usual)


class _Late(BaseException):
    """A command takes too long."""


def _apart(words: list[str], shell: str) -> int | str:
    call = shlex.join([sys.executable, "-P", "-m", "cosim", *words])
    process = subprocess.Popen(["sh", "-c", f"exec {call} {shell}"])
    try:
        return process.wait(LIMIT)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        return "hang"
