"""A solver over a grid of output times, ready to be called.

`cvodes`, `idas`: SUNDIALS through CasADi; compiled, their equations come from a shared library.
`erk`, `rosenbrock`: CasADi's own; compiled, the whole integration is one C function.
`dop853`, `rk4`, `ode8`: explicit methods in C around generated equations; the latter two without
a compiler, too.
"""

import ctypes
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from casadi import MX

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.codegen.casadi_library import cache_key, external
from cosim.codegen.casadi_patches import REPORT, in_one_piece, run_time_tolerances, watched
from cosim.codegen.compiler import cached_library, find_compiler
from cosim.codegen.initialization import algebraic_function
from cosim.codegen.projection import projection_step
from cosim.codegen.tableau import METHODS, step_function
from cosim.errors import ParameterError, UsageError
from cosim.integrate.explicit import explicit_function, explicit_library
from cosim.integrate.solvers import SOLVERS, Method, Tolerance, method
from cosim.memo import kept_per_thread
from cosim.model.inputs import InputSeries
from cosim.model.values import number

PROJECTING = ("dop853", "ode8", "rk4")  # solvers that can end a step elsewhere than it led to
MOST_STEPS = 2_000_000  # of fixed size; CasADi unrolls them
_CALL = ["t", "x", "z", "u", "p"]


@dataclass(frozen=True)
class Engine:
    """An integrator over a grid, ready to be called.

    Attributes:
        function: `(x0, z0, p, u, ...) -> (xf, zf, ...)`, one column per output time.
        parameters: `p -> p` of `function`, which may take more; None where it takes the model's.
        repeat_u: Whether `u` has one column per output time.
        stats: Reads what the thread's last call took; `cause` says why it failed.
        compiled: Whether the equations are machine code.
        library: What runs as one C function and takes over Ctrl-C (fmu/solvers/interrupt.c); None
            where CasADi sees to that.
    """

    function: ca.Function
    parameters: ca.Function | None
    repeat_u: bool
    stats: Callable[[], dict[str, Any]]
    compiled: bool
    library: ctypes.CDLL | None = None


def build(
    dae: Dae,
    grid: Vector,
    solver: str | None = None,
    tolerance: Tolerance | None = None,
    *,
    step_size: float | None = None,
    inputs: InputSeries | None = None,
    compiled: bool = False,
    sensitivities: bool = True,
    project: bool = False,
    slopes: Vector | None = None,
) -> Engine:
    """Return the engine of a solver for a grid of at least two increasing times.

    An adaptive solver takes no step longer than the shortest interval of an input series. IDAS
    starts from `slopes`, consistent dx/dt at the start, or looks for them itself when None. With
    `project`, every step ends where the model's invariants vanish.

    Raises:
        UnknownName, UsageError: See `method`; or the solver does not take what is given.
        ParameterError: The step size is not positive, or makes too many steps.
        MissingTool: It shall be compiled, and no compiler works.
    """
    name, _ = method(dae, solver)
    if step_size is not None:
        step_size = number("solver", "step_size", step_size, positive=True)
    if project and not (name in PROJECTING and compiled):
        raise UsageError(
            f"{name} does not project its steps; {', '.join(PROJECTING)} do, compiled: use one of "
            "them, or another drift control"
        )
    accuracy = tolerance or Tolerance()
    settings = (name, accuracy, step_size, inputs, compiled, sensitivities, project)
    if slopes is None:
        return _kept(dae, grid.tobytes(), settings)
    return _build(dae, grid, settings, slopes)


_Settings = tuple[str, Tolerance, float | None, InputSeries | None, bool, bool, bool]


@kept_per_thread(8)
def _kept(dae: Dae, grid: bytes, settings: _Settings) -> Engine:
    return _build(dae, np.frombuffer(grid), settings, None)


