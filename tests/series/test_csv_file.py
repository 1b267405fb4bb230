"""Tables over time as CSV text, block by block."""

import io

import numpy as np
import pytest

from cosim.series import csv_file
from cosim.series.csv_file import repr_17, write_csv
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
    expected = ["time,a,b,c", *(",".join(map(repr_17, row)) for row in rows)]
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
