"""Mutated SSP files end in one sentence, soon, without names of inner exceptions."""

import re
import signal
import time

import pytest
from helpers.mutated_ssp import base, mutated, packed
from helpers.nightly import SEED

from cosim import errors
from cosim.cli.main import main
from cosim.coupling.files import read_system

QUICK, PART, PARTS = 25, 100, 20
LONGEST = 5.0  # s
OWN = {name for name in vars(errors) if isinstance(vars(errors)[name], type)}
INNER = re.compile(r"\b[A-Z]\w*(?:Error|Exception|Warning)\b|Traceback|object at 0x|<class ")

pytestmark = pytest.mark.skipif(not hasattr(signal, "SIGALRM"), reason="no alarms")


class _Late(BaseException):
    """A command takes too long."""


def faults_of(content, path, capsys):
    """Return what is wrong with the way in which `cosim info` ends."""
    path.write_bytes(content)

    def late(*_):
        raise _Late

    usual = signal.signal(signal.SIGALRM, late)
    signal.setitimer(signal.ITIMER_REAL, LONGEST)
    began = time.perf_counter()
    try:
        code = main(["info", str(path)])
    except _Late:
        return f"not done after {LONGEST} s"
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, usual)
    out, err = capsys.readouterr()
    lines = [line for line in err.splitlines() if line]
    inner = [word for word in INNER.findall(err) if word not in OWN]
    places = [word for word in re.findall(r"/\S+", err) if "/cosim" in word.replace(str(path), "")]
    if code not in (0, 1, 2, 3):
        return f"exit code {code}: {err}"
    if code and (len(lines) != 1 or out):
        return f"no single sentence: {out}{err}"
    if code and str(path) not in err:
        return f"the file is not named: {err}"
    if inner or places:
        return f"inner names: {err}"
    return "" if time.perf_counter() - began < LONGEST else "slow"


def found_faults(seed, number, tmp_path, capsys):
    path = tmp_path / "mutated.ssp"
    found = (faults_of(content, path, capsys) for content in mutated(seed, number))
    return {n: fault for n, fault in enumerate(found) if fault}


def test_file_without_mutation_is_read(tmp_path):
    (tmp_path / "right.ssp").write_bytes(packed(base()))
    system = read_system(tmp_path / "right.ssp")
    assert list(system.parts) == ["g", "h", "q_g", "q_h", "p_g", "p_h", "p_q_g", "p_q_h"]
    assert system.start_values["g", "k"] == 7  # 2 3 + 1, by the mapping
    assert system.start_values["h", "k"] == 1  # by the file, after the part's own value 2


@pytest.mark.slow
def test_mutated_file_ends_in_one_sentence(tmp_path, capsys):
    assert found_faults(0, QUICK, tmp_path, capsys) == {}


@pytest.mark.nightly
@pytest.mark.parametrize("part", range(1, PARTS + 1))
def test_many_mutated_files_end_in_one_sentence(part, tmp_path, capsys):
    assert found_faults(PARTS * SEED + part, PART, tmp_path, capsys) == {}
