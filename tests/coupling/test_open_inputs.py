"""Inputs that nothing drives are named, unless they are declared open; faults have their lines."""

import re

import pytest

import cosim
from cosim.cli.main import main
from cosim.coupling.files import is_system, read_system
from cosim.errors import CosimError, ParameterError, UnknownName, UsageError

MODELS = """
import cosim


def gain():
    model = cosim.Model("gain", stop_time=1.0, output_interval=0.5)
    u, v = model.input("u", "1", 1.0, "input"), model.input("v", "1", 0.0, "second input")
    k = model.parameter("k", "1", 2.0, "gain")
    x = model.state("x", "1", 0.0, "integral")
    model.derivative(x, k * u + v)
    model.output("y", "1", x + 1, "output")
    return model.freeze()
"""
SYSTEM = """[parts]
a = "models.py:gain"
b = "models.py:gain"

[connections]
"a.u" = "b.y"

[start_values]
"b.k" = 3
"a.v" = 0
"""


@pytest.fixture
def toml(tmp_path):
    (tmp_path / "models.py").write_text(MODELS)

    def written(text=SYSTEM, encoding="utf-8"):
        (tmp_path / "system.toml").write_text(text, encoding=encoding)
        return str(tmp_path / "system.toml")

    return written


def test_input_that_nothing_drives_is_listed(toml, capsys):
    assert read_system(toml()).undriven_inputs == ["b.u", "b.v"]
    assert main(["info", toml()]) == 0
    assert "driven by nothing: b.u, b.v" in capsys.readouterr().out


def test_many_inputs_that_nothing_drives_take_one_short_line(tmp_path, capsys):
    (tmp_path / "models.py").write_text(
        "import cosim\n\n\ndef wide():\n"
        "    model = cosim.Model('wide', stop_time=1.0)\n"
        "    x = model.state('x', 'm', 0.0, 'place')\n"
        "    force = sum(model.input(f'u{i}', 'm', 0.0, 'rate') for i in range(60))\n"
        "    model.derivative(x, force)\n"
        "    return model.freeze()\n"
    )
    path = tmp_path / "wide.toml"
    path.write_text(
        "[parts]\na = 'models.py:wide'\nb = 'models.py:wide'\n[connections]\n'b.u0' = 'a.x'\n"
    )
    assert main(["info", str(path)]) == 0
    line = next(x for x in capsys.readouterr().out.splitlines() if "driven by nothing" in x)
    assert line.startswith("  driven by nothing: 119 inputs: a.u0, a.u1, ")
    assert len(line) < 120  # 880 before


@pytest.mark.slow_rows("options1")
@pytest.mark.parametrize("options", [[], ["--method", "jacobi", "--macro-step", "0.5"]])
def test_run_names_it_once(toml, capsys, options):
    assert main(["simulate", toml(), *options, "-p", "b.u=1"]) == 0
    expected = "note: system: nothing drives b.v; connect it, give a value, or declare open_inputs"
    messages = capsys.readouterr().err
    assert expected in messages
    assert messages.count("drives") == 1


@pytest.mark.parametrize("options", [["-p", "b.u=1", "-p", "b.v=0"], ["-q"]])
def test_values_and_quiet_end_the_note(toml, capsys, options):
    assert main(["simulate", toml(), *options]) == 0
    assert "drives" not in capsys.readouterr().err


def test_run_of_a_system_says_which_inputs_nothing_drives(toml):
    system = read_system(toml())
    run = system.simulate(macro_step=0.1, start_values={"b.u": 1})
    assert run.stats["undriven_inputs"] == ["b.v"]
    assert (
        "undriven_inputs"
        not in system.simulate(macro_step=0.1, start_values={"b.u": 1, "b.v": 0}).stats
    )


