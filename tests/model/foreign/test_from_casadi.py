"""CasADi's symbols, expressions and functions as models: right values, or one sentence."""

from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from casadi import MX, SX
from fmpy.validation import validate_fmu

import cosim
from cosim.errors import ParameterError, UnknownName, UsageError

KINDS = pytest.mark.parametrize("kind", [SX, MX])
END = {"stop_time": 1.0, "relative_tolerance": 1e-10}


def oscillator(kind) -> dict:
    """Return x'' = u - k x; with u = 0 and k = 4, x = cos 2t."""
    x, v, k, u = (kind.sym(n) for n in "xvku")
    return {"x": ca.vertcat(x, v), "p": k, "u": u, "ode": ca.vertcat(v, u - k * x)}


def final(dae, name: str = "x", **options) -> float:
    return cosim.simulate(dae, **(END | options))[name][-1]


@pytest.mark.slow_rows("SX")
@KINDS
def test_oscillator_is_its_closed_form_and_takes_both_backends(kind, tmp_path):
    system = oscillator(kind)
    x, v = ca.vertsplit(system["x"]) if kind is SX else system["x"].primitives()
    energy = v**2 / 2 + system["p"] * x**2 / 2
    dae = cosim.from_casadi(
        system,
        {"x": 1, "k": 4},
        {"energy": energy},
        units={"x": "m", "v": "m/s"},
        meanings={"x": "place"},
        nominals={"v": 2.0},
        name="swing",
        stop_time=1.0,
    )
    assert dae.full_name == "swing"
    assert [(s.name, s.unit, s.meaning, s.start) for s in dae.states] == [
        ("x", "m", "place", 1.0),
        ("v", "m/s", "v", 0.0),
    ]
    assert dae.variable("v").nominal == 2.0
    run = cosim.simulate(dae, **END)
    np.testing.assert_allclose(run["x"], np.cos(2 * run.time), rtol=0, atol=1e-8)
    np.testing.assert_allclose(run["energy"], 2.0, rtol=0, atol=1e-8)
    path = cosim.export_fmu(dae, tmp_path / "swing.fmu")
    for interface in ("ModelExchange", "CoSimulation"):
        again = cosim.simulate_fmu(path, interface=interface, output_interval=0.01, **END)
        assert cosim.compare(run, again).agrees


def test_sx_and_mx_give_the_same_equations():
    both = [cosim.from_casadi(oscillator(kind), {"k": 4.0}) for kind in (SX, MX)]
    assert str(both[0].ode) == str(both[1].ode)


@KINDS
def test_entries_of_vectors_and_matrices_have_names(kind):
    y, A, b = kind.sym("y", 3), kind.sym("A", 2, 3), kind.sym("b", 2)
    dae = cosim.from_casadi(
        {"x": y, "p": [A, b], "ode": -y},
        {"y": [1, 2, 3], "A": [[1, 2, 3], [4, 5, 6]], "b": 7, "b_2": 8},
        {"w": A @ y + b, "M": A},
    )
    assert [v.name for v in dae.states] == ["y_1", "y_2", "y_3"]
    assert [v.start for v in dae.states] == [1, 2, 3]
    starts = {v.name: v.start for v in dae.parameters}
    assert starts == {
        "A_1_1": 1, "A_2_1": 4, "A_1_2": 2, "A_2_2": 5, "A_1_3": 3, "A_2_3": 6, "b_1": 7, "b_2": 8
    }  # fmt: skip
    run = cosim.simulate(dae, stop_time=0.01)
    assert [run["w_1"][0], run["w_2"][0]] == [14 + 7, 32 + 8]
    assert [run[f"M_{i}_{j}"][0] for i in (1, 2) for j in (1, 2, 3)] == [1, 2, 3, 4, 5, 6]


@pytest.mark.slow
@KINDS
def test_time_inputs_and_algebraic_unknowns_have_their_place(kind):
    t, x, z, u = (kind.sym(n) for n in "txzu")
    dae = cosim.from_casadi(
        {"t": t, "x": x, "z": z, "u": u, "ode": z, "alg": z + z**3 - t - u}, {"z": 0.1}
    )
    run = cosim.simulate(dae, solver="rosenbrock", **END)
    z1 = run["z"][-1]
    assert abs(z1 + z1**3 - 1) < 1e-9
    # integral of z dt = integral of z (1 + 3 z^2) dz
    assert run["x"][-1] == pytest.approx(z1**2 / 2 + 3 * z1**4 / 4, abs=1e-8)


