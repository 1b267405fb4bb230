"""`cosim sweep`: what the command line says, and with which code it ends."""

import csv
import io

import pytest

from cosim.cli.main import main


def rows_of(text):
    return list(csv.DictReader(io.StringIO(text)))


def test_a_grid_is_a_table_of_runs(capsys):
    code = main(
        ["sweep", "crank_shaft", "-p", "phi=0:90deg:2", "-p", "omega=1,2", "--outputs", "phi",
         "--times", "0.1,1", "--keep", "final", "max(phi)", "--workers", "0", "-q"]
    )  # fmt: skip
    rows = rows_of(capsys.readouterr().out)
    assert code == 0
    assert [(float(row["phi"]), float(row["omega"])) for row in rows] == [
        (0, 1), (0, 2), (pytest.approx(1.5707963), 1), (pytest.approx(1.5707963), 2)
    ]  # fmt: skip
    assert [float(row["phi_final"]) for row in rows] == pytest.approx([6, 7, 7.5707963, 8.5707963])
    assert [row["status"] for row in rows] == ["complete"] * 4


def test_a_failed_run_is_a_row_and_code_1(capsys, tmp_path):
    table = tmp_path / "samples.csv"
    table.write_text("omega,diameter\n1,0.01\n2,-1\n")
    code = main(
        ["sweep", "crank_shaft", "--samples", str(table), "-p", "alpha=0", "--times", "1",
         "--outputs", "phi", "--workers", "0"]
    )  # fmt: skip
    told = capsys.readouterr()
    rows = rows_of(told.out)
    assert code == 1
    assert [row["status"] for row in rows] == ["complete", "refused"]
    assert float(rows[0]["phi_final"]) == pytest.approx(1)
    assert "diameter = -1 m is out of its range" in rows[1]["reason"]
    assert "2 runs: 1 complete, 1 refused" in told.err


@pytest.mark.parametrize(
    ("words", "code", "told"),
    [
        ([], 2, "nothing varies"),
        (["-p", "omegaa=1,2"], 3, "omega"),
        (["-p", "omega=1:2"], 2, "ranges are for --sample"),
        (["-p", "omega=1:2:1"], 2, "N of 2 or more"),
        (["-p", "omega"], 2, "write NAME="),
        (["-p", "omega=1 m"], 2, "omega"),
        (["--sample", "sobol"], 2, "KIND:N"),
        (["--sample", "sobbol:4", "-p", "omega=1:2"], 3, "sobol"),
        (["--sample", "random:4", "-p", "omega=normal(1,0)"], 2, "not positive"),
        (["-p", "omega=1,2", "--keep", "maxx"], 3, "max"),
        (["-p", "omega=1,2", "--times", "1,x"], 2, "not a number"),
        (["--samples", "missing.csv"], 2, "cannot read"),
        (["--samples", "a.csv", "--sample", "lhs:4"], 2, "not both"),
    ],
)
def test_what_is_wrong_ends_with_its_code_and_a_line(capsys, words, code, told):
    assert main(["sweep", "crank_shaft", *words]) == code
    assert told in capsys.readouterr().err
