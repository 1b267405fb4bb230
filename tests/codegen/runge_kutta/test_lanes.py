"""Each operation of lanes against CasADi's own virtual machine, at ordinary and odd numbers."""

import ctypes

import casadi as ca
import numpy as np
import pytest
from casadi import SX

from cosim.codegen.c_sources import solver_source
from cosim.codegen.compiler import cached_library
from cosim.codegen.runge_kutta.lane_library import processor_lanes
from cosim.codegen.runge_kutta.lanes import vector_text
from cosim.errors import UsageError

x, y = SX.sym("x"), SX.sym("y")
OPERATIONS = {
    "sum": x + y, "difference": x - y, "product": x * y, "quotient": x / y, "negative": -x,
    "square": x**2, "twice": 2 * x, "inverse": 1 / x, "constant": x * 0.1, "power": ca.fabs(x) ** y,
    "constant power": ca.fabs(x) ** 1.3, "root": ca.sqrt(x), "sin": ca.sin(x), "cos": ca.cos(x),
    "tan": ca.tan(x), "asin": ca.asin(x), "acos": ca.acos(x), "atan": ca.atan(x),
    "sinh": ca.sinh(x), "cosh": ca.cosh(x), "tanh": ca.tanh(x), "asinh": ca.asinh(x),
    "acosh": ca.acosh(x), "atanh": ca.atanh(x), "exp": ca.exp(x), "expm1": ca.expm1(x),
    "log": ca.log(x), "log1p": ca.log1p(x), "erf": ca.erf(x), "floor": ca.floor(x),
    "ceil": ca.ceil(x), "fmod": ca.fmod(x, y), "remainder": ca.remainder(x, y),
    "atan2": ca.atan2(x, y), "hypot": ca.hypot(x, y), "fabs": ca.fabs(x), "sign": ca.sign(x),
    "copysign": ca.copysign(x, y), "fmin": ca.fmin(x, y), "fmax": ca.fmax(x, y), "less": x < y,
    "less or equal": x <= y, "equal": x == y, "not equal": x != y, "not": ca.logic_not(x),
    "and": ca.logic_and(x, y), "or": ca.logic_or(x, y), "if": ca.if_else(x > y, ca.sqrt(x), y),
}  # fmt: skip
ODD = [0.0, -0.0, 1.0, -1.0, 0.5, -2.5, 3e5, -1e-9, np.inf, -np.inf, np.nan]


def compiled(function, lanes):
    """Return a call of a function of two columns in lanes: (n, lanes) rows in and out."""
    size = function.numel_out(0)
    text = "\n".join(
        (
            f"#define LANES {lanes}",
            solver_source("lanes.h"),
            vector_text(function, "f"),
            "LANES_SHARED void call(const double *a, const double *b, double *c) {",
            f"    V x, y, z[{size}];",
            "    memcpy(&x, a, sizeof x);",
            "    memcpy(&y, b, sizeof y);",
            "    const V *in[] = {&x, &y};",
            "    V *out[] = {z};",
            "    f(in, out);",
            "    memcpy(c, z, sizeof z);",
            "}",
        )
    )
    library = ctypes.CDLL(str(cached_library(text, lambda: text)))

    def call(a, b):
        c = np.empty((size, lanes))
        library.call(*(ctypes.c_void_p(array.ctypes.data) for array in (a, b, c)))
        return c

    return call


@pytest.mark.quick_rows("8")
@pytest.mark.parametrize("lanes", [1, 4, 8])
def test_every_operation_agrees_with_casadi_in_every_lane(lanes):
    function = ca.Function("f", [x, y], [ca.vertcat(*OPERATIONS.values())])
    call = compiled(function, lanes)
    random = np.random.default_rng(1)
    pairs = [(a, b) for a in ODD for b in ODD] + random.normal(0, 2, (100, 2)).tolist()
    pairs += [(0.3, 0.3)] * (-len(pairs) % lanes)
    table = np.array(pairs).reshape(-1, lanes, 2)
    with np.errstate(all="ignore"):
        for group in table:
            found = call(*(np.ascontiguousarray(column) for column in group.T))
            for lane, (a, b) in enumerate(group):
                expected = np.array(function(a, b)).ravel()
                for name, value, wanted in zip(OPERATIONS, found[:, lane], expected, strict=True):
                    np.testing.assert_allclose(
                        value, wanted, rtol=1e-14, atol=0, err_msg=f"{name} of {a}, {b}"
                    )


def test_a_lane_is_independent_of_its_neighbors():
    lanes = processor_lanes()
    function = ca.Function("f", [x, y], [ca.vertcat(*OPERATIONS.values())])
    call = compiled(function, lanes)
    a, b = np.full(lanes, 0.7), np.full(lanes, 1.9)
    alone = call(a, b)[:, 0]
    for odd in ODD:
        others = np.full(lanes, odd)
        others[0] = 0.7
        np.testing.assert_array_equal(call(others, b)[:, 0], alone)


def test_operation_without_a_vector_form_is_rejected():
    function = ca.Function("f", [x, y], [ca.erfinv(x)])
    with pytest.raises(UsageError, match="no form for SIMD lanes"):
        vector_text(function, "f")


def test_sine_and_cosine_of_an_angle_are_computed_together_with_the_same_bits():
    expressions = [ca.sin(x), ca.cos(x), ca.cos(y), ca.sin(x + y), ca.sin(y), ca.cos(x)]
    function = ca.Function("f", [x, y], [ca.vertcat(*expressions)])
    assert vector_text(function, "f").count("sine_and_cosine(") == 2
    at = np.linspace(-300.0, 300.0, 4 * 50).reshape(50, 4)
    call = compiled(function, 4)
    for row, other in zip(at, at[::-1] ** 3, strict=True):
        expected = np.array(
            [np.array(function(a, b)).ravel() for a, b in zip(row, other, strict=True)]
        ).T
        np.testing.assert_array_equal(call(row, other.copy()), expected)