@KINDS
def test_quadrature_becomes_a_state(kind):
    x = kind.sym("x")
    dae = cosim.from_casadi({"x": x, "ode": -x, "quad": x}, {"x": 1.0}, units={"quad": "m.s"})
    assert dae.variable("quad").unit == "m.s"
    assert final(dae, "quad") == pytest.approx(1 - np.exp(-1), abs=1e-9)
    two = {"x": x, "ode": -x, "quad": ca.vertcat(x, x * x)}
    dae = cosim.from_casadi(two, {"x": 1.0, "quad": [1, 2]})
    assert final(dae, "quad_2") == pytest.approx(2 + (1 - np.exp(-2)) / 2, abs=1e-9)


def test_start_may_depend_on_parameters():
    x, k = SX.sym("x"), SX.sym("k")
    dae = cosim.from_casadi({"x": x, "p": k, "ode": -k * x}, {"x": 2 * k, "k": 3.0})
    run = cosim.simulate(dae, start_values={"k": 0.5}, **END)
    assert run["x"][[0, -1]] == pytest.approx([1.0, np.exp(-0.5)], abs=1e-8)


@KINDS
def test_function_of_that_signature_is_a_model(kind, tmp_path):
    system = oscillator(kind)
    arguments = [system["x"], system["p"], system["u"]] if kind is SX else None
    if arguments is None:
        y, k, u = MX.sym("y", 2), MX.sym("k"), MX.sym("u")
        arguments, ode = [y, k, u], ca.vertcat(y[1], u - k * y[0])
    else:
        ode = system["ode"]
    function = ca.Function("f", arguments, [ode, ode[1]], ["x", "p", "u"], ["ode", "a"])
    dae = cosim.from_casadi(function, {"x": [1, 0], "p": 4})
    assert [v.name for v in dae.output_variables] == ["a"]
    assert final(dae, "x_1") == pytest.approx(np.cos(2), abs=1e-8)
    function.save(str(tmp_path / "f.casadi"))
    again = cosim.from_casadi(tmp_path / "f.casadi", {"x": [1, 0], "p": 4})
    assert final(again, "x_1") == final(dae, "x_1")


def test_file_of_a_function_without_parameters_is_loaded_by_name(tmp_path):
    x = SX.sym("x")
    ca.Function("f", [x], [1 - x], ["x"], ["ode"]).save(str(tmp_path / "growth.casadi"))
    dae = cosim.load(str(tmp_path / "growth.casadi"))
    assert dae.name == "growth"
    assert final(dae) == pytest.approx(1 - np.exp(-1), abs=1e-9)


def test_defaults_of_a_function_are_its_start_values(tmp_path):
    x, p = SX.sym("x"), SX.sym("p", 2)
    options = {"default_in": [2.0, 3.0]}
    function = ca.Function("f", [x, p], [-p[0] * p[1] * x], ["x", "p"], ["ode"], options)
    function.save(str(tmp_path / "decay.casadi"))
    dae = cosim.load(str(tmp_path / "decay.casadi"))
    run = cosim.simulate(dae, start_values={"p_2": 0.5}, **END)
    assert run["x"][[0, -1]] == pytest.approx([2.0, 2 * np.exp(-1.5)], abs=1e-8)
    assert cosim.from_casadi(function, {"p_1": 7}).parameters[0].start == 7


def test_file_whose_parameters_have_no_value_says_who_gives_them(tmp_path):
    x, k = SX.sym("x"), SX.sym("k")
    ca.Function("f", [x, k], [-k * x], ["x", "p"], ["ode"]).save(str(tmp_path / "f.casadi"))
    with pytest.raises(ParameterError, match=r"function of a Python file that returns 'f\.casadi'"):
        cosim.load(str(tmp_path / "f.casadi"))


USER = """
import pathlib
import casadi as ca
x, k = ca.SX.sym("x"), ca.SX.sym("k")
system = {"x": x, "p": k, "ode": -k * x}

def options():
    return system | {"start_values": {"x": 1, "k": 2}, "outputs": {"y": 2 * x}, "name": "decay"}

def pair():
    return system, {"x": 1, "k": 2}

def function():
    return ca.Function("f", [x], [-x], ["x"], ["ode"])

def function_and_start():
    return ca.Function("f", [x, k], [-k * x], ["x", "p"], ["ode"]), {"x": 1, "p": 2}

def saved():
    path = pathlib.Path(__file__).with_name("f.casadi")
    function_and_start()[0].save(str(path))
    return path, {"x": 1, "p": 2}

def reduced():
    dx, y = ca.SX.sym("dx"), ca.SX.sym("y")
    laws = ca.vertcat(dx + y, y - 2 * x)
    return ca.dae_reduce_index({"x_impl": x, "dx_impl": dx, "z": y, "alg": laws})

def reduced_and_start():
    return reduced(), {"x": 1}
"""


