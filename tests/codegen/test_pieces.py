"""Long functions in pieces: the same bits, and short code left alone."""

import re

import casadi as ca
import numpy as np
import pytest
from casadi import SX

import cosim
from cosim.codegen.compiler import compile_library
from cosim.codegen.pieces import MOST_BRANCHES, in_pieces


def generated(function: ca.Function) -> str:
    generator = ca.CodeGenerator("code", {"with_header": False, "indent": 1})
    generator.add(function)
    return str(generator.dump())


def results(code: str, folder, name: str, arguments) -> list[np.ndarray]:
    source = folder / f"{name}.c"
    source.write_text(code, encoding="utf-8")
    path = compile_library([source], folder / f"{name}.so", options=["-O1"])
    return [np.array(r) for r in ca.external("f", str(path)).call(arguments)]


@pytest.mark.slow_rows("300")
@pytest.mark.parametrize("size", [300, 5000])
def test_pieces_give_the_same_bits(size, tmp_path):
    dae = cosim.load("bicycle/independent")
    symbols = [dae.t, dae.x, dae.z, dae.u, dae.p]
    f = ca.Function("f", symbols, [dae.ode, dae.outputs], {"cse": True})
    rng = np.random.default_rng(5)
    arguments = [rng.uniform(0.2, 1.0, f.size_in(i)) for i in range(f.n_in())]
    code = generated(f)
    divided = in_pieces(code, longest=1000, piece=size)
    assert len(re.findall(r"part \d+ of", divided)) > 3
    whole, parts = (
        results(text, tmp_path, name, arguments) for text, name in ((code, "a"), (divided, "b"))
    )
    assert np.isfinite(whole[0]).all()
    for expected, found in zip(whole, parts, strict=True):
        np.testing.assert_array_equal(found, expected)


def test_code_of_usual_length_stays_as_it_is():
    x = SX.sym("x", 50)
    code = generated(ca.Function("f", [x], [ca.sin(x) * ca.sum1(x)]))
    assert in_pieces(code) == code


def test_functions_of_many_arguments_are_divided_though_they_are_short():
    x = SX.sym("x", MOST_BRANCHES)
    divided = in_pieces(generated(ca.Function("f", [x], [2 * x])))
    assert "part 1 of" in divided
    longest = max(len(part) for part in divided.split("\n}\n") if "part" in part)
    assert longest < 50_000
