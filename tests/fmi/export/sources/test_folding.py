"""Folded code: fewer temporaries, the same bits."""

import ctypes

import casadi as ca
import numpy as np
import pytest

from cosim.codegen.compiler import compile_library
from cosim.fmi.export.sources.folding import folded

OPTIONS = ("-std=c11", "-O1", "-ffp-contract=off")


def generated(expressions, x):
    generator = ca.CodeGenerator("code", {"with_header": False, "indent": 1})
    generator.add(ca.Function("f", [x], expressions, {"cse": True}))
    return generator.dump()


def tangle(seed, count=400):
    """Return expressions that use values once, often, in signs, calls, powers and conditions."""
    random = np.random.default_rng(seed)
    x = ca.SX.sym("x", 5)
    pool = ca.vertsplit(x)
    for _ in range(count):
        a, b, c = (pool[i] for i in random.integers(max(0, len(pool) - 40), len(pool), 3))
        forms = (a * b, a - b, -a, a / (2 + b * b), ca.sin(a) - 3, ca.if_else(a > b, c, -b), a * a)
        pool.append(forms[random.integers(len(forms))])
    return [ca.vertcat(*pool[-60:]), pool[-1] * ca.cos(pool[-2])], x


def results(code, name, folder, points):
    source = folder / f"{name}.c"
    source.write_text(code)
    run = ctypes.CDLL(str(compile_library([source], folder / f"{name}.so", options=OPTIONS))).f
    array = ctypes.c_double * 60
    found = []
    for point in points:
        first, second, work = array(), array(), (ctypes.c_double * 1000)()
        arg = (ctypes.POINTER(ctypes.c_double) * 1)((ctypes.c_double * 5)(*point))
        res = (ctypes.POINTER(ctypes.c_double) * 2)(first, second)
        assert run(arg, res, None, work, 0) == 0
        found.append([*first, second[0]])
    return np.array(found)


@pytest.mark.parametrize("seed", range(3))
def test_folded_code_gives_the_same_bits_from_fewer_lines(seed, tmp_path):
    code = generated(*tangle(seed))
    short = folded(code)
    assert short.count("\n") < 0.8 * code.count("\n")  # measured 0.60 to 0.64
    points = np.random.default_rng(seed).normal(size=(20, 5))
    plain = results(code, "plain", tmp_path, points)
    np.testing.assert_array_equal(results(short, "short", tmp_path, points), plain)


def test_what_is_used_twice_and_what_changes_before_its_use_stay_apart():
    lines = (
        "static int casadi_f0(x) {",
        "  casadi_real a0, a1, a2;",
        " a0=arg[0]? arg[0][0] : 0;",
        " a1=sin( a0 );",
        " a2=(a1*a1);",  # uses a1 twice; used once itself
        " a1=(a0-2.);",  # used once, but a0 changes first
        " a0=(a0*a2);",
        " a0=(a0+a1);",
        " if (res[0]!=0) res[0][0]=a0;",
        " return 0;",
        "}",
    )
    assert folded("\n".join(lines)).split("\n")[3:8] == [
        " a1=sin( a0 );",
        " a2=(a1*a1);",
        " a1=(a0-2.);",
        " if (res[0]!=0) res[0][0]=((a0*a2)+a1);",
        " return 0;",
    ]


def test_code_with_loops_and_branches_is_left_alone():
    code = "static int casadi_f0(x) {\n a0=(a1*a2);\n if (a0>0) {\n a3=(a0+a1);\n }\n return 0;\n}"
    assert folded(code) == code
