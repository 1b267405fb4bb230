"""Sine and cosine of the runtime against mpmath."""

import ctypes

import mpmath
import numpy as np
import pytest
from helpers.harness import RUNTIME, STRICT, compiler, run

pytestmark = pytest.mark.skipif(compiler() is None, reason="needs a C compiler")

CALLS = """\
#include "sine.h"
double s(double x) { return sin(x); }
double c(double x) { return cos(x); }
"""


@pytest.fixture(scope="module")
def functions(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sine")
    (folder / "sine.c").write_text(CALLS)
    target = folder / "sine.so"
    flags = [*STRICT, "-O2", "-shared", "-fPIC", f"-I{RUNTIME}"]
    run([compiler(), *flags, folder / "sine.c", "-o", target, "-lm"])
    library = ctypes.CDLL(str(target))
    for function in (library.s, library.c):
        function.restype, function.argtypes = ctypes.c_double, [ctypes.c_double]
    return library


def test_sine_and_cosine_are_off_by_less_than_one_unit_in_the_last_place(functions):
    random = np.random.default_rng(1)
    quarters = [np.nextafter(k * np.pi / 2, side) for k in range(-40, 41) for side in (-99, 99)]
    angles = [*random.uniform(-1, 1, 2000), *random.uniform(-1e6, 1e6, 2000), *quarters, 355.0]
    worst = 0.0
    with mpmath.workdps(60):
        for x in map(float, angles):
            for own, exact in ((functions.s, mpmath.sin(x)), (functions.c, mpmath.cos(x))):
                worst = max(worst, abs(float((own(x) - exact) / np.spacing(abs(float(exact))))))
    assert worst < 0.8  # measured 0.76


def test_special_arguments_are_those_of_the_c_library(functions):
    for own, known in ((functions.s, np.sin), (functions.c, np.cos)):
        for x in (0.0, -0.0, 5e-324, 1e-300, 1e6, -1e22):
            assert str(own(x)) == str(float(known(x)))
        with np.errstate(invalid="ignore"):
            assert all(np.isnan(own(x)) for x in (np.inf, -np.inf, np.nan))
