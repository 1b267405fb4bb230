"""`load` and what users write for it: names, files, functions, models; every fault in one line."""

import re
import textwrap
from pathlib import Path

import numpy as np
import pytest

import casadi_models
import cosim
from cosim.cli.main import main
from cosim.errors import UnknownName, UsageError
from cosim.model.catalogue import loaded

HEAD = """
import casadi as ca
from casadi_models.dae import Model

def build():
"""


def test_a_model_of_the_catalogue_is_built_once_but_what_a_file_holds_may_change(written):
    assert loaded("crank_shaft") is loaded("crank_shaft")
    assert cosim.load("crank_shaft") is not loaded("crank_shaft")  # its own
    body = "model = Model('{}')\nmodel.output('y', '1', 1.0, 'y')\nreturn model.freeze()"
    name = written(body.format("one"))
    assert loaded(name).name == "one"
    written(body.format("another"))
    assert loaded(name).name == "another"


@pytest.fixture
def written(tmp_path):
    """Return a function that writes a model file whose `build` has this body."""

    def write(body, head=HEAD):
        path = tmp_path / "mine.py"
        path.write_text(head + textwrap.indent(textwrap.dedent(body), "    "), encoding="utf-8")
        return f"{path}:build"

    return write


def refusal(name, kind):
    with pytest.raises(kind) as caught:
        cosim.load(name)
    message = str(caught.value)
    assert "\n" not in message
    return message


# -- names ----------------------------------------------------------------------------------------


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("name", casadi_models.CATALOG)
def test_every_name_of_the_catalogue_is_built(name):
    dae = cosim.load(name)
    assert dae.full_name == name
    model = name.partition("/")[0]
    first = next(entry for entry in casadi_models.CATALOG if entry.startswith(f"{model}/"))
    assert cosim.load(model).full_name == first


@pytest.mark.parametrize("name", casadi_models.CATALOG)
def test_formulation_is_the_file_of_its_name_as_for_a_users_own(name):
    path = Path(casadi_models.__file__).parent / f"{name}.py"
    assert cosim.load(f"{path}:build").full_name == name


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("Bicycle", r"no model 'Bicycle'; did you mean bicycle\? \(all: cosim info\)"),
        ("doublependulum", "did you mean double_pendulum"),
        ("", "no model ''; it has crank_shaft, bar_on_frame, bicycle"),
        ("/", "no model ''"),
        ("bicycle/Book", r"bicycle has no formulation 'Book'; did you mean book\?"),
        ("bicycle/", "bicycle has no formulation ''; it has independent, book, multipliers"),
        ("no such\nmodel", "no model"),
    ],
)
def test_unknown_model_is_answered_with_the_nearest_whatever_the_case(name, told):
    with pytest.raises(UnknownName, match=told):
        cosim.load(name)


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("mine.py", "name the function that builds it, too, as PATH.py:FUNCTION"),
        ("bar_theta.toml", "most verbs; in Python, by cosim.read_scene"),
        ("folder/bicycle.fmu", "an FMU is taken by simulate"),
        ("run.mat", "write NAME.csv for plot and animate"),
        ("run.json", "write NAME.csv for plot and animate"),
        ("run.csv", "a result is taken by plot and animate; in Python, by cosim.Trajectory.read"),
    ],
)
def test_file_that_is_no_model_is_told_where_it_belongs(name, told):
    assert told in refusal(name, UsageError)


@pytest.mark.parametrize("name", [None, 3, b"bicycle", ["bicycle"], Path("mine.py:build")])
def test_what_is_no_name_is_refused(name):
    assert "load was given" in refusal(name, UsageError)


# -- the file -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"def build(:\n", "cannot be loaded: SyntaxError: invalid syntax (mine.py, line 1)"),
        (b"import no_such_module\n", "cannot be loaded (line 1): ModuleNotFoundError: No module"),
        (b"raise ValueError('two\\nlines')\n", "cannot be loaded (line 1): ValueError: two lines"),
        (b"import sys\nsys.exit(4)\n", "cannot be loaded (line 2): SystemExit: 4"),
        (b"\xff\xfe\x00", "cannot be loaded: SyntaxError"),
        (b"def build():\n\treturn 1\n        return 2\n", "cannot be loaded: TabError"),
    ],
)
def test_file_that_python_cannot_run_is_refused_with_the_reason(content, told, tmp_path):
    path = tmp_path / "mine.py"
    path.write_bytes(content)
    message = refusal(f"{path}:build", UsageError)
    assert message.startswith(str(path))
    assert told in message


@pytest.mark.parametrize("name", ["none.py", "folder.py"])
def test_what_is_no_file_is_refused(name, tmp_path):
    (tmp_path / "folder.py").mkdir()
    message = refusal(f"{tmp_path}/{name}:build", UnknownName)
    assert message == f"{tmp_path}/{name} is not a file; name one as PATH.py:FUNCTION"


