"""Values of FMU variables by their type."""

from types import SimpleNamespace

import pytest
from helpers.typed_part import typed_part

from cosim.cli.main import main
from cosim.coupling.files import read_system
from cosim.coupling.part import part_of
from cosim.errors import FmuError, ParameterError
from cosim.fmi.run.typed_values import reject_beyond_bounds, series_value, typed_value

MODES = SimpleNamespace(
    items=[SimpleNamespace(name="slow", value="1"), SimpleNamespace(name="fast", value="3")]
)


def value_of(kind, value):
    return typed_value("m", SimpleNamespace(name="u", type=kind, declaredType=MODES), value)


@pytest.mark.parametrize(
    ("kind", "value", "expected"),
    [
        ("Integer", 3.0, 3),
        ("Int32", -(2**31), -(2**31)),
        ("UInt8", 255.0, 255),
        ("UInt64", 2**64 - 1, 2**64 - 1),
        ("Int64", 2**53 + 1, 2**53 + 1),
        ("Boolean", "true", True),
        ("Boolean", 0.0, False),
        ("Boolean", 1, True),
        ("Boolean", False, False),
        ("Enumeration", "fast", 3),
        ("Enumeration", 1.0, 1),
        ("Float32", 0.1, 0.1),
        ("Real", 3, 3.0),
    ],
)
def test_value_that_the_type_has_is_kept(kind, value, expected):
    found = value_of(kind, value)
    assert found == expected
    assert type(found) is type(expected)


@pytest.mark.parametrize(
    ("kind", "value", "reason"),
    [
        ("Integer", 3.7, "no Integer; give a whole number from -2147483648 to 2147483647"),
        ("Int32", 3e9, "no Int32; give a whole number"),
        ("UInt8", 256, "no UInt8; give a whole number from 0 to 255"),
        ("UInt16", -1, "no UInt16"),
        ("Boolean", 2, "no Boolean; give true or false"),
        ("Boolean", "yes", "no Boolean"),
        ("Enumeration", 2, r"give one of slow \(1\), fast \(3\)"),
        ("Enumeration", "medium", r"give one of slow \(1\)"),
        ("Float32", 1e39, "too large for a Float32"),
        ("Real", float("nan"), "not finite"),
    ],
)
def test_value_that_the_type_does_not_have_is_rejected_with_the_type(kind, value, reason):
    with pytest.raises(ParameterError, match=f"m: u = .*{reason}"):
        value_of(kind, value)


@pytest.mark.parametrize("kind", ["Real", "Float32", "Integer", "UInt64"])
def test_word_for_a_number_is_rejected_with_the_remedy(kind):
    with pytest.raises(ParameterError, match="u = 'fast' is not a real number; give a number"):
        value_of(kind, "fast")


@pytest.mark.parametrize("value", [1, 10, 1.0, 1e9])
@pytest.mark.parametrize("of_type", [False, True])
def test_value_beyond_the_bounds_of_the_file_is_rejected(value, of_type):
    bounds = SimpleNamespace(min="2", max="9")
    facts = {"declaredType": bounds} if of_type else vars(bounds)
    variable = SimpleNamespace(name="u", type="Int32", **facts)
    with pytest.raises(FmuError, match=r"u = .* is out of its range 2 \.\.\. 9"):
        reject_beyond_bounds(variable, value)
    reject_beyond_bounds(variable, 9.0)


def test_value_is_bounded_on_one_side_where_the_file_has_one_bound():
    variable = SimpleNamespace(name="u", type="Real", declaredType=None, min="-1.5", max=None)
    reject_beyond_bounds(variable, 1e300)
    with pytest.raises(FmuError, match=r"u = -2 is out of its range -1\.5 \.\.\. inf"):
        reject_beyond_bounds(variable, -2.0)


@pytest.fixture
def subjects(tmp_path, monkeypatch):
    """Return the file of every type alone and as a part, and what names of inputs begin with."""
    monkeypatch.chdir(tmp_path)
    path = typed_part(tmp_path)
    (tmp_path / "two.toml").write_text(f"[parts]\na = '{path.name}'\n")
    return (path.name, ""), ("two.toml", "a.")


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize(
    ("name", "cell", "reason"),
    [("on_in", "yes", "on_in = yes is no Boolean; give true or false"),
     ("count_in", "3.7", "count_in = 3.7 is no Int32; give a whole number"),
     ("mode_in", "2", r"mode_in = 2.0 is no item of it; give one of slow (1), fast (3)"),
     ("label_in", "above", "label_in is of type String, which follows no time series"),
     ("label_in", "1", "label_in is of type String, which follows no time series")],
)  # fmt: skip
def test_column_with_what_the_type_of_an_input_does_not_have_is_rejected(
    name, cell, reason, subjects, tmp_path, capsys
):
    for model, prefix in subjects:
        (tmp_path / "in.csv").write_text(f"time,{prefix}{name}\n0,{cell}\n1,{cell}\n")
        assert main(["simulate", model, "--trust", "--input-file", "in.csv"]) == 2
        (line,) = capsys.readouterr().err.splitlines()[-1:]
        assert reason in line


def test_columns_of_every_type_keep_a_sample_until_the_next_one(subjects, tmp_path, capsys):
    for model, a in subjects:
        head = ",".join(["time", *(f"{a}{name}_in" for name in ("on", "count", "mode"))])
        rows = "0,false,-2,slow\n0.35,TRUE,7,fast\n0.7,0,7,1\n"
        (tmp_path / "in.csv").write_text(f"{head}\n{rows}")
        outputs = ",".join(f"{a}{name}" for name in ("on", "count", "mode"))
        arguments = ["--input-file", "in.csv", "--output-interval", "0.175", "--stop-time", "0.7"]
        assert main(["simulate", model, "--trust", "--outputs", outputs, *arguments]) == 0
        found = [line.split(",")[1:] for line in capsys.readouterr().out.split()[1:]]
        first, second, last = ["0", "-2", "1"], ["1", "7", "3"], ["0", "7", "1"]
        assert found == [first, first, second, second, last]


def test_words_in_a_column_read_a_file_once(subjects, tmp_path, monkeypatch):
    read = []
    for name, function in (("part_of", part_of), ("read_system", read_system)):
        counted = lambda *values, own=function: read.append(own) or own(*values)  # noqa: E731
        monkeypatch.setattr(f"cosim.cli.runs.{name}", counted)
    for model, a in subjects:
        counts = []
        for rows in (2, 20):
            lines = [f"time,{a}on_in", *(f"{i},true" for i in range(rows))]
            (tmp_path / "in.csv").write_text("\n".join(lines))
            read.clear()
            assert main(["simulate", model, "--trust", "--input-file", "in.csv"]) == 0
            counts.append(len(read))
        assert counts[0] == counts[1]  # before: 18 more


def test_integer_that_a_series_cannot_hold_is_rejected():
    variable = SimpleNamespace(name="u", type="UInt64", declaredType=None)
    assert series_value("m", variable, 2**53 - 1) == 2.0**53 - 1
    with pytest.raises(ParameterError, match="time series hold integers below 2"):
        series_value("m", variable, 2.0**53)
