"""Values of FMU variables by their type."""

from types import SimpleNamespace

import pytest
from helpers.typed_part import typed_part

from cosim.cli.main import main
from cosim.errors import FmuError, ParameterError
from cosim.fmi.run.typed_values import reject_beyond_bounds, typed_value

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


@pytest.mark.parametrize(
    ("name", "cell", "kind"),
    [("on_in", "true", "Boolean"), ("count_in", "3.7", "Int32"), ("label_in", "above", "String"),
     ("mode_in", "fast", "Enumeration")],
)  # fmt: skip
def test_column_of_a_variable_that_is_no_real_number_is_rejected_by_its_type(
    name, cell, kind, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    path = typed_part(tmp_path)
    (tmp_path / "two.toml").write_text(f"[parts]\na = '{path.name}'\n")
    for model, column in ((path.name, name), ("two.toml", f"a.{name}")):
        (tmp_path / "in.csv").write_text(f"time,{column}\n0,{cell}\n1,{cell}\n")
        assert main(["simulate", model, "--trust", "--input-file", "in.csv"]) == 2
        assert f"{column} is of type {kind}; only real inputs follow" in capsys.readouterr().err