@pytest.mark.parametrize(
    ("builder", "name", "end"),
    [
        ("options", "decay", np.exp(-2)),
        ("pair", "mine", np.exp(-2)),
        ("function", "mine", 0.0),
        ("function_and_start", "mine", np.exp(-2)),
        ("saved", "mine", np.exp(-2)),
        ("reduced", "mine", 0.0),
        ("reduced_and_start", "mine", np.exp(-2)),
    ],
)
def test_user_file_may_return_any_of_them(tmp_path, builder, name, end):
    (tmp_path / "mine.py").write_text(USER)
    dae = cosim.load(f"{tmp_path}/mine.py:{builder}")
    assert dae.name == name
    assert final(dae) == pytest.approx(end, abs=1e-9)


@pytest.mark.slow
def test_first_example_of_the_readme_makes_an_fmu_that_fmpy_validates(
    tmp_path, monkeypatch, capsys
):
    text = (Path(__file__).parents[3] / "README.md").read_text(encoding="utf-8")
    code = next(part for part in text.split("```python\n")[1:] if "from_casadi" in part)
    code = code.partition("```")[0]
    assert len(code.splitlines()) <= 12
    monkeypatch.chdir(tmp_path)
    exec(code, {})
    assert " agree: " in capsys.readouterr().out
    assert validate_fmu("oscillator.fmu") == []


def refused(error, match, *arguments, **options):
    with pytest.raises(error, match=match) as caught:
        cosim.from_casadi(*arguments, **options)
    assert "\n" not in str(caught.value)


def test_refusals_name_what_is_wrong():
    x, y, k = SX.sym("x"), SX.sym("y"), SX.sym("k")
    one = {"x": x, "ode": -x}
    refused(ParameterError, "parameter k has no value", one | {"p": k})
    refused(UsageError, "ode uses 'k'", {"x": x, "ode": -k * x})
    refused(UsageError, "output a uses 'k'|a uses 'k'", one, None, {"a": k})
    refused(UsageError, "ode has 1 rows, x has 2", {"x": ca.vertcat(x, y), "ode": -x})
    refused(UsageError, "alg has 0 rows, z has 1", one | {"z": y})
    refused(UnknownName, "key 'odes'; did you mean ode", {"x": x, "odes": -x})
    refused(UnknownName, "start value of 'z'", one, {"z": 1})
    refused(UnknownName, "unit of 'z'", one, units={"z": "m"})
    refused(
        ParameterError,
        "y has 2 entries, but 3",
        {"x": SX.sym("y", 2), "ode": SX(2, 1)},
        {"y": [1, 2, 3]},
    )
    refused(ParameterError, "start of x is 'a'", one, {"x": "a"})
    refused(UsageError, "x is the expression", {"x": 2 * x, "ode": -x})
    refused(UsageError, "mixed", {"x": x, "p": MX.sym("p"), "ode": -x}, {"p": 1})
    refused(UsageError, "ode is MX", {"x": x, "ode": MX.sym("y")})
    refused(UsageError, "ode uses 'm'", {"x": MX.sym("x"), "ode": MX.sym("m")})
    refused(UsageError, "give a dict of expressions", 42)
    refused(UsageError, "neither a state nor an output", {})
    refused(UsageError, "ode is '-x'; give an expression", {"x": x, "ode": "-x"})
    refused(UsageError, "outputs was given", one, None, [x])
    refused(UsageError, "start_values was given", one, [1])
    refused(UsageError, "unit of x was given 3", one, units={"x": 3})
    refused(ParameterError, "start of x is True", one, {"x": True})
    refused(UnknownName, "input 'i0'", ca.Function("f", [x], [-x]))
    refused(UsageError, "holds no CasADi Function", "nothing.casadi")
    refused(UnknownName, "input 'y'", ca.Function("f", [y], [y], ["y"], ["ode"]))
    refused(UsageError, "twice", {"x": [x, SX.sym("x")], "ode": ca.vertcat(x, x)})
    refused(UsageError, "index above 1", {"x": x, "z": y, "ode": y, "alg": x - 1})
    refused(UsageError, "not finite|infinity|constant", {"x": x, "ode": x * ca.inf})


