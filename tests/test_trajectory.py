"""What every run returns: access by name, immutability, files that read back bit for bit."""

import csv
import io
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import cosim
from cosim.errors import CosimError, ExportError, ParameterError, UnknownName, UsageError
from cosim.text import Violation
from cosim.trajectory import Column, Event, Trajectory

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
    assert run != replace(run)  # its equal, but another one


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


def test_npz_has_numbers_of_numpy_among_its_statistics(tmp_path, run):
    own = {"steps": np.int64(3), "share": np.float32(0.5), "compiled": np.bool_(True)}
    replace(run, stats=own).to_npz(tmp_path / "run.npz")
    assert Trajectory.from_npz(tmp_path / "run.npz").stats == own


@pytest.mark.parametrize("content", [b"", b"PK", b"no zip at all"])
def test_what_is_no_npz_is_refused(tmp_path, content):
    path = tmp_path / "run.npz"
    path.write_bytes(content)
    with pytest.raises(UsageError, match="contains no trajectory"):
        Trajectory.from_npz(path)


def test_npz_of_another_shape_or_a_later_format_is_refused(tmp_path, run):
    path = tmp_path / "run.npz"
    run.to_npz(path)
    whole = path.read_bytes()
    with np.load(path) as stored:
        arrays = dict(stored)
    place = whole.index(b"PK\x01\x02") + 6  # the version that an entry needs
    np.savez(tmp_path / "none.npz", **{**arrays, "facts": np.array("null")})
    none = (tmp_path / "none.npz").read_bytes()
    for content in (none, whole[:place] + bytes([82]) + whole[place + 1 :]):
        with pytest.raises(UsageError, match="contains no trajectory"):
            Trajectory.from_npz(io.BytesIO(content))


# -- as people who know pandas expect it ----------------------------------------------------------


def test_names_are_what_is_contained_and_iterated(run):
    assert "x" in run
    assert "time" in run
    assert "z" not in run
    assert [*run] == ["x", "y"]
    assert {*dict(run)} == {"x", "y"}
    assert run._ipython_key_completions_() == ["time", "x", "y"]


def test_list_of_names_is_a_run_of_these(run):
    assert run[["y"]].names == ("y",)
    assert run[["y", "x"]].names == ("y", "x")
    assert run.select("y").names == ("y",)
    assert len(run.plot("x").axes) == 1


@pytest.fixture
def sine():
    time = np.linspace(0, 1, 51)
    columns = (Column("a", "rad", "deg", 0.1, "angle"), Column("f", "N", "lbf"))
    return Trajectory("m", time, columns, np.c_[np.sin(6 * time), 2 * time], {"solver": "erk"})


def test_other_times_are_interpolated_where_nothing_can_compute_them(sine):
    found = sine.at([0.013, 0.5, 0.777])
    bound = 0.12**6 / 720 * 17  # of 6 points, a point and a half from the middle; measured 0.16
    np.testing.assert_allclose(found["a"], np.sin(6 * found.time), rtol=0, atol=bound)
    assert sine.at(0.25)["f"] == pytest.approx(0.5, rel=1e-14)
    assert sine.final == {"a": np.sin(6.0), "f": 2.0}


def test_other_times_are_computed_where_something_can(sine):
    asked = []

    def again(times):
        asked.append(times)
        return Trajectory("m", times, sine.columns, np.zeros((len(times), 2)))

    run = replace(sine, again=again)
    assert run.select("f").at([0.1, 0.2]).names == ("f",)
    np.testing.assert_array_equal(asked, [[0.1, 0.2]])
    assert pickle.loads(pickle.dumps(sine)).again is None


@pytest.mark.parametrize(
    ("times", "told"),
    [
        (2, "time 2.0 is not within the run, 0 ... 1 s"),
        ([0.1, -1], "time -1.0 is not within"),
        (np.nan, "time nan is not within"),
        ("soon", "give numbers"),
        ([0.2, 0.1], "times decrease"),
        ([[0.1]], "is not within"),
    ],
)
def test_times_that_cannot_be_are_refused(sine, times, told):
    with pytest.raises(ParameterError, match=told):
        sine.at(times)