def test_declared_open_input_is_not_listed_and_survives_ssp(toml, tmp_path):
    system = read_system(toml('open_inputs = ["b.u", "b.v"]\n' + SYSTEM))
    assert system.undriven_inputs == []
    again = cosim.read_ssp(system.write_ssp(tmp_path / "again.ssp"))
    assert again.undriven_inputs == []
    assert again.start_values["b", "u"] == 1  # its start value


@pytest.mark.parametrize(
    ("name", "kind", "words"),
    [
        ("a.u", UsageError, "a.u is connected; drop one"),
        ("a.k", UsageError, "a.k is no input"),
        ("a.w", UnknownName, "part 'a' has no variable 'w'"),
        ("c.u", UnknownName, "the system has no part 'c'"),
        ("b", UnknownName, "part 'b' has no variable ''; it has x, y, u"),
    ],
)
def test_wrong_open_input_is_rejected_with_its_line(toml, name, kind, words):
    path = toml(f'open_inputs = [\n  "b.u",\n  "{name}",\n]\n' + SYSTEM)
    with pytest.raises(kind, match=f"line 3: .*{re.escape(words)}"):
        read_system(path)


def test_open_inputs_of_python_are_a_list():
    with pytest.raises(UsageError, match=r"open_inputs was given 'a\.T2'"):
        cosim.couple({"a": "bar_on_frame"}, {}, open_inputs="a.T2")


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ('b = "models.py:gain"', 'b = "models.py:gian"', 3),
        ('b = "models.py:gain"', 'b = "gone.fmu"', 3),
        ('b = "models.py:gain"', '"b c" = "models.py:gain"', 3),
        ('"a.u" = "b.y"', '"a.u" = "b.z"', 6),
        ('"a.u" = "b.y"', '"a.w" = "b.y"', 6),
        ('"a.u" = "b.y"', '"a.v" = "b.y"\n"a.u" = "b.u"', 7),
        ('"b.k" = 3', '"b.k" = "3 m"', 9),
        ('"a.v" = 0', '"a.u" = 0', 10),
        ('"a.v" = 0', '"a.v" = nan', 10),
    ],
)
def test_fault_in_a_system_file_is_reported_with_its_line(toml, old, new, line):
    assert old in SYSTEM
    with pytest.raises(CosimError, match=rf"system\.toml, line {line}: ") as caught:
        read_system(toml(SYSTEM.replace(old, new)))
    assert str(caught.value).count(", line ") == 1


@pytest.mark.parametrize("value", ["1" * 400, "0", "-1", "nan", '"1"'])
def test_time_of_a_system_file_that_is_no_positive_number_is_rejected(toml, value):
    with pytest.raises(ParameterError, match=r"system\.toml, line 1: "):
        read_system(toml(f"output_interval = {value}\n{SYSTEM}"))


@pytest.mark.parametrize("text", [SYSTEM, SYSTEM.replace("[parts]", "[ parts ]")])
def test_byte_order_mark_before_the_first_table_is_read(toml, text):
    path = toml(text, encoding="utf-8-sig")
    assert is_system(path)
    assert list(read_system(path).parts) == ["a", "b"]


@pytest.mark.parametrize(
    "text",
    ['["parts"]\na = "{0}"', 'parts.a = "{0}"', "parts = {{a = '{0}'}}", "parts.'a' = '{0}'"],
)
def test_every_spelling_of_the_parts_makes_a_system(tmp_path, text):
    (tmp_path / "system.toml").write_text(text.format("crank_shaft") + "\n")
    assert is_system(tmp_path / "system.toml")
    assert list(read_system(tmp_path / "system.toml").parts) == ["a"]


def test_scene_that_mentions_parts_is_none(tmp_path):
    text = 'model = "crank_shaft"\ntitle = """\n[parts]\n"""\n'
    (tmp_path / "scene.toml").write_text(text)
    assert not is_system(tmp_path / "scene.toml")


def test_system_without_parts_is_rejected(toml):
    with pytest.raises(UsageError, match=r"line 1: \[parts\] is empty"):
        read_system(toml("[parts]\n"))
