"""Tables over time as CSV text, block by block."""

import io

import numpy as np
import pytest

from cosim.errors import ParameterError, UnknownName, UsageError
from cosim.series import csv_file
from cosim.series.csv_file import shortest, write_csv
from cosim.series.samples import Column
from cosim.trajectory import Trajectory


def table(n):
    values = np.random.default_rng(1).normal(size=(n, 3)) * 10.0 ** np.arange(-200, 300, 200)
    values[: min(n, 4), 0] = [np.nan, np.inf, -np.inf, -0.0][: min(n, 4)]
    return np.arange(n) / 7, values


@pytest.mark.parametrize("n", [0, 1, 4, 5, 11])
def test_every_row_is_written_once_and_every_number_in_17_digits(n, monkeypatch):
    monkeypatch.setattr(csv_file, "_BLOCK", 5)
    time, values = table(n)
    stream = io.StringIO()
    write_csv(stream, [Column(name) for name in "abc"], time, values, "si")
    rows = np.column_stack((time, values)).tolist()
    expected = ["time,a,b,c", *(",".join(map(shortest, row)) for row in rows)]
    assert stream.getvalue().splitlines() == expected


def test_file_that_cannot_be_finished_leaves_the_old_one(tmp_path, monkeypatch):
    time, values = table(20)
    run = Trajectory("m", time, tuple(map(Column, "abc")), values)
    run.to_csv(tmp_path / "a.csv")
    before = (tmp_path / "a.csv").read_bytes()

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(np, "column_stack", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run.to_csv(tmp_path / "a.csv")
    assert (tmp_path / "a.csv").read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["a.csv"]


def test_line_of_units_may_hold_a_1(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("time,x,n\ns,mm,1\n0,1,2\n1,3,4\n")
    run = Trajectory.read_csv(path)
    np.testing.assert_allclose(run["x"], [1e-3, 3e-3])
    assert run["n"].tolist() == [2, 4]
    path.write_text("time,x\n1,\n2,1\n")  # a gap is no unit
    assert np.isnan(Trajectory.read_csv(path)["x"][0])


def read(tmp_path, text, **options):
    path = tmp_path / "run.csv"
    path.write_text(text)
    return Trajectory.read_csv(path, **options)


def test_indices_and_derivatives_are_names_and_no_units(tmp_path):
    run = read(tmp_path, "time,der(h),x[1],x[2],phi (roll) [deg]\n0,1,2,3,180\n1,1,2,3,180\n")
    assert run.names == ("der(h)", "x[1]", "x[2]", "phi (roll)")
    np.testing.assert_allclose(run.values[0], [1, 2, 3, np.pi])


@pytest.mark.parametrize("header", ["n [1000/min]", "F [10 N]", "c [N/((mm)/s)]"])
def test_units_with_numbers_or_brackets_are_rejected(tmp_path, header):
    with pytest.raises(UsageError, match="unknown; give units"):
        read(tmp_path, f"time,{header}\n0,1\n1,1\n")


def test_line_of_units_leaves_those_of_the_header_where_it_is_empty(tmp_path):
    run = read(tmp_path, "time [ms],phi\n,deg\n5,180\n6,180\n")
    np.testing.assert_allclose(run.time, [0.005, 0.006])
    np.testing.assert_allclose(run["phi"], np.pi)


def test_column_of_a_torque_is_not_the_time(tmp_path):
    run = read(tmp_path, "time_s,T,phi\n0,20,1\n1,21,2\n")
    assert run.names == ("T", "phi")
    assert read(tmp_path, "x,t\n5,0\n6,1\n").time.tolist() == [0, 1]


def test_units_of_no_column_and_other_units_than_in_the_header_are_rejected(tmp_path):
    text = "t,roll,yaw [rad]\n0,180,1\n1,180,1\n"
    assert read(tmp_path, text, units={"roll": "deg"})["roll"][0] == pytest.approx(np.pi)
    with pytest.raises(UnknownName, match="no column 'rol'; did you mean roll"):
        read(tmp_path, text, units={"rol": "deg"})
    with pytest.raises(UsageError, match="yaw is in 'rad' by its header; units= says 'deg'"):
        read(tmp_path, text, units={"yaw": "deg"})
    odd = "t,F [10 N]\n0,2\n1,2\n"
    assert read(tmp_path, odd, units={"F": "kN"})["F"][0] == 2000


def test_decimal_commas_are_read_where_semicolons_part_the_columns(tmp_path):
    path = tmp_path / "german.csv"
    path.write_text("Zeit [ms];x [m]\n-0,5;1,25\n1;-2,5e-1\n2,5;\n")
    run = Trajectory.read_csv(path, time_offset=1.0)
    np.testing.assert_allclose(run.time, [0.9995, 1.001, 1.0025])
    np.testing.assert_array_equal(run["x"], [1.25, -0.25, np.nan])


@pytest.mark.parametrize("first", ["sep=;", '"sep=;"', "SEP=; "])
def test_a_first_line_may_declare_the_separator(tmp_path, first):
    run = read(tmp_path, f"{first}\ntime;x [m]\n0,5;1,25\n1;2\n")
    np.testing.assert_array_equal(run["x"], [1.25, 2])
    assert read(tmp_path, "sep=|\ntime|x;y\n0|1\n1|2\n")["x;y"].tolist() == [1, 2]
    with pytest.raises(UsageError, match="is empty"):
        read(tmp_path, f"{first}\n")


def test_commas_beside_decimal_points_are_rejected(tmp_path):
    path = tmp_path / "mixed.csv"
    path.write_text("time;x\n0;1,234\n1.5;2\n")
    with pytest.raises(ParameterError, match="'1,234' is not a number"):
        Trajectory.read_csv(path)


def test_digits_are_the_fewest_that_read_back():
    stream = io.StringIO()
    values = np.array([[0.1 + 0.2, 2.0, -0.0], [5e-324, 1e22, 1 / 3]])
    write_csv(stream, [Column(name, "1") for name in "abc"], np.array([0.03, 0.04]), values, "si")
    lines = ["0.03,0.30000000000000004,2,-0", "0.04,5e-324,1e+22,0.3333333333333333"]
    assert stream.getvalue().splitlines()[1:] == lines
