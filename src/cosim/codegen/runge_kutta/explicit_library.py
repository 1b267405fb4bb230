"""Explicit Runge-Kutta methods in C around generated equations: `dop853`, `rk4`, `ode8`.

The hand-written part, fmu/solvers, knows no model. The generated part is the right-hand side, its
sizes, and the coefficients of the method as straight-line code. Output times, tolerances and steps
are arguments, so that nothing is compiled anew when they change.
"""

import ctypes
from threading import Lock
from typing import Any, NamedTuple

import casadi as ca

from cosim.codegen.c_sources import solver_source
from cosim.codegen.casadi_library import cache_key
from cosim.codegen.compiler import cached_library
from cosim.codegen.externals import sources_beside
from cosim.codegen.runge_kutta.stage_sums import dop853_coefficients, numbers, sums
from cosim.codegen.runge_kutta.tableau import Tableau

_sizing = Lock()


class MethodText(NamedTuple):
    """A method in C: which of fmu/solvers steps, "adaptive" or "fixed", and its coefficients."""

    steps: str
    coefficients: str


def explicit_library(
    rhs: ca.Function, name: str, method: MethodText, project: ca.Function | None = None
) -> str:
    """Return the path of a compiled solver.

    Args:
        rhs: `rhs(t, x, z, u, c) -> (dx/dt, z)`; z is a guess of the algebraic unknowns.
        name: Of the method.
        method: Its C text: `dop853_method` or `fixed_step_method`.
        project: `project(t, x, u, c) -> (x, change)`, applied after each step, or None.

    Raises:
        MissingTool: There is no compiler, or it fails.
        UsageError: `rhs` calls a library's function whose C code is not at hand.
    """
    sizes = zip(("NX", "NZ", "NU", "NC"), (rhs.numel_in(i) for i in range(1, 5)), strict=True)
    before = "".join(f"#define {macro} {size}\n" for macro, size in sizes)
    after = _solver_text(method, project)

    def generate() -> str:
        generator = ca.CodeGenerator("equations", {"with_header": False})
        generator.add(rhs)
        if project is not None:
            generator.add(project)
        return f"{before}{generator.dump()}\n{after}"

    details = before + after + ("" if project is None else project.serialize())
    key = cache_key(f"explicit {name}", rhs, details.encode())
    functions = [rhs] if project is None else [rhs, project]
    return str(cached_library(key, generate, sources_beside(*functions)))


def explicit_function(
    path: str, points: int, breaks: int = 0, columns: int = 1
) -> tuple[ca.Function, ctypes.CDLL]:
    """Return `run(x0, z0, p, u) -> (xf, zf)` of a compiled solver, and its library.

    Args:
        path: Of the library.
        points: Number of output times; p = (c, points, breaks, columns, relative and absolute
            tolerance, largest step, nominal values of the states, output times, positions of the
            breaks).
        breaks: Number of output times at which a step ends and a fresh one begins.
        columns: Of u: 1, or one per output time that holds on the way there.
    """
    library = ctypes.CDLL(path)
    with _sizing:  # CasADi reads the sizes while it makes the function
        library.cosim_sizes(*map(ctypes.c_longlong, (points, breaks, columns)))
        return ca.external("run", path), library


def work_space(library: ctypes.CDLL) -> tuple[Any, Any, Any, Any]:
    """Return arrays of arguments, results, integers and doubles for one caller of `run`."""
    sizes = [ctypes.c_longlong() for _ in range(4)]
    library.run_work(*map(ctypes.byref, sizes))
    arg, res, integers, doubles = (size.value + 1 for size in sizes)
    return (
        (ctypes.c_void_p * arg)(),
        (ctypes.c_void_p * res)(),
        (ctypes.c_longlong * integers)(),
        (ctypes.c_double * doubles)(),
    )


def dop853_method() -> MethodText:
    """Return the C text of `dop853`."""
    return MethodText("adaptive", dop853_coefficients().replace('#include "dop853.h"\n', ""))


def fixed_step_method(tableau: Tableau) -> MethodText:
    """Return the C text of a method with fixed steps."""
    rows = [
        tuple((stage, float(weight)) for stage, weight in enumerate(row, start=1) if weight)
        for row in (*tableau.a, tableau.b)
    ]
    parts = (
        numbers("node", tableau.c),
        sums("stage_sum", rows),
        f"static const Method method = {{{len(tableau.b)}, node, stage_sum}};",
    )
    return MethodText("fixed", "\n".join(parts))


def _solver_text(method: MethodText, project: ca.Function | None = None) -> str:
    """Return the code around the generated functions `rhs` and, where it is given, `project`."""
    own, work = ("NULL", "NULL") if project is None else ("project", "project_work")
    calls = f"rhs, {own}, rhs_work, {work}, integrate_{method.steps}"
    parts = (
        solver_source(f"{method.steps}.h", "external.h"),
        method.coefficients,
        f"static const Solver solver = {{{calls}}};\n",
    )
    return "\n".join(parts)