def _build(dae: Dae, grid: Vector, settings: _Settings, slopes: Vector | None) -> Engine:
    name, accuracy, step_size, inputs, compiled, sensitivities, project = settings
    chosen = SOLVERS[name]
    if not chosen.adaptive:
        if accuracy.absolute is not None:
            raise UsageError(f"{name} has no error control; leave absolute_tolerance out")
        return _fixed_step(dae, grid, name, step_size, inputs, compiled, project)
    if step_size is not None:
        raise UsageError(f"{name} chooses its own steps; leave step_size out or use rk4 or ode8")
    if name == "dop853":
        if not compiled:
            find_compiler()  # says what is missing
            raise UsageError("dop853 exists as compiled code only; use erk for interpreted runs")
        longest = np.inf if inputs is None else float(np.diff(inputs.time).min())
        return _explicit(dae, grid, name, (*accuracy.pair, longest), inputs, project)
    if compiled and chosen.plugin in ("erk", "rosenbrock"):
        return _generated(dae, grid, chosen, accuracy, inputs)
    function = equations(dae, sensitivities=sensitivities)
    start = {} if slopes is None else {"calc_ic": False, "init_xdot": slopes.tolist()}
    chosen = replace(chosen, options={**chosen.options, **start})
    return _interpreted(dae, grid, chosen, accuracy, inputs, function, compiled)


@kept_per_thread(16)
def equations(dae: Dae, *, sensitivities: bool = True) -> ca.Function:
    """Return `dae(t, x, z, u, p) -> (ode, alg)`.

    Without `sensitivities` it has derivatives with respect to x and z only, which is all that an
    integration needs: a third to a half of the code.
    """
    return _function(dae, dae.p, dae.ode, dae.alg, sensitivities)


@kept_per_thread(16)
def _prepared(dae: Dae) -> tuple[ca.Function, ca.Function]:
    """Return `dae(t, x, z, u, c) -> (ode, alg)` and `p -> c`.

    c are the parameters and all that depends on nothing else: calculated once, not in every step.
    """
    rows, symbols, values = ca.extract_parametric(ca.vertcat(dae.ode, dae.alg), dae.p)
    nx = dae.x.numel()
    c = ca.vertcat(dae.p, *symbols)
    function = _function(dae, c, rows[:nx], rows[nx:], sensitivities=False)
    return function, ca.Function("constants", [dae.p], [ca.vertcat(dae.p, *values)], {"cse": True})


def _function(dae: Dae, p: ca.SX, ode: ca.SX, alg: ca.SX, sensitivities: bool) -> ca.Function:
    options: dict[str, Any] = {"cse": True}
    if not sensitivities:
        options["is_diff_in"] = [False, True, True, False, False]
    symbols = [dae.t, dae.x, dae.z, dae.u, p]
    return ca.Function("dae", symbols, [ode, alg], _CALL, ["ode", "alg"], options)


def driven(dae: Dae, inputs: InputSeries | None, t: MX, u: MX) -> MX:
    """Return the inputs at a time: those of the series, and the constants for the others."""
    if inputs is None:
        return u
    clipped = ca.fmin(ca.fmax(t, inputs.time[0]), inputs.time[-1])
    rows = ca.vertsplit(u)
    for i, variable in enumerate(dae.inputs):
        if variable.name in inputs.names:
            samples = inputs.values[:, inputs.names.index(variable.name)]
            rows[i] = ca.interpolant("signal", "linear", [inputs.time], samples)(clipped)
    return ca.vertcat(*rows)