def test_summary_is_in_display_units_and_knows_when(sine):
    angle, force = sine.summary()
    assert angle["unit"] == "deg"
    assert angle["max"] == pytest.approx(np.degrees(np.sin(6 * 0.26)))
    assert angle["max at [s]"] == 0.26
    assert force["end"] == pytest.approx(2 / 4.4482216152605, rel=1e-15)
    assert "min at [s]" in repr(sine.summary())


def test_run_says_in_few_lines_what_it_is(sine):
    many = tuple(Column(f"v{i}") for i in range(99))
    for run in (sine, Trajectory("m", np.zeros(2), many, np.zeros((2, 99)))):
        assert len(repr(run).splitlines()) <= 15
        assert '<img alt="curves" src="data:image/png;base64,' in run._repr_html_()
    assert repr(sine).startswith("m: 51 times from 0 to 1 s, 2 variables, erk, complete\n")
    empty = Trajectory("m", [], (), np.zeros((0, 0)))
    assert "no time" in repr(empty)
    assert "no time" in empty._repr_html_()
    assert "nan" in repr(Trajectory("m", [0], (Column("x"),), [[np.nan]]))


# -- files of others ------------------------------------------------------------------------------


def test_file_in_the_book_s_units_comes_back_in_si(sine, tmp_path):
    sine.to_csv(tmp_path / "a.csv", units="book")
    assert (tmp_path / "a.csv").read_text().splitlines()[1] == "s,deg,lbf"
    again = Trajectory.read_csv(tmp_path / "a.csv")
    np.testing.assert_allclose(again.values, sine.values, rtol=1e-15)
    assert again.units == sine.units
    assert again.column("a").display_unit == "deg"
    with pytest.raises(UnknownName, match="no kind of units 'SI'; did you mean si"):
        sine.to_csv(tmp_path / "a.csv", units="SI")


def test_own_file_comes_back_bit_for_bit_and_takes_what_a_run_knows(run, tmp_path):
    run.to_csv(tmp_path / "a.csv")
    again = Trajectory.read_csv(tmp_path / "a.csv", like=run, model="x")
    assert again.values.tobytes() == run.values.tobytes()
    assert again.columns == run.columns
    assert (again.model, Trajectory.read_csv(tmp_path / "a.csv").model) == ("x", "a")


@pytest.mark.parametrize(
    "text",
    [
        "time [ms];phi [deg]\n0;180\n1000;90\n",
        "# measured\n\nTime\tphi\ns\tdeg\n0\t180\n1\t90\n",
        '"phi (deg)","t"\n180,0\n90,1\n',
    ],
)
def test_files_of_other_tools_are_read(text, tmp_path):
    (tmp_path / "a.csv").write_text(text, encoding="utf-8-sig")
    run = Trajectory.read_csv(tmp_path / "a.csv")
    np.testing.assert_array_equal(run.time, [0, 1])
    np.testing.assert_allclose(run["phi"], [np.pi, np.pi / 2], rtol=1e-15)
    assert run.units["phi"] == "rad"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "is empty"),
        ("0,1\n1,2\n", "line 1: no header"),
        ("time,x\n", "no sample"),
        ("time,x\n0,1\n1,2,3\n", "line 3: 3 cells under 2 names"),
        ("time,x\n0,1\n1,one\n", "line 3, column 'x': 'one' is not a number"),
        ("time,x\n1,1\n0,1\n", "line 3: time decreases"),
        ("time,x [furlong]\n1,1\n", "'furlong', which is unknown"),
        ("time [deg],x\n1,1\n", "time is in 'deg'"),
        ("time,x\n0,1\n,1\n", "line 3: the time is missing"),
        ("time,x\n0,1\ninf,1\n", "line 3: the time is infinite"),
    ],
)
def test_files_that_make_no_sense_are_refused_with_the_line(text, told, tmp_path):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(UsageError, match=told):
        Trajectory.read_csv(tmp_path / "a.csv")


RIG = """no,t [ms],roll [deg],torque [kNm],roll [rad],remark
1,0,180,1,3,a
2,500,,2,3,b
,,,,,
4,750,nan,3,3,c
"""


