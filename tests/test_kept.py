"""The page about accuracy kept: every kind is in its table, and what can be run soon agrees."""

import importlib.util
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def promises():
    spec = importlib.util.spec_from_file_location("promises", ROOT / "benchmarks" / "promises.py")
    found = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = found  # its named tuples look for it
    spec.loader.exec_module(found)
    return found


@pytest.fixture(scope="module")
def table():
    """Return the rows of the first block of the page, which several commands may have printed."""
    text = (ROOT / "benchmarks" / "results" / "kept.md").read_text(encoding="utf-8")
    lines = text.split("```console\n")[1].split("```")[0].splitlines()
    names, *rows = [line.split() for line in lines if not line.startswith("$")]
    return [dict(zip(names, row, strict=True)) for row in rows if row != names]


def test_every_kind_has_its_rows(promises, table):
    expected = [(kind, f"{a:g}") for kind in promises.KINDS for a in promises.ACCURACIES]
    assert sorted((row["kind"], f"{float(row['accuracy']):g}") for row in table) == sorted(expected)


def test_what_the_page_says_of_all_rows_is_so(table):
    runs = sum(int(row["systems"]) for row in table)

    def share(name):
        shares = (float(row[name].rstrip("%")) * int(row["systems"]) for row in table)
        return sum(shares) / runs

    assert share("kept") >= 99
    assert share("refused") < 3
    assert share("bound") >= 95
    assert max(float(row["worst"]) for row in table) <= 3
    assert max(float(row["below"]) for row in table) <= 10


@pytest.mark.slow_rows("relay")
@pytest.mark.parametrize(
    "kind", ["relay", "sampled", pytest.param("spring", marks=pytest.mark.slow)]
)
def test_a_run_is_within_the_worst_of_its_row(promises, table, kind):
    _, case = next(promises.cases(kind, 0, 1))
    worst = {float(row["accuracy"]): float(row["worst"]) for row in table if row["kind"] == kind}
    for accuracy in promises.ACCURACIES:
        run = case.run(accuracy)
        error = promises.true_error(case.course, run)
        assert error <= 1.05 * worst[accuracy] * accuracy  # two digits are printed
        assert error <= run.stats["error_estimate"] + promises.REFERENCES