def test_missing_function_is_answered_with_those_that_the_file_itself_has(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text("from math import sin\nsize = 3\ndef build(): ...\ndef other(): ...\n")
    assert "no function 'bild'; did you mean build?" in refusal(f"{path}:bild", UnknownName)
    assert "no function ''; it has build, other" in refusal(f"{path}:", UnknownName)
    assert "no function 'size'; it has build, other" in refusal(f"{path}:size", UnknownName)


def test_name_with_spaces_and_other_letters_is_read(tmp_path):
    path = tmp_path / "mein Pendel Übung.py"
    path.write_text(HEAD + "    model = Model('free')\n    model.state('x', 'm', 1.0, 'x')\n"
                    "    model.derivative(model.state('y', 'm', 0.0, 'y'), 0)\n"
                    "    return model.freeze()\n", encoding="utf-8")  # fmt: skip
    assert "no derivative for state 'x'" in refusal(f"{path}:build", UsageError)


# -- what the function returns --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("body", "told"),
    [
        ("return 3", "build returned int; return what Model.freeze() returns"),
        ("pass", "build returned NoneType"),
        ("return Model('x')", "build returned Model"),
        ("yield 1", "build returned generator"),
        ("raise KeyError('mass')", "build failed (line 6): KeyError: 'mass'"),
        ("raise SystemExit(3)", "build failed (line 6): SystemExit: 3"),
        ("return build()", "build failed (line 6): RecursionError"),
        ("return ca.SX.sym('x', 2, 3) @ ca.SX.sym('y', 2)", "build failed (line 6): RuntimeError"),
        (
            "Model('x').when('stop', 1, {})",
            "Model.when() takes 3 positional arguments but 4 were given; "
            "write when(condition, values, *, name='')",
        ),
        ("return Model('x').freeze()", "built a model without a state or an output; add one"),
        ("return ca.DaeBuilder('x')", "built a model without a state or an output; add one"),
        (
            "m = Model('x y')\nreturn m.freeze()",
            "'x y' cannot name a model: use letters, digits and _",
        ),
        (
            "m = Model('x')\nm.state('a', 'm', 0.0, 'a')\nreturn m.freeze()",
            "x: no derivative for state 'a'; call derivative()",
        ),
        (
            "m = Model('x')\nm.state('a', 'furlong', 0.0, 'a')\nreturn m.freeze()",
            "x: a: unit 'furlong' is unknown",
        ),
        (
            "m = Model('x')\nm.state('a', 'm', float('nan'), 'a')\nreturn m.freeze()",
            "x: a: start nan is not finite; give a finite number",
        ),
    ],
)
def test_function_that_builds_no_model_is_refused_with_the_reason(body, told, written):
    name = written(body)
    message = refusal(name, UsageError)
    assert message.startswith(name)
    assert told in message


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ("d.add('spare')", "equations for"),
        ("d.set_start('x', float('nan'))", "x: start nan is not finite"),
        ("d.set_min('x', 3.0)", "x: start 0.0 is not within 3.0"),
        ("raise RuntimeError('Error in\\nFunction')", "RuntimeError: Error in Function"),
    ],
)
def test_dae_builder_that_makes_no_model_is_refused_with_the_reason(change, told, written):
    body = f"d = ca.DaeBuilder('decay')\nx = d.add('x')\nd.eq(d.der(x), -x)\n{change}\nreturn d"
    assert told in refusal(written(body), UsageError)


def test_dae_builder_whose_name_is_no_model_s_is_refused_without_casadi_s_own_words(written):
    body = "d = ca.DaeBuilder('my decay')\nx = d.add('x')\nd.eq(d.der(x), -x)\nreturn d"
    message = refusal(written(body), UsageError)
    assert message == "DaeBuilder 'my decay' cannot name a model: use letters, digits and _"


@pytest.mark.parametrize("builder", [None, "decay", cosim.load("crank_shaft")])
def test_what_is_no_dae_builder_is_refused(builder):
    with pytest.raises(
        UsageError, match=r"from_dae_builder was given .*; give a casadi\.DaeBuilder"
    ):
        cosim.from_dae_builder(builder)


# -- and one that is right ------------------------------------------------------------------------


def test_builder_runs_wherever_a_model_name_does(written, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    written("""
        model = Model("decay", stop_time=1.0)
        x = model.state("x", "m", 1.0, "place")
        model.derivative(x, -x)
        return model.freeze()
    """)
    assert main(["info", "mine.py:build"]) == 0
    assert re.search(r"^x +m +m +1 +place$", capsys.readouterr().out, re.MULTILINE)
    assert (
        main(
            [
                "simulate",
                "mine.py:build",
                "--backend",
                "native-interpreted",
                "--output-interval",
                "1",
            ]
        )
        == 0
    )
    end = float(capsys.readouterr().out.splitlines()[-1].partition(",")[2])
    np.testing.assert_allclose(end, np.exp(-1), rtol=1e-6)  # run at 1e-8; measured 4e-8
    assert main(["export", "mine.py:build", "-q"]) == 0
    assert cosim.simulate_fmu("decay.fmu")["x"][-1] == pytest.approx(
        np.exp(-1), rel=1e-7
    )  # run at 1e-9