def test_columns_of_a_measurement_get_names_units_and_gaps(tmp_path):
    (tmp_path / "rig.csv").write_text(RIG)
    columns = {"phi": "roll [deg]", "T": "torque"}
    rig = Trajectory.read_csv(tmp_path / "rig.csv", columns=columns, time="t [ms]")
    np.testing.assert_array_equal(rig.time, [0, 0.5, 0.75])
    np.testing.assert_allclose(rig["phi"], [np.pi, np.nan, np.nan])
    np.testing.assert_allclose(rig["T"], [1000, 2000, 3000])
    assert rig.units == {"time": "s", "phi": "rad", "T": "N.m"}
    assert rig.stats == {"file": "rig.csv", "gaps": 2}
    rig.to_csv(tmp_path / "again.csv")
    np.testing.assert_array_equal(Trajectory.read_csv(tmp_path / "again.csv").values, rig.values)


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (
            {"columns": {"phi": "rol [deg]"}},
            r"has no column 'rol \[deg\]'; did you mean roll \[deg\]",
        ),
        ({"columns": {"phi": "roll"}}, "2 columns are called 'roll'"),
        ({"columns": {"phi": "remark"}}, "line 2, column 'remark': 'a' is not a number"),
        ({"columns": ["phi"]}, r"columns was given \['phi'\]"),
        ({"columns": {}, "time": "clock"}, "has no column 'clock'"),
        ({"columns": {}, "time": "torque"}, "time is in 'kNm'"),
        ({"columns": {"time": "no"}, "time": "t [ms]"}, "'time' is recorded twice"),
    ],
)
def test_columns_that_a_file_does_not_have_are_rejected(options, reason, tmp_path):
    (tmp_path / "rig.csv").write_text(RIG)
    with pytest.raises(CosimError, match=reason):
        Trajectory.read_csv(tmp_path / "rig.csv", **options)


@pytest.mark.parametrize(
    ("unit", "si", "factor"),
    [("kN", "N", 1e3), ("kPa", "kg.m-1.s-2", 1e3), ("m/s\u00b2", "m/s2", 1)],
)
def test_header_may_have_any_unit_that_values_may_have(unit, si, factor, tmp_path):
    (tmp_path / "a.csv").write_text(f"time,x [{unit}]\n0,1\n1,2\n", encoding="utf-8")
    run = Trajectory.read_csv(tmp_path / "a.csv")
    np.testing.assert_allclose(run["x"], [factor, 2 * factor])
    assert run.units["x"] == si


def test_a_bracket_that_is_not_closed_begins_a_unit_all_the_same(tmp_path):
    (tmp_path / "a.csv").write_text("time,phi [deg\n0,1\n1,180\n", encoding="utf-8")
    run = Trajectory.read_csv(tmp_path / "a.csv")
    assert run.final["phi"] == pytest.approx(np.pi)


def test_run_that_is_computed_again_accepts_a_time_twice():
    run = cosim.simulate("crank_shaft", stop_time=0.1, compiled=False)
    found = run.at([0.0, 0.1, 0.1])
    np.testing.assert_array_equal(found.time, [0.0, 0.1, 0.1])
    np.testing.assert_array_equal(found.values[1], found.values[2])


def test_times_outside_a_tiny_span_are_rejected():
    short = Trajectory("m", [0, 1e-9], [Column("x")], [[0], [1]])
    with pytest.raises(ParameterError, match="time 2e-09 is not within the run"):
        short.at(2e-9)
    assert short.at(5e-10) == {"x": 0.5}


def test_a_part_of_a_run_has_no_event_of_another_part():
    event = Event(5.0, "hit", {"x": 100.0}, {"x": 200.0})
    whole = Trajectory("m", range(11), [Column("x")], [[n] for n in range(11)], events=(event,))
    (row,) = whole.at([1, 3]).summary()
    assert (row["start"], row["end"], row["min"], row["max"]) == (1, 3, 1, 3)
    assert whole.at([4, 6]).events == whole.at([5, 6]).events == (event,)


def test_npz_brings_back_what_is_wrong_without_its_time():
    found = [Violation(1.5, "it lifts off"), "a plain reason", Violation(0.5, "slow", "it is slow")]
    run = Trajectory("m", [0, 2], [Column("x")], [[0], [1]], {"invalid": found})
    file = io.BytesIO()
    run.to_npz(file)
    again = Trajectory.from_npz(io.BytesIO(file.getvalue()))
    assert again.validity == run.validity == (0.0, ("it lifts off", "a plain reason", "slow"))
    assert again.stats == run.stats
