"""Inputs of absurd size, depth or power: a sentence of ours, no inner exception."""

import casadi as ca
import pytest

from cosim.cli.main import main
from cosim.codegen.compiler import compile_library
from cosim.errors import ExportError, MissingTool, ParameterError, UsageError
from cosim.files import write_atomically
from cosim.model.catalogue import load
from cosim.model.formula import condition, expression
from cosim.model.quantities import parse_unit, quantity
from cosim.series.csv_file import rows_of
from cosim.toml_file import read_toml

T = ca.SX.sym("t")


@pytest.mark.parametrize(
    "unit",
    ["km^999", "km^-999", "m^100", "m^" + "9" * 5000, "km^99*km^99", "1/km^99/km^99", "m999"],
)
def test_powers_that_measure_nothing_are_no_units(unit):
    assert parse_unit(unit) is None
    with pytest.raises(ParameterError, match=r"is unknown|cannot be converted"):
        quantity("mass", f"1{unit}", "kg")


def test_large_powers_of_units_are_units():
    assert parse_unit("km^99").factor == pytest.approx(1e297, rel=1e-13)  # measured 4e-15
    assert parse_unit("km^99").base == (("m", 99),)


@pytest.mark.parametrize(("text", "value"), [("+", 1100.0), ("-", -1098.0), ("*", 1.0)])
def test_a_formula_may_have_any_number_of_terms(text, value):
    assert float(expression("x", text.join(["1"] * 1100), {})) == value
    assert float(condition("x", f"{text.join(['1'] * 1100)} > {value - 1}", {})) == 1


DEEP = [
    "-" * 1100 + "t",
    "**".join(["t"] * 1100),
    "-(" * 80 + "t" + ")" * 80 + "+" + "-" * 990 + "t",
    "not " * 1100 + "t > 1",
    "+".join(["1"] * 100_000),
    "(" * 1100 + "t" + ")" * 1100,
]


@pytest.mark.parametrize("text", DEEP, ids=lambda text: text[:4])
@pytest.mark.parametrize("read", [expression, condition])
def test_a_formula_that_is_nested_too_deeply_is_rejected(read, text):
    with pytest.raises(ParameterError, match=r"^x: .*(nested too deeply|is no|not understood)"):
        read("x", text, {"t": T})


def test_a_cell_of_a_table_that_is_too_long_is_named(tmp_path):
    table = tmp_path / "long.csv"
    table.write_text(f"time,x\n0,1\n1,{'1' * 140_000}\n")
    with pytest.raises(UsageError, match=r"long.csv, line 3 has a cell of more than 131072 char"):
        rows_of(table)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("x = " + "1" * 5000, "a number has too many digits"),
        ("x = " + "[" * 5000 + "]" * 5000, "brackets are nested too deeply"),
        ("x = " + "{a=" * 5000 + "1" + "}" * 5000, "brackets are nested too deeply"),
    ],
)
def test_a_toml_file_beyond_what_python_reads_is_rejected(text, expected, tmp_path):
    (tmp_path / "a.toml").write_text(text)
    with pytest.raises(UsageError, match=rf"a.toml: {expected}"):
        read_toml(tmp_path / "a.toml")


def test_a_compiler_that_writes_no_library_is_named(tmp_path):
    compiler = tmp_path / "compiler"
    compiler.write_text('#!/bin/sh\nfor last; do [ "$before" = -o ] && echo text >"$last"; '
                        'before=$last; done\nexit 0\n')  # fmt: skip
    compiler.chmod(0o755)
    with pytest.raises(MissingTool, match="wrote something else than a shared library"):
        compile_library([], tmp_path / "code.so", command=[str(compiler)])


def test_an_exception_whose_text_fails_is_named(tmp_path):
    text = "class Odd(Exception):\n    def __str__(self): return 1 / 0\ndef build(): raise Odd\n"
    (tmp_path / "own.py").write_text(text)
    with pytest.raises(UsageError, match=r"own.py:build failed \(line \d+\): Odd$"):
        load(f"{tmp_path}/own.py:build")


def test_a_dangling_link_is_named_with_what_is_missing(tmp_path):
    (tmp_path / "link").symlink_to("missing/file")
    with pytest.raises(ExportError, match=r"it is a link to .*file: create .*missing first"):
        write_atomically(tmp_path / "link", b"")


BROKEN = '"$\\\\frac{a$"'


@pytest.mark.parametrize("ending", ["png", "svg", "pdf"])
@pytest.mark.parametrize(
    "figure",
    [
        f"title = {BROKEN}",
        f'title = "a"\nlabels = [{BROKEN}]',
        f'title = "a"\nlegends = [[{BROKEN}]]',  # of one curve: it is not drawn
        f'title = "a"\nx_label = {BROKEN}',
    ],
    ids=["title", "label", "legend", "x_label"],
)
def test_a_broken_formula_in_a_text_is_quoted(figure, ending, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.toml").write_text(
        'model = "crank_shaft"\n[run]\nstop_time = 0.1\n'
        f'[[figures]]\n{figure}\npanels = [["phi"]]\n'
    )
    assert main(["plot", "a.toml", "-o", f"x.{ending}"]) == UsageError.exit_code
    printed = capsys.readouterr().err
    assert "a text of the figure has the formula '\\frac{a" in printed
    assert not (tmp_path / f"x.{ending}").exists()


@pytest.mark.parametrize(
    "words",
    [
        ["info", "{}.toml"],
        ["check", "{}.fmu"],
        ["simulate", "{}.py:build"],
        ["crosscheck", "{}.toml"],
        ["new", "{}.py"],
        ["sweep", "crank_shaft", "-p", "alpha=1,2", "--stop-time", "0.1", "--store", "{}"],
    ],
    ids=lambda words: words[0],
)
def test_a_name_that_no_file_can_have_is_named(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    long = "x" * 300
    assert main([word.format(long) for word in words]) in (1, 3)
    (line,) = capsys.readouterr().err.splitlines()
    assert "xxx ... xxx" in line
    assert "Errno" not in line
    assert list(tmp_path.iterdir()) == []
