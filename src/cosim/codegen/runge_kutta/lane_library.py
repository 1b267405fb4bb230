"""A solver that runs many variants of one model in SIMD lanes, compiled around its equations."""

import ctypes
import hashlib
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from math import log2

import casadi as ca

from casadi_models.dae import Dae
from cosim.codegen.c_sources import solver_source
from cosim.codegen.compiler import cached_library, processor_abilities
from cosim.codegen.initialization import start_function
from cosim.codegen.runge_kutta.lanes import vector_text
from cosim.codegen.runge_kutta.stage_sums import LANES, Names, dop853_sums, numbers
from cosim.errors import UsageError
from cosim.memo import kept_per_thread

RUN_REPORT = 8  # numbers in the report of a run
SIZES = (1, 2, 4, 8)  # numbers of lanes

_NAMES = Names("model_node", "stage_sum", "dense_sum", "error_5", "error_3")
_LONG = ctypes.c_longlong
_ARRAY = ctypes.c_void_p


class Batch(ctypes.Structure):
    """What `lanes_run` is given; see fmu/solvers/lanes_dop853.h."""

    _fields_ = (
        ("runs", _LONG),
        ("points", _LONG),
        *((name, _ARRAY) for name in ("x0", "u", "p", "grid")),
        ("relative", ctypes.c_double),
        ("absolute", ctypes.c_double),
        *((name, _ARRAY) for name in ("out", "report", "next", "stop")),
        ("stop_outside", _LONG),
    )


@dataclass(frozen=True, eq=False)
class LaneLibrary:
    """A compiled solver: `run(Batch)`; `start(runs, t, x, u, p, defect)` calculates starts."""

    lanes: int
    library: ctypes.CDLL


@cache
def processor_lanes() -> int:
    """Return how many doubles this processor takes at once: 8 or 4; 1 where that is not known."""
    abilities = processor_abilities().split()
    return 8 if "avx512f" in abilities else 4 if "avx2" in abilities else 1


@kept_per_thread(16)
def lane_library(dae: Dae, outputs: tuple[str, ...], lanes: int) -> LaneLibrary:
    """Compile a model's equations for lanes, or take them from the cache.

    Args:
        dae: An explicit form: no algebraic unknowns, at least one state.
        outputs: States and outputs to record.
        lanes: One of `SIZES`.

    Raises:
        UsageError: The model has algebraic unknowns, or `lanes` is another number.
        MissingTool: There is no compiler, or it fails.
    """
    if dae.algebraics or not dae.states:
        raise UsageError(f"{dae.full_name}: lanes take explicit forms; use another formulation")
    if lanes not in SIZES:
        raise UsageError(f"lanes = {lanes}; give one of {', '.join(map(str, SIZES))}")
    text = _library_source(dae, outputs, lanes)
    key = "lanes " + hashlib.sha256(text.encode()).hexdigest()
    library = ctypes.CDLL(str(cached_library(key, lambda: text)))
    if found := _elementary(lanes):
        library.lanes_use(*found)
    library.lanes_run.argtypes = [ctypes.POINTER(Batch)]
    library.lanes_start.argtypes = [_LONG, ctypes.c_double, *[_ARRAY] * 4]
    return LaneLibrary(lanes, library)


class Watched(ctypes.Structure):
    """What `lanes_outputs` is given; see fmu/solvers/lanes_outputs.h."""

    _fields_ = (
        ("points", _LONG),
        ("columns", _LONG),
        *((name, _ARRAY) for name in ("t", "x", "u", "p")),
        ("recorded", _LONG),
        *((name, _ARRAY) for name in ("places", "rows", "first", "margins")),
    )


@kept_per_thread(16)
def lane_outputs(dae: Dae, lanes: int, *, limits_only: bool = False) -> ctypes.CDLL:
    """Compile `lanes_outputs(Watched)`, or take it from the cache.

    Args:
        dae: Without algebraic unknowns.
        lanes: One of `SIZES`.
        limits_only: Whether to leave out the outputs, which then nobody can record.

    Raises:
        UsageError: An output has an operation that lanes do not have.
        MissingTool: There is no compiler, or it fails.
    """
    shown = ca.SX(0, 1) if limits_only else dae.outputs
    rows = ca.vertcat(ca.SX(0, 1), shown, dae.margins)
    (every,), symbols, values = ca.extract_parametric([rows], dae.p)
    c = ca.vertcat(ca.SX(0, 1), dae.p, *symbols)
    cse = {"cse": True}
    constants = ca.Function("f", [dae.p], [ca.densify(ca.vertcat(dae.p, *values))], cse)
    observe = ca.Function("f", [dae.t, dae.x, dae.u, c], [ca.densify(every)], cse)
    sizes = {"LANES": lanes, "NX": dae.x.numel(), "NU": dae.u.numel(), "NP": dae.p.numel()}
    sizes |= {"NC": c.numel(), "NY": shown.numel(), "NL": len(dae.limits)}
    text = "\n".join(
        (
            *(f"#define {name} {size}" for name, size in sizes.items()),
            solver_source("lanes_outputs.h"),
            vector_text(constants, "constants"),
            vector_text(observe, "observe"),
            "static const LaneOutputs outputs = {constants, observe};\n",
        )
    )
    key = "outputs " + hashlib.sha256(text.encode()).hexdigest()
    library = ctypes.CDLL(str(cached_library(key, lambda: text)))
    library.lanes_outputs.argtypes = [ctypes.POINTER(Watched)]
    library.lanes_outputs.restype = None
    return library


