"""Files that we export, one of each formulation: nothing wrong, read and run."""

import pytest

import casadi_models
from cosim.fmi.check.apart import try_apart
from cosim.fmi.check.finding import ADVICE, WRONG
from cosim.fmi.check.findings import examine


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "fmi"), [(name, 2 + i % 2) for i, name in enumerate(casadi_models.CATALOG)]
)
def test_own_file_has_nothing_wrong(name, fmi, exported):
    # glibc is as new as the compiler here has it, where its functions have newer versions
    assert {(f.level, f.rule) for f in examine(exported(name, fmi))} <= {(ADVICE, "glibc")}
    results = try_apart(exported(name, fmi), timeout=60.0)
    assert [f for f in results.findings if f.level == WRONG] == []
    # what is listed and has no influence: loads whose terms cancel
    assert {f.rule for f in results.findings} <= {"dependencies"}
    assert not [reason for reason in results.skipped if "time is up" in reason]
