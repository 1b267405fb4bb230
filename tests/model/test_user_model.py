import casadi as ca
import numpy as np
import pytest

import cosim
from cosim.errors import UnknownName, UsageError

BUILDER = """
import casadi as ca

def build():
    dae = ca.DaeBuilder("oscillator")
    x, v = dae.add("x"), dae.add("v")
    k = dae.add("k", "parameter", "tunable")
    f = dae.add("f", "input")
    dae.eq(dae.der(x), v)
    dae.eq(dae.der(v), f - k * x)
    power = dae.add("power", "output")
    dae.eq(power, f * v)
    dae.set_start("x", 1.0)
    dae.set_start("k", 4.0)
    dae.set_unit("x", "m")
    dae.set_min("k", 0.5)
    return dae

def number():
    return 42

def failing():
    raise RuntimeError("no such thing")
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(BUILDER)
    return path


def test_dae_builder_keeps_names_starts_units_and_bounds(file):
    dae = cosim.load(f"{file}:build")
    assert [v.name for v in dae.states] == ["x", "v"]
    assert dae.variable("x").unit == "m"
    assert dae.variable("x").start == 1.0
    assert dae.variable("k").minimum == 0.5


def test_dae_builder_runs_like_the_closed_form(file):
    run = cosim.simulate(cosim.load(f"{file}:build"), stop_time=2, relative_tolerance=1e-10)
    expected = np.cos(2 * run.time)
    np.testing.assert_allclose(run["x"], expected, rtol=0, atol=2e-8)  # measured 3e-9


@pytest.mark.slow
def test_dae_builder_takes_both_backends(file, tmp_path):
    dae = cosim.load(f"{file}:build")
    path = cosim.export_fmu(dae, tmp_path / "oscillator.fmu")
    native = cosim.simulate(dae, stop_time=1, relative_tolerance=1e-10)
    for interface in ("ModelExchange", "CoSimulation"):
        again = cosim.simulate_fmu(
            path,
            interface=interface,
            stop_time=1,
            output_interval=0.01,
            relative_tolerance=1e-10,
        )
        assert cosim.compare(native, again).agrees


def test_state_of_a_builder_jumps_at_its_events():
    builder = ca.DaeBuilder("sawtooth")
    h = builder.add("h", {"start": 0.5})
    builder.eq(builder.der(h), -1)
    builder.when(h < 0, [builder.reinit("h", 1)])
    run = cosim.simulate(cosim.from_dae_builder(builder), stop_time=3, compiled=False)
    np.testing.assert_allclose([e.time for e in run.events], [0.5, 1.5, 2.5], rtol=0, atol=1e-9)
    assert run.final["h"] == pytest.approx(0.5, abs=1e-9)


@pytest.mark.parametrize(
    ("function", "error", "message"),
    [
        ("number", UsageError, "returned int"),
        ("failing", UsageError, "no such thing"),
        ("bild", UnknownName, "did you mean build"),
    ],
)
def test_functions_that_build_nothing_are_refused(file, function, error, message):
    with pytest.raises(error, match=message):
        cosim.load(f"{file}:{function}")


def test_missing_file_is_refused(tmp_path):
    with pytest.raises(UnknownName, match="not a file"):
        cosim.load(f"{tmp_path}/none.py:build")


def test_file_with_a_syntax_error_is_refused(tmp_path):
    path = tmp_path / "broken.py"
    path.write_text("def build(:")
    with pytest.raises(UsageError, match="SyntaxError"):
        cosim.load(f"{path}:build")


@pytest.mark.parametrize(
    ("law", "remedy"),
    [
        ("-1 if x > 0 else 1", r"use casadi\.if_else\(x > 0, a, b\)"),
        ("math.sin(x)", r"casadi\.sin"),
        ("model.limit('x is small', 1 - x) or -x", r"limit\(expression, 'x is small'\)"),
    ],
)
def test_mistakes_of_first_models_are_explained(law, remedy, tmp_path):
    path = tmp_path / "own.py"
    path.write_text(
        "import math\n\nfrom casadi_models.dae import Model\n\n\ndef build():\n"
        "    model = Model('own')\n    x = model.state('x', 'm', 1.0, 'place')\n"
        f"    model.derivative(x, {law})\n    return model.freeze()\n"
    )
    with pytest.raises(UsageError, match=remedy):
        cosim.load(f"{path}:build")