def _library_source(dae: Dae, outputs: Sequence[str], lanes: int) -> str:
    known = dict(zip((v.name for v in dae.states), ca.vertsplit(dae.x), strict=True))
    rows = zip((v.name for v in dae.output_variables), ca.vertsplit(dae.outputs), strict=True)
    known |= dict(rows)
    wanted = ca.vertcat(ca.SX(0, 1), *(known[name] for name in outputs))
    observed = ca.vertcat(wanted, dae.margins)
    sparsity = ca.jacobian_sparsity(observed, dae.x)
    _, columns = sparsity.get_triplet()
    needed = sorted(set(columns))
    every, symbols, values = ca.extract_parametric(ca.vertcat(dae.ode, observed), dae.p)
    nx, ny = dae.x.numel(), wanted.numel()
    c = ca.vertcat(ca.SX(0, 1), dae.p, *symbols)
    kept = dae.x[needed] if needed else ca.SX(0, 1)
    cse = {"cse": True}
    functions = {
        "constants": ca.Function("f", [dae.p], [ca.densify(ca.vertcat(dae.p, *values))], cse),
        "rhs": ca.Function("f", [dae.t, dae.x, dae.u, c], [ca.densify(every[:nx])], cse),
        "observe": ca.Function(
            "f",
            [dae.t, kept, dae.u, c],
            [ca.densify(every[nx : nx + ny]), ca.densify(every[nx + ny :])],
            cse,
        ),
    }
    sizes = {"NX": nx, "NU": dae.u.numel(), "NP": dae.p.numel(), "NC": c.numel()}
    sizes |= {"NN": len(needed), "NY": ny, "NL": len(dae.limits)}
    places = ", ".join(map(str, needed)) or "0"
    return "\n".join(
        (
            _start_text(dae),
            f"#define LANES {lanes}",
            *(f"#define {name} {size}" for name, size in sizes.items()),
            solver_source("lanes_dop853.h"),
            f"static const int model_needed[] = {{{places}}};",
            *(vector_text(function, name) for name, function in functions.items()),
            numbers("model_nominal", [2.0 ** round(log2(v.nominal)) for v in dae.states]),
            dop853_sums(_NAMES, LANES),
            "static const LaneModel model = {",
            "    constants, rhs, observe, model_needed, model_nominal,",
            f"    {', '.join(_NAMES)}",
            "};",
        )
    )


def _start_text(dae: Dae) -> str:
    """Return `lanes_start`: the calculated start values of every run, and what they leave."""
    function = start_function(dae)
    generator = ca.CodeGenerator("start", {"with_header": False})
    generator.add(function)
    arg, res, iw, w = (getattr(function, f"sz_{size}")() + 1 for size in ("arg", "res", "iw", "w"))
    nx, nu, np = (symbol.numel() for symbol in (dae.x, dae.u, dae.p))
    return f"""{generator.dump()}
CASADI_SYMBOL_EXPORT void lanes_start(long long runs, double t, double *x, const double *u,
                                      const double *p, double *defect) {{
    const double *arg[{arg}];
    double *res[{res}], w[{w}], solved[{nx}];
    casadi_int iw[{iw}];
    for (long long run = 0; run < runs; ++run, x += {nx}, u += {nu}, p += {np}) {{
        arg[0] = &t;
        arg[1] = x;
        arg[2] = u;
        arg[3] = p;
        res[0] = solved;
        res[1] = defect + run;
        if (model_start(arg, res, iw, w, 0)) defect[run] = 1;
        for (int i = 0; i < {nx}; ++i) x[i] = solved[i];
    }}
}}"""


@cache
def _elementary(lanes: int) -> tuple[ctypes.c_void_p, ctypes.c_void_p] | None:
    """Return sine and cosine of vectors from glibc's libmvec, where the machine has them."""
    kind = {2: "b", 4: "d", 8: "e"}.get(lanes)
    if kind is None or platform.machine() != "x86_64" or platform.system() != "Linux":
        return None
    if lanes > processor_lanes():
        return None  # AVX code would end the process
    try:
        library = ctypes.CDLL("libmvec.so.1")
        sine, cosine = (getattr(library, f"_ZGV{kind}N{lanes}v_{name}") for name in ("sin", "cos"))
    except (OSError, AttributeError):
        return None
    return ctypes.cast(sine, ctypes.c_void_p), ctypes.cast(cosine, ctypes.c_void_p)
