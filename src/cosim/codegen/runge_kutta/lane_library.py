"""Compiled solver that runs many variants of one model in SIMD lanes."""

import ctypes
import platform
from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import casadi as ca

from casadi_models.dae import Dae
from casadi_models.dae.expressions import operations
from casadi_models.dae.time_bounds import limit_enclosures
from cosim.codegen.c_fields import fields
from cosim.codegen.c_sources import solver_source
from cosim.codegen.casadi_library import generated_with_sizes
from cosim.codegen.compiler import cached_library, processor_abilities
from cosim.codegen.functions import hoisted_rows
from cosim.codegen.initialization import start_function
from cosim.codegen.runge_kutta.lanes import LANE_OPERATIONS, vector_text
from cosim.codegen.runge_kutta.stage_sums import LANES, NAMES, dop853_sums
from cosim.errors import UsageError
from cosim.memo import cached_per_thread, digest_of

SIZES = (1, 2, 4, 8)  # possible numbers of lanes

_LONG = ctypes.c_longlong
_ARRAY = ctypes.c_void_p


class Batch(ctypes.Structure):
    """Argument of `lanes_run`; see fmu/solvers/lanes_dop853.h."""

    _fields_ = fields("solvers/lanes_dop853.h", "Batch")


@cache
def processor_lanes() -> int:
    """Return the number of doubles in a vector register: 8 or 4; 1 if it is unknown."""
    abilities = processor_abilities().split()
    return 8 if "avx512f" in abilities else 4 if "avx2" in abilities else 1


@cached_per_thread(16)
def lane_library(dae: Dae, outputs: tuple[str, ...], lanes: int) -> ctypes.CDLL:
    """Return the compiled solver of a model for SIMD lanes, from the cache if possible.

    Its `lanes_run(Batch)` integrates, and its `lanes_start` solves initial values.

    Raises:
        UsageError: The model has algebraic unknowns, or `lanes` is not in `SIZES`.
        MissingTool: There is no compiler, or it fails.
    """
    if dae.algebraics or not dae.states:
        raise UsageError(
            f"{dae.full_name}: SIMD lanes need an explicit ODE; use another formulation"
        )
    if lanes not in SIZES:
        raise UsageError(f"lanes = {lanes}; give one of {', '.join(map(str, SIZES))}")
    library = _compiled("lanes", _library_source(dae, outputs, lanes))
    if found := _elementary(lanes):
        library.lanes_use(*found)
    library.lanes_run.argtypes = [ctypes.POINTER(Batch)]
    library.lanes_start.argtypes = [_LONG, ctypes.c_double, *[_ARRAY] * 4]
    return library


class Watched(ctypes.Structure):
    """Argument of `lanes_outputs`; see fmu/solvers/lanes_outputs.h."""

    _fields_ = fields("solvers/lanes_outputs.h", "Watched")


@cached_per_thread(16)
def lane_outputs(dae: Dae, lanes: int, *, limits_only: bool = False) -> ctypes.CDLL:
    """Return the library with `lanes_outputs(Watched)`, from the cache if possible.

    Args:
        limits_only: Whether to evaluate the validity conditions only, without the outputs.

    Raises:
        UsageError: An output has an operation without a vector form.
        MissingTool: There is no compiler, or it fails.
    """
    shown = ca.SX(0, 1) if limits_only else dae.outputs
    rows = ca.vertcat(ca.SX(0, 1), shown, dae.margins)
    every, c, constants = hoisted_rows(dae, rows)
    observe = ca.Function("f", [dae.t, dae.x, dae.u, c], [ca.densify(every)], _CSE)
    sizes = {"LANES": lanes, "NX": dae.x.numel(), "NU": dae.u.numel(), "NP": dae.p.numel()}
    sizes |= {"NC": c.numel(), "NY": shown.numel(), "NL": len(dae.limits)}
    text = (
        *(f"#define {name} {size}" for name, size in sizes.items()),
        solver_source("lanes_outputs.h"),
        vector_text(constants, "constants"),
        vector_text(observe, "observe"),
        "static const LaneOutputs outputs = {constants, observe};\n",
    )
    library = _compiled("outputs", "\n".join(text))
    library.lanes_outputs.argtypes = [ctypes.POINTER(Watched)]
    library.lanes_outputs.restype = None
    return library


_CSE = {"cse": True}


def _compiled(kind: str, text: str) -> ctypes.CDLL:
    """Return the library of C code, from the cache if possible."""
    key = f"{kind} {digest_of([text.encode()])}"
    return ctypes.CDLL(str(cached_library(key, lambda: text)))