def test_unknown_unit_counts_with_factor_1_and_says_so(tmp_path):
    x = SX.sym("x")
    dae = cosim.from_casadi({"x": x, "ode": -x}, {"x": 1.0}, units={"x": "furlong"})
    assert "unit 'furlong' is unknown here: factor 1" in dae.variable("x").meaning
    run = cosim.simulate(dae, **END)
    assert run.units["x"] == "furlong"
    path = cosim.export_fmu(dae, tmp_path / "x.fmu")
    assert (
        not cosim.compare(run, cosim.simulate_fmu(path, output_interval=0.01, **END)).worst.scaled
        > 1e-6
    )


def test_names_that_c_does_not_take_are_changed():
    x, v = SX.sym("body.x"), SX.sym("v[1]")
    dae = cosim.from_casadi({"x": [x, v], "ode": ca.vertcat(v, -x)}, {"body.x": 1})
    assert [s.name for s in dae.states] == ["body_x", "v_1"]
    assert dae.states[0].start == 1
    assert dae.states[0].meaning == "body.x"


def test_letters_beyond_ascii_are_written_out():
    names = ["φ", "φ\u0307", "Δx", "x", "größe", "π", "x₁"]
    dae = cosim.from_casadi({"x": [SX.sym(n) for n in names], "ode": SX.ones(len(names))})
    found = [s.name for s in dae.states]
    assert found == ["phi", "phi_dot", "Deltax", "x", "grosse", "pi", "x1"]
    assert [s.meaning for s in dae.states] == names


@pytest.mark.parametrize(
    ("name", "spelt"),
    [
        ("λ", "lambda"),
        ("Λ_1", "Lambda_1"),
        ("𝜆", "lambda"),
        ("ẋ", "x_dot"),
        ("ẍ", "x_ddot"),
        ("φ̈", "phi_ddot"),
        ("x⃛", "x_dddot"),
        ("Übermaß", "Ubermass"),
        ("naïf", "naif"),
        ("ħ", "hbar"),
        ("ℏ", "hbar"),
        ("∆x", "Deltax"),
        ("∂x", "partialx"),
        ("ø", "o"),
        ("Ł", "L"),
        ("æ", "ae"),
        ("Œ", "Oe"),
        ("ж", "u0436"),
        ("日x", "u65e5x"),
        ("x٣", "xu0663"),
        ("x\u2032", "x"),
    ],
)
def test_letter_is_spelt_as_its_readers_call_it(name, spelt):
    dae = cosim.from_casadi({"x": SX.sym(name), "ode": 1})
    assert [(s.name, s.meaning) for s in dae.states] == [(spelt, name)]


def test_lambda_is_a_variable_on_both_backends(tmp_path):
    """Python keeps that word for itself; C and XML do not."""
    tilt = SX.sym("λ")
    dae = cosim.from_casadi({"x": tilt, "ode": -tilt}, {"lambda": 1.0}, name="tilting")
    run = cosim.simulate(dae, stop_time=1.0, output_interval=0.5)
    assert run["lambda"][-1] == pytest.approx(np.exp(-1), rel=1e-5)
    fmu = cosim.export_fmu(dae, tmp_path / "tilting.fmu")
    found = cosim.simulate_fmu(fmu, stop_time=1.0, output_interval=0.5)
    assert found["lambda"][-1] == pytest.approx(np.exp(-1), rel=1e-5)


def test_symbols_that_would_be_called_alike_are_refused_by_their_own_names():
    x, y = SX.sym("body.x"), SX.sym("body_x")
    with pytest.raises(UsageError, match=r"'body\.x' and 'body_x' are both called 'body_x'"):
        cosim.from_casadi({"x": [x, y], "ode": ca.vertcat(y, -x)})
    with pytest.raises(UsageError, match="'time' cannot name a variable: it is the independent"):
        cosim.from_casadi({"x": SX.sym("time_"), "ode": 1})


def test_a_symbol_without_a_name_a_sparse_one_and_a_start_of_none():
    nameless = SX.sym("")
    assert cosim.from_casadi({"x": nameless, "ode": -nameless}).states[0].name == "v"
    with pytest.raises(UsageError, match="x is sparse; give dense symbols"):
        cosim.from_casadi({"x": SX.sym("d", ca.Sparsity.diag(2)), "ode": SX(4, 1)})
    with pytest.raises(ParameterError, match="start of x is None; give numbers"):
        cosim.from_casadi({"x": SX.sym("x"), "ode": 1}, {"x": None})
