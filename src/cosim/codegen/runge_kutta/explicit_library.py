"""Compiled explicit Runge-Kutta solvers around generated equations: `dop853`, `rk4`, `ode8`.

The hand-written part, fmu/solvers, knows no model. The generated part is the right-hand side, its
sizes, and the coefficients of the method as straight-line code. Output times, tolerances and steps
are arguments, so that a change of them needs no compilation.
"""

import ctypes
from functools import cache
from threading import Lock
from typing import Any, NamedTuple

import casadi as ca

from cosim.codegen.c_sources import solver_source
from cosim.codegen.casadi_library import library_around
from cosim.codegen.functions import dense
from cosim.codegen.kernel_library import NO_LAWS, LawText
from cosim.codegen.runge_kutta.stage_sums import dop853_coefficients, numbers, sums
from cosim.codegen.runge_kutta.tableau import Tableau

_sizing = Lock()


class WatchText(NamedTuple):
    """How a solver looks at relations, and goes through events; see fmu/solvers/watch.h.

    Attributes:
        watch: `watch(t, x, z, u, c, dx) -> (arguments, rates, modes, rates of modes)`.
        laws: The laws of the model for the kernel of events.
    """

    watch: ca.Function | None
    laws: LawText


class MethodText(NamedTuple):
    """C text of a method: header in fmu/solvers, "adaptive" or "fixed", and coefficients."""

    steps: str
    coefficients: str


def explicit_library(
    rhs: ca.Function,
    name: str,
    method: MethodText,
    project: ca.Function | None = None,
    events: WatchText | None = None,
) -> str:
    """Return the path of a compiled solver.

    Args:
        rhs: `rhs(t, x, z, u, c) -> (dx/dt, z)`; the argument z is an initial guess of the
            algebraic unknowns.
        method: Its C text: `dop853_method` or `fixed_step_method`.
        project: `project(t, x, u, c) -> (x, change)`, applied after each step; None for no
            projection.
        events: What it watches; None for a smooth model.

    Raises:
        MissingTool: There is no compiler, or it fails.
        UsageError: `rhs` calls a library function whose C code is not available.
    """
    watch, laws = events or WatchText(None, NO_LAWS)
    rhs, *others = map(dense, filter(None, (rhs, project, watch)))
    names = enumerate(("NX", "NZ", "NU", "NC"), start=1)
    sizes = "".join(f"#define {macro} {rhs.numel_in(i)}\n" for i, macro in names)
    after = _solver_text(method, project, watch, laws)
    functions = rhs, *others, *laws.functions
    return library_around(f"explicit {name}", f"{sizes}{laws.sizes}", functions, after)


def explicit_function(
    path: str, points: int, breaks: int = 0, columns: int = 1
) -> tuple[ca.Function, ctypes.CDLL]:
    """Return `run(x0, z0, p, u) -> (xf, zf)` of a compiled solver, and its library.

    Args:
        points: Number of output times; p = (c, points, breaks, columns, relative and absolute
            tolerance, largest step, nominal values of the states, output times, positions of the
            breaks).
        breaks: Number of output times at which a step ends and the method restarts.
        columns: Columns of u: 1, or one for each output time, valid on the interval up to it.
    """
    library = ctypes.CDLL(path)
    with _sizing:  # CasADi reads the sizes while it creates the function
        library.cosim_sizes(*map(ctypes.c_longlong, (points, breaks, columns)))
        return ca.external("run", path), library


def work_space(library: ctypes.CDLL) -> tuple[Any, Any, Any, Any]:
    """Return the work arrays of one caller of `run`: arguments, results, integers, doubles."""
    sizes = [ctypes.c_longlong() for _ in range(4)]
    library.run_work(*map(ctypes.byref, sizes))
    arg, res, integers, doubles = (size.value + 1 for size in sizes)
    return (
        (ctypes.c_void_p * arg)(),
        (ctypes.c_void_p * res)(),
        (ctypes.c_longlong * integers)(),
        (ctypes.c_double * doubles)(),
    )


@cache
def dop853_method() -> MethodText:
    """Return the C text of `dop853`."""
    return MethodText("adaptive", dop853_coefficients().replace('#include "dop853.h"\n', ""))


@cache
def fixed_step_method(tableau: Tableau) -> MethodText:
    """Return the C text of a method with fixed steps."""
    rows = [
        tuple((stage, float(weight)) for stage, weight in enumerate(row, start=1) if weight)
        for row in (*tableau.a, tableau.b)
    ]
    parts = (
        numbers("node", tableau.c),
        sums("stage_sum", rows),
        f"static const Method method = {{{tableau.order}, {len(tableau.b)}, node, stage_sum}};",
    )
    return MethodText("fixed", "\n".join(parts))


def _solver_text(
    method: MethodText, project: ca.Function | None, watch: ca.Function | None, laws: LawText
) -> str:
    """Return the code around the generated functions."""
    others = {"project": project, "watch": watch}
    own = ["rhs", *(name if function else "NULL" for name, function in others.items())]
    calls = ", ".join((*own, f"integrate_{method.steps}"))
    blocks = ["block.h"] if watch and method.steps == "adaptive" else []
    parts = (
        solver_source(f"{method.steps}.h", "external.h", *blocks),
        laws.tables,
        method.coefficients,
        f"static const Solver solver = {{{calls}}};\n",
    )
    return "\n".join(parts)