def _interpreted(
    dae: Dae,
    grid: Vector,
    chosen: Method,
    tolerance: Tolerance,
    inputs: InputSeries | None,
    function: ca.Function,
    compiled: bool,
) -> Engine:
    """CasADi's integrator; only its equations are machine code where `compiled`."""
    if compiled:
        (function,) = external(
            [function, function.jacobian()], cache_key("sundials", function), ["dae"]
        )
    if compiled or inputs is not None:
        t, x, z, u, p = symbols = _symbols(function)
        ode, alg = function(t, x, z, driven(dae, inputs, t, u), p)
        problem: dict[str, Any] = dict(zip(_CALL, symbols, strict=True))
        problem |= {"ode": ode, "alg": alg}
    else:
        problem = dict(zip(_CALL, (dae.t, dae.x, dae.z, dae.u, dae.p), strict=True))
        problem |= {"ode": dae.ode, "alg": dae.alg}
    grouped = chosen.plugin in ("erk", "rosenbrock")
    options = dict(chosen.options) | dict(zip(("reltol", "abstol"), tolerance.pair, strict=True))
    if inputs is not None:
        options["max_step_size"] = float(np.diff(inputs.time).min())
    if grouped:
        options["control_group_size"] = [len(grid)]
    if chosen.plugin == "cvodes":  # whose steps may shrink until h^2 is 0, and then it goes astray
        options["min_step_size"] = 1e-18 * float(grid[-1] - grid[0])
    run = ca.integrator("run", chosen.plugin, problem, grid[0], list(grid), options)

    def stats() -> dict[str, Any]:
        raw = run.stats(1)  # the memory that `Function.buffer` takes; 0 belongs to plain calls
        if grouped:
            keys = {"n_steps": "steps", "n_rhs": "rhs_calls", "n_jac": "jacobian_calls"}
        else:
            keys = {"nsteps": "steps", "nfevals": "rhs_calls", "nlinsetups": "jacobian_calls"}
        return {name: int(raw[key]) for key, name in keys.items() if key in raw}

    return Engine(run, None, not grouped, stats, compiled)


def _generated(
    dae: Dae, grid: Vector, chosen: Method, tolerance: Tolerance, inputs: InputSeries | None
) -> Engine:
    """CasADi's generated integrator on the unit interval; span and tolerances come with `p`."""
    start, length = grid[0], grid[-1] - grid[0]
    unit_grid = _unit_grid(grid)
    function, constants = _prepared(dae)
    s, x, z, u, c = _symbols(function)
    span = MX.sym("span", 4)  # start, length, relative and absolute tolerance
    t = span[0] + span[1] * s
    ode, alg = function(t, x, z, driven(dae, inputs, t, u), c)
    symbols = [s, x, z, u, ca.vertcat(c, span)]
    problem = dict(zip(_CALL, symbols, strict=True)) | {"ode": span[1] * ode, "alg": alg}
    options = dict(chosen.options) | {"control_group_size": [len(grid)]}
    if inputs is not None:
        options["max_step_size"] = float(np.diff(inputs.time).min() / length)
    original = ca.Function("driven", symbols, [problem["ode"], alg])

    def generate() -> str:
        run = ca.integrator("run", chosen.plugin, problem, 0.0, list(unit_grid), options)
        generator = ca.CodeGenerator("code", {"with_header": False})
        generator.add(run)
        first = c.numel() + 2
        code = run_time_tolerances(
            str(generator.dump()), f"arg[2][{first}]", f"arg[2][{first + 1}]"
        )
        code = watched(code)
        return in_one_piece(code) if chosen.plugin == "erk" else code

    details = (unit_grid.tobytes(), repr(sorted(options.items())).encode())
    path = str(
        cached_library(cache_key(f"generated-6 {chosen.plugin}", original, *details), generate)
    )
    p = MX.sym("p", dae.p.numel())
    extended = ca.vertcat(constants(p), start, length, *tolerance.pair)
    library = ctypes.CDLL(path)
    parameters = ca.Function("parameters", [p], [extended])
    run = ca.external("run", path)
    stats = _statistics(library, start, length)
    return Engine(run, parameters, False, stats, True, library)


def _statistics(library: ctypes.CDLL, start: float, length: float) -> Callable[[], dict[str, Any]]:
    """Return what reads the report of a library, whose time is start + length * its own."""
    numbers = (ctypes.c_double * REPORT)()

    def stats() -> dict[str, Any]:
        library.cosim_report(numbers)
        steps, rhs, jacobians, status, reached, last = numbers
        found: dict[str, Any] = {"steps": int(steps), "rhs_calls": int(rhs)}
        found["jacobian_calls"] = int(jacobians)
        if status:
            why = _CAUSES.get(int(status), "it gave up")
            found["cause"] = f"{why} at t = {start + length * reached:g}, h = {length * last:.2g}"
        return found

    return stats


_CAUSES = {
    1: "too many steps",
    2: "step size too small",
    3: "inconsistent algebraic unknowns",
    4: "a state is not finite",
    5: "halted",
}


