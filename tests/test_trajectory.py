"""What every run returns: access by name, immutability, files that read back bit for bit."""

import csv
import io
from pathlib import Path

import numpy as np
import pytest

from cosim.errors import ExportError, UnknownName, UsageError
from cosim.trajectory import Column, Trajectory

# Numbers whose shortest text needs all 17 digits, and the ends of the range
HARD = [0.1 + 0.2, 1 / 3, np.nextafter(1, 2), 5e-324, 1.7976931348623157e308, -0.0]


@pytest.fixture
def run():
    rng = np.random.default_rng(1)
    values = rng.normal(size=(6, 2)) * 10.0 ** rng.integers(-300, 300, (6, 2))
    values[:, 1] = HARD
    columns = (Column("x", "rad", "deg", 0.1, "angle"), Column("y", "N"))
    return Trajectory("m/f", np.linspace(0, 0.5, 6), columns, values, {"solver": "erk"})


def test_variables_and_time_are_found_by_name(run):
    assert run.names == ("x", "y")
    assert run.units == {"time": "s", "x": "rad", "y": "N"}
    assert run["time"] is run.time
    np.testing.assert_array_equal(run["y"], HARD)
    assert run.column("x").display_unit == "deg"
    assert len(run) == 6
    assert run.complete


def test_unknown_variable_is_refused_with_the_nearest_name(run):
    with pytest.raises(UnknownName, match="m/f: run has no variable 'xx'; did you mean x"):
        run["xx"]


def test_run_cannot_be_changed_and_leaves_the_caller_s_arrays_alone():
    time, values = np.zeros(2), np.zeros((2, 1))
    run = Trajectory("m", time, (Column("x"),), values)
    values[:] = 1  # still writable, and not the run's
    assert run["x"].tolist() == [0, 0]
    with pytest.raises(ValueError, match="read-only"):
        run["x"][0] = 1


def test_runs_compare_by_identity(run):
    assert run == run
    assert run != run.select(["x", "y"])


@pytest.mark.parametrize(
    ("time", "values"),
    [((3,), (2, 1)), ((2, 1), (2, 1)), ((2,), (2,)), ((2,), (2, 2))],
)
def test_shapes_that_do_not_fit_are_refused(time, values):
    with pytest.raises(UsageError, match=r"m: 1 variables, but time of shape .*give \(n,\)"):
        Trajectory("m", np.zeros(time), (Column("x"),), np.zeros(values))


def test_selection_keeps_the_order_asked_for(run):
    chosen = run.select(["y", "x"])
    assert chosen.names == ("y", "x")
    np.testing.assert_array_equal(chosen.values, run.values[:, ::-1])


@pytest.mark.parametrize("names", [["x", "x"], ["time"]])
def test_selection_refuses_what_is_there_already(run, names):
    with pytest.raises(UsageError if "x" in names else UnknownName):
        run.select(names)


def test_structured_array_has_time_first(run):
    table = run.structured
    assert table.dtype.names == ("time", "x", "y")
    np.testing.assert_array_equal(table["y"], HARD)
    np.testing.assert_array_equal(table["time"], run.time)


def test_csv_reads_back_bit_for_bit(run, tmp_path):
    run.to_csv(tmp_path / "a.csv")
    run.to_csv(str(tmp_path / "b.csv"))
    text = (tmp_path / "a.csv").read_text()
    assert text == (tmp_path / "b.csv").read_text()
    header, *rows = csv.reader(io.StringIO(text))
    assert header == ["time", "x", "y"]
    read = np.array(rows, dtype=float)
    assert read[:, 1:].tobytes() == run.values.tobytes()
    assert read[:, 0].tobytes() == run.time.tobytes()


def test_csv_goes_to_an_open_file_too(run):
    stream = io.StringIO()
    run.select(["x"]).to_csv(stream)
    assert stream.getvalue().startswith("time,x\n0,")
    assert stream.getvalue().count("\n") == 7


def test_csv_into_a_missing_folder_is_refused(run, tmp_path):
    with pytest.raises(ExportError, match="No such file or directory; create"):
        run.to_csv(tmp_path / "missing" / "a.csv")
    assert list(Path(tmp_path).iterdir()) == []


def test_pandas_frame_carries_time_units_and_status(run):
    pytest.importorskip("pandas", reason="an extra of the package")
    frame = run.to_pandas()
    assert frame.index.name == "time"
    assert list(frame.columns) == ["x", "y"]
    assert frame.attrs == {"model": "m/f", "units": run.units, "status": "complete"}
    assert frame["y"].tolist() == HARD


def test_xarray_dataset_carries_units_and_meaning(run):
    pytest.importorskip("xarray", reason="an extra of the package")
    data = run.to_xarray()
    assert data["x"].attrs == {"units": "rad", "long_name": "angle"}
    np.testing.assert_array_equal(data["time"], run.time)


def test_npz_brings_everything_back_bit_for_bit(tmp_path, run):
    path = tmp_path / "run.npz"
    run.to_npz(path)
    again = Trajectory.from_npz(path)
    assert (again.model, again.columns, again.status) == (run.model, run.columns, run.status)
    assert again.stats == dict(run.stats)
    assert again.time.tobytes() == run.time.tobytes()
    assert again.values.tobytes() == run.values.tobytes()


@pytest.mark.parametrize("content", [b"", b"PK", b"no zip at all"])
def test_what_is_no_npz_is_refused(tmp_path, content):
    path = tmp_path / "run.npz"
    path.write_bytes(content)
    with pytest.raises(UsageError, match="holds no trajectory"):
        Trajectory.from_npz(path)
