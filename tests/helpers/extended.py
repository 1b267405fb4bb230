"""Fixed-step methods in 80-bit arithmetic, where rounding hides the order 2000 times later."""

import ctypes
import subprocess
from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_models.dae import Dae
from cosim.codegen.compiler import find_compiler
from cosim.codegen.runge_kutta.tableau import Tableau
from cosim.integrate.integrator import start_vectors

Long = np.longdouble
Vector = NDArray[np.longdouble]


def has_extended_precision() -> bool:
    """Tell whether the machine's long double has the 64 bits of x87."""
    return np.finfo(Long).nmant >= 63


def right_hand_side(dae: Dae, folder: Path) -> Callable[[Long, Vector], Vector]:
    """Return dx/dt = f(t, x) of a model with its own numbers, compiled for long double."""
    start = start_vectors(dae)
    numbers = ca.DM([*start["u"], *start["p"]])
    ode = ca.substitute(dae.ode, ca.vertcat(dae.u, dae.p), numbers)
    function = ca.Function("f", [dae.t, dae.x], [ode], {"cse": True})
    generator = ca.CodeGenerator("f", {"casadi_real": "long double", "with_header": False})
    generator.add(function)
    source, library = folder / "f.c", folder / "f.so"
    source.write_text(generator.dump().replace("<math.h>", "<tgmath.h>"))  # sinl for sin
    command = [*find_compiler(), "-O1", "-shared", "-fPIC", source, "-o", library, "-lm"]
    subprocess.run(command, check=True)
    call = ctypes.CDLL(str(library)).f
    work = np.zeros(max(1, function.sz_w()), Long)
    pointers = ctypes.c_void_p * max(2, function.sz_arg(), function.sz_res())

    def f(t: Long, x: Vector) -> Vector:
        time, slope = np.array([t], Long), np.empty(len(x), Long)
        arguments = pointers(time.ctypes.data, x.ctypes.data)
        results, memory = pointers(slope.ctypes.data), ctypes.c_void_p(work.ctypes.data)
        assert not call(arguments, results, None, memory, 0)
        return slope

    return f


def final_state(
    f: Callable[[Long, Vector], Vector], x: Vector, method: Tableau, stop: float, steps: int
) -> Vector:
    """Return the state at the stop time after so many equal steps."""
    a, b = [_long(row) for row in method.a], _long(method.b)
    c, h = [row.sum() for row in a], Long(stop) / steps
    slopes = np.zeros((len(b), len(x)), Long)
    for number in range(steps):
        for i, row in enumerate(a):
            slopes[i] = f(number * h + c[i] * h, x + h * (row @ slopes[: len(row)]))
        x = x + h * (b @ slopes)
    return x


def _long(row: Sequence[Fraction | int]) -> Vector:
    return np.array([Long(w.numerator) / Long(w.denominator) for w in row], Long)