def _unit_grid(grid: Vector) -> Vector:
    unit = (grid - grid[0]) / (grid[-1] - grid[0])
    even: Vector = np.arange(len(grid)) / (len(grid) - 1)
    return even if np.allclose(unit, even, rtol=0, atol=1e-12) else unit


def _fixed_step(
    dae: Dae,
    grid: Vector,
    name: str,
    step_size: float | None,
    inputs: InputSeries | None,
    compiled: bool,
    project: bool,
) -> Engine:
    """Steps of one size within each output interval, at most `step_size`."""
    intervals = np.diff(grid)
    largest = float(intervals.max()) if step_size is None else step_size
    if float(grid[-1] - grid[0]) / largest > MOST_STEPS:
        raise ParameterError(
            f"step_size = {largest:g} s makes more than {MOST_STEPS:.0e} steps; give a larger one"
        )
    if compiled:
        return _explicit(dae, grid, name, (0.0, 0.0, largest), inputs, project)
    parts = np.maximum(1, np.ceil(intervals / largest * (1 - 1e-12))).astype(int)
    full, constants = _prepared(dae)
    t, x, z, u, c = _symbols(full)
    ode, _ = full(t, x, z, driven(dae, inputs, t, u), c)
    rhs = ca.Function("rhs", [t, x, u, c], [ode])
    step = step_function(rhs, METHODS[name])
    sizes = np.repeat(intervals / parts, parts)
    within = np.arange(len(sizes)) - np.repeat(np.cumsum(parts) - parts, parts)
    begins = np.repeat(grid[:-1], parts) + within * sizes
    total = len(sizes)
    run = step.mapaccum("steps", total, {"base": 100}) if total > 1 else step
    x0, p, u0 = (MX.sym(n, v.numel()) for n, v in (("x0", dae.x), ("p", dae.p), ("u", dae.u)))
    repeated = (ca.repmat(u0, 1, total), ca.repmat(constants(p), 1, total))
    states = run(x0, ca.DM(begins).T, ca.DM(sizes).T, *repeated)
    kept = (np.cumsum(parts) - 1).tolist()
    function = ca.Function(
        name,
        [x0, MX.sym("z0", 0), p, u0],
        [ca.horzcat(x0, states[:, kept]), MX(0, len(grid))],
        ["x0", "z0", "p", "u"],
        ["xf", "zf"],
    )
    calls = {"steps": total, "rhs_calls": total * len(METHODS[name].b), "jacobian_calls": 0}
    return Engine(function, None, False, lambda: dict(calls), False)


def _explicit(
    dae: Dae,
    grid: Vector,
    name: str,
    settings: tuple[float, float, float],
    inputs: InputSeries | None,
    project: bool,
) -> Engine:
    """An explicit method in C; algebraic unknowns are solved for within the right-hand side.

    `settings` are the relative and the absolute tolerance, and the largest step.
    """
    if dae.algebraics:
        function = equations(dae, sensitivities=False)
        constants = ca.Function("constants", [dae.p], [dae.p])
        t, x, z, u, c = symbols = _symbols(function)
        solved = algebraic_function(dae)(t, x, z, driven(dae, inputs, t, u), c)
    else:
        function, constants = _prepared(dae)
        t, x, z, u, c = symbols = _symbols(function)
        solved = z
    ode, _ = function(t, x, solved, driven(dae, inputs, t, u), c)
    projection = projection_step(dae, c.numel()) if project else None
    path = explicit_library(ca.Function("rhs", symbols, [ode, solved]), name, projection)
    run, library = explicit_function(path, len(grid))
    p = MX.sym("p", dae.p.numel())
    extended = ca.vertcat(constants(p), len(grid), *settings, ca.DM(grid))
    parameters = ca.Function("parameters", [p], [extended])
    return Engine(run, parameters, False, _statistics(library, 0.0, 1.0), True, library)


def _symbols(function: ca.Function) -> list[MX]:
    return [MX.sym(name, function.sparsity_in(i)) for i, name in enumerate(_CALL)]
