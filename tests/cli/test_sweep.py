"""`cosim sweep`: its table, its messages and its exit codes."""

import csv
import io
import json

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


@pytest.mark.parametrize(("strict", "expected"), [([], 0), (["--strict"], 1)])
def test_a_failed_run_is_a_row_and_an_error_if_requested(strict, expected, capsys, tmp_path):
    table = tmp_path / "samples.csv"
    table.write_text("omega,diameter\n1,0.01\n2,-1\n")
    code = main(
        ["sweep", "crank_shaft", "--samples", str(table), "-p", "alpha=0", "--times", "1",
         "--outputs", "phi", "--workers", "0", *strict]
    )  # fmt: skip
    printed = capsys.readouterr()
    rows = rows_of(printed.out)
    assert code == expected
    assert [row["status"] for row in rows] == ["complete", "refused"]
    assert float(rows[0]["phi_final"]) == pytest.approx(1)
    assert "diameter = -1 m is out of its range" in rows[1]["reason"]
    assert "2 runs: 1 complete, 1 refused" in printed.err


def test_numbers_of_a_failed_run_are_null_in_json(capsys):
    """JSON has no NaN, and other programs do not read it."""
    words = ["-p", "diameter=0.01,-1", "--times", "1", "--outputs", "phi", "--workers", "0"]
    assert main(["sweep", "crank_shaft", *words, "--json"]) == 0
    rows = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert [row["phi_final"] for row in rows] == [pytest.approx(55.0, rel=1e-6), None]


@pytest.mark.slow
def test_a_stored_sweep_resumes_without_its_samples(capsys, tmp_path):
    pytest.importorskip("zarr")
    words = ["sweep", "crank_shaft", "--outputs", "phi", "--times", "1", "--workers", "0",
             "--store", str(tmp_path / "runs.zarr")]  # fmt: skip
    assert main([*words, "--design", "random:4", "-p", "omega=1:2"]) == 0
    assert capsys.readouterr().out == ""
    assert main([*words, "--resume", "-o", str(tmp_path / "runs.csv")]) == 0
    assert len(rows_of((tmp_path / "runs.csv").read_text())) == 4


@pytest.mark.slow_rows("words5-2-give 10000000 or less")
@pytest.mark.parametrize(
    ("words", "code", "expected"),
    [
        ([], 2, "nothing varies"),
        (["-p", "omegaa=1,2"], 3, "omega"),
        (["-p", "omega=1:2"], 2, "ranges are for --design"),
        (["-p", "omega=1:2:1"], 2, "N of 2 or more"),
        (["-p", "omega=1:2:99999999999"], 2, "N = 99999999999; give 10000000 or less"),
        (["-p", "omega=1:2:9999999", "-p", "alpha=1:2:9999999"], 2, "give 10000000 or less"),
        (["-p", "omega=1:2:²"], 2, "N of 2 or more"),
        (["-p", "omega"], 2, "write NAME="),
        (["-p", "omega=1 m"], 2, "omega"),
        (["--design", "sobol"], 2, "KIND:N"),
        (["--design", "sobbol:4", "-p", "omega=1:2"], 3, "sobol"),
        (["--design", "random:4", "-p", "omega=normal(1,0)"], 2, "not positive"),
        (["-p", "omega=1,2", "--keep", "maxx"], 3, "max"),
        (["-p", "omega=1,2", "--times", "1,x"], 2, "not a number"),
        (["--samples", "missing.csv"], 2, "cannot read"),
        (["--samples", "a.csv", "--design", "lhs:4"], 2, "not both"),
    ],
)
def test_wrong_options_exit_with_their_code_and_one_line(capsys, words, code, expected):
    assert main(["sweep", "crank_shaft", *words]) == code
    assert expected in capsys.readouterr().err


@pytest.mark.parametrize("count", ["1", "0", "²", "x", "1000000000", "9" * 5000])
def test_count_of_values_along_which_to_linearize_is_checked(capsys, count):
    assert main(["linearize", "crank_shaft", "--along", f"alpha=1:2:{count}"]) == 2
    assert "N" in capsys.readouterr().err  # before: a minute's silence, or Python's own error


def test_deviation_of_a_temperature_has_no_offset(capsys, tmp_path):
    path = tmp_path / "own.py"
    path.write_text(
        "import cosim\n"
        "def room():\n"
        "    model = cosim.Model('room', stop_time=1.0)\n"
        "    x = model.state('x', 'K', 290.0, 'of the room')\n"
        "    model.derivative(x, model.parameter('outside', 'K', 280.0, 'of the air') - x)\n"
        "    return model.freeze()\n"
    )
    code = main(
        ["sweep", f"{path}:room", "-p", "outside=normal(20degC, 0.01degC)", "--design",
         "random:8", "--keep", "final", "--workers", "0", "-q"]
    )  # fmt: skip
    outside = [float(row["outside"]) for row in rows_of(capsys.readouterr().out)]
    assert code == 0
    assert outside == pytest.approx([293.15] * 8, abs=0.1)
    assert len(set(outside)) == 8