def _library_source(dae: Dae, outputs: Sequence[str], lanes: int) -> str:
    known = dict(zip((v.name for v in dae.states), ca.vertsplit(dae.x), strict=True))
    known |= zip((v.name for v in dae.output_variables), ca.vertsplit(dae.outputs), strict=True)
    recorded = ca.vertcat(ca.SX(0, 1), *(known[name] for name in outputs))
    observed = ca.vertcat(recorded, dae.margins)
    sparsity = ca.jacobian_sparsity(observed, dae.x)
    _, columns = sparsity.get_triplet()
    needed = sorted(set(columns))
    limits = _lane_bounds(dae, needed)
    rows = ca.vertcat(dae.ode, observed, limits.low, *limits.rates)
    every, c, constants = hoisted_rows(dae, rows)
    nx, ny, nb = dae.x.numel(), recorded.numel(), limits.low.numel()
    read = dae.x[needed] if needed else ca.SX(0, 1)
    functions = {
        "constants": constants,
        "rhs": ca.Function("f", [dae.t, dae.x, dae.u, c], [ca.densify(every[:nx])], _CSE),
        "observe": ca.Function(
            "f",
            [dae.t, read, dae.u, c],
            [ca.densify(every[nx : nx + ny])],
            _CSE,
        ),
    }
    if dae.limits:
        first = nx + ny + len(dae.limits)
        margins = ca.densify(every[nx + ny : first])
        functions["margins"] = ca.Function("f", [dae.t, read, dae.u, c], [margins], _CSE)
        low, *rates = (ca.densify(every[first + i * nb : first + (i + 1) * nb]) for i in range(3))
        given = [dae.t, *limits.given, dae.u, c]
        functions["bounds"] = ca.Function("f", given, [low], _CSE)
        functions["rates"] = ca.Function("f", given, rates, _CSE)
    sizes = {"NX": nx, "NU": dae.u.numel(), "NP": dae.p.numel(), "NC": c.numel()}
    sizes |= {"NN": len(needed), "NY": ny, "NL": len(dae.limits), "NB": nb, "MODES": 0}
    sizes["LIMITS_OF_TIME"] = int(limits.of_time)
    tables = {"needed": needed, "bounded": limits.positions, "moving": limits.moving}
    numbers = {name: ", ".join(map(str, (*own, -1))) for name, own in tables.items()}
    of_limits = ("margins", "bounds", "rates")
    return "\n".join(
        (
            generated_with_sizes("start", start_function(dae)),  # for lanes_start.h
            f"#define LANES {lanes}",
            *(f"#define {name} {size}" for name, size in sizes.items()),
            solver_source("lanes_start.h"),
            solver_source("lanes_dop853.h"),
            *(f"static const int model_{name}[] = {{{own}}};" for name, own in numbers.items()),
            *(vector_text(function, name) for name, function in functions.items()),
            dop853_sums(LANES),
            "static const LaneModel model = {",
            f"    constants, rhs, observe, {', '.join(of_limits if dae.limits else ['NULL'] * 3)},",
            f"    model_bounded, model_moving, model_needed, {', '.join(NAMES)}",
            "};",
        )
    )


class _LaneBounds(NamedTuple):
    """Bounds of the margins of limits over a part of a step of a lane, whose inputs rest.

    Attributes:
        positions: Positions of the limits that have bounds.
        moving: Positions, among the states that are needed, of those that move the bounds.
        of_time: Whether time moves them.
        given: Symbols of the length of the part, s; of the least and greatest values of the states
            that are needed, and of their least and greatest rates.
        low: Lower bounds of the margins.
        rates: Lower and upper bounds of their rates.
    """

    positions: tuple[int, ...]
    moving: list[int]
    of_time: bool
    given: list[ca.SX]
    low: ca.SX
    rates: tuple[ca.SX, ca.SX]


def _lane_bounds(dae: Dae, needed: Sequence[int]) -> _LaneBounds:
    part = limit_enclosures(dae)
    names = ("low", "high", "slowest", "fastest")
    given = [ca.SX.sym(name, len(needed)) for name in names]
    spans = [
        ca.vertcat(ca.SX.zeros(dae.x.numel()), u) for u in (dae.u, dae.u, 0 * dae.u, 0 * dae.u)
    ]
    for span, own in zip(spans, given, strict=True):
        for i, symbol in zip(needed, ca.vertsplit(own), strict=True):
            span[i] = symbol
    every = ca.vertcat(part.low, part.high)
    every = ca.substitute(every, ca.vertcat(*part.given[1:]), ca.vertcat(*spans))
    low, high = ca.vertsplit(every, part.low.numel()) if part.relations else (every, every)
    if not operations(every) <= LANE_OPERATIONS:
        low = high = ca.SX(0, 1)
    moving = [needed.index(i) for i in part.moving if i < dae.x.numel()]
    known = part.relations if low.numel() else ()
    return _LaneBounds(
        known, moving, part.of_time, [part.given[0], *given], low[::2], (low[1::2], high[1::2])
    )


@cache
def _elementary(lanes: int) -> tuple[ctypes.c_void_p, ctypes.c_void_p] | None:
    """Return vector sine and cosine of glibc's libmvec; None if the machine has none."""
    kind = {2: "b", 4: "d", 8: "e"}.get(lanes)
    if kind is None or platform.machine() != "x86_64" or platform.system() != "Linux":
        return None
    if lanes > processor_lanes():
        return None  # an unsupported instruction would end the process
    try:
        library = ctypes.CDLL("libmvec.so.1")
        sine, cosine = (getattr(library, f"_ZGV{kind}N{lanes}v_{name}") for name in ("sin", "cos"))
    except (OSError, AttributeError):
        return None
    return ctypes.cast(sine, ctypes.c_void_p), ctypes.cast(cosine, ctypes.c_void_p)
