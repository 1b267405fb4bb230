"""The integrators of road one, by name, each as an engine over a grid of output times.

`cvodes`, `idas`: SUNDIALS through CasADi; compiled, their equations come from a shared library.
`erk`, `rosenbrock`: CasADi's own; compiled, the whole integration is one C function.
`rk4`, `ode8`: fixed steps; compiled, the step is one C function.
"""

import ctypes
import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np
from casadi import MX
from numpy.typing import NDArray

from casadi_models.dae import Dae
from cosim.compile import cached_library
from cosim.errors import ParameterError, UnknownName, UsageError
from cosim.generated import REPORT, in_one_piece, reporting, run_time_tolerances
from cosim.inputs import InputSeries
from cosim.runge_kutta import METHODS, step_function
from cosim.values import number

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Method:
    """What is known of a solver: CasADi's plugin, whether it takes algebraic unknowns."""

    plugin: str
    solves_dae: bool
    adaptive: bool = True
    options: Mapping[str, Any] = field(default_factory=dict)


_QUIET = {
    "disable_internal_warnings": True,
    "show_eval_warnings": False,
    "max_num_steps": 100_000,
    "second_order_correction": False,  # compiled equations have first derivatives only
}
SOLVERS: dict[str, Method] = {
    "cvodes": Method("cvodes", False, options=_QUIET),
    "cvodes_adams": Method(
        "cvodes",
        False,
        options=_QUIET
        | {"linear_multistep_method": "adams", "nonlinear_solver_iteration": "functional"},
    ),
    "idas": Method("idas", True, options=_QUIET),
    "erk": Method("erk", False, options={"show_eval_warnings": False}),
    "rosenbrock": Method("rosenbrock", True, options={"show_eval_warnings": False}),
    "rk4": Method("", False, adaptive=False),
    "ode8": Method("", False, adaptive=False),
}
_CALL = ["t", "x", "z", "u", "p"]


@dataclass(frozen=True)
class Tolerance:
    """Error per step that an adaptive solver may make: relative, and absolute in SI units."""

    relative: float = 1e-8
    absolute: float | None = None

    def __post_init__(self) -> None:
        relative = number("solver", "relative_tolerance", self.relative)
        if relative != 0 and not 100 * np.finfo(float).eps <= relative <= 0.1:
            raise ParameterError(
                f"relative_tolerance = {relative:g} is not within 2.2e-14 ... 0.1; "
                "double precision carries no less, and more is no accuracy"
            )
        if self.absolute is not None and number("solver", "absolute_tolerance", self.absolute) < 0:
            raise ParameterError(
                f"absolute_tolerance = {self.absolute:g} is negative; give 0 or more"
            )
        if relative == 0 and not self.absolute:
            raise ParameterError("both tolerances are 0; give one of them a positive value")

    @property
    def pair(self) -> tuple[float, float]:
        """Relative and absolute; the absolute one is a hundredth of the relative by default."""
        return self.relative, 0.01 * self.relative if self.absolute is None else self.absolute


@dataclass(frozen=True)
class Engine:
    """An integrator over a grid, ready to be called.

    Attributes:
        function: `(x0, z0, p, u, ...) -> (xf, zf, ...)`, one column per output time.
        extra: What follows the model's parameters in `p`.
        repeat_u: Whether `u` has one column per output time.
        stats: Reads what the last call took.
        compiled: Whether the equations are machine code.
    """

    function: ca.Function
    extra: Vector
    repeat_u: bool
    stats: Callable[[], dict[str, Any]]
    compiled: bool


def method(dae: Dae, solver: str | None) -> tuple[str, Method]:
    """Return the solver's name and method: CVODES for an ODE, IDAS for a DAE when None.

    Raises:
        UnknownName: There is no such solver.
        UsageError: It cannot integrate algebraic unknowns.
    """
    name = solver or ("idas" if dae.algebraics else "cvodes")
    if name not in SOLVERS:
        raise UnknownName.among("cosim", "solver", name, SOLVERS)
    if dae.algebraics and not SOLVERS[name].solves_dae:
        able = " or ".join(key for key, value in SOLVERS.items() if value.solves_dae)
        raise UsageError(
            f"{dae.full_name} has algebraic unknowns, which {name} cannot integrate; use {able}"
        )
    return name, SOLVERS[name]


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
) -> Engine:
    """Return the engine of a solver for a grid of at least two increasing times.

    An adaptive solver takes no step longer than the shortest interval of an input series.

    Raises:
        UnknownName, UsageError: See `method`.
        MissingTool: It shall be compiled, and no compiler works.
    """
    name, chosen = method(dae, solver)
    if not chosen.adaptive:
        return _fixed_step(dae, grid, name, step_size, inputs, compiled)
    if step_size is not None:
        raise UsageError(f"{name} chooses its own steps; leave step_size out or use rk4 or ode8")
    tolerances = (tolerance or Tolerance()).pair
    if compiled and chosen.plugin in ("erk", "rosenbrock"):
        return _generated(dae, grid, chosen, tolerances, inputs)
    function = equations(dae, sensitivities=sensitivities)
    return _interpreted(dae, grid, chosen, tolerances, inputs, function, compiled)


def equations(dae: Dae, *, sensitivities: bool = True) -> ca.Function:
    """Return `dae(t, x, z, u, p) -> (ode, alg)`.

    Without `sensitivities` it has derivatives with respect to x and z only, which is all that an
    integration needs: a third to a half of the code.
    """
    symbols = [dae.t, dae.x, dae.z, dae.u, dae.p]
    options: dict[str, Any] = {"cse": True}
    if not sensitivities:
        options["is_diff_in"] = [False, True, True, False, False]
    return ca.Function("dae", symbols, [dae.ode, dae.alg], _CALL, ["ode", "alg"], options)


def external(functions: list[ca.Function], key: str, names: list[str]) -> list[ca.Function]:
    """Return compiled twins of functions, by name, from the cache where it has them."""

    def generate() -> str:
        generator = ca.CodeGenerator("code", {"with_header": False})
        for function in functions:
            generator.add(function)
        return str(generator.dump())

    path = str(cached_library(key, generate))
    return [ca.external(name, path) for name in names]


def cache_key(kind: str, function: ca.Function, *more: bytes) -> str:
    """Return what the compiled twin of a function is known by: same key, same code."""
    digest = hashlib.sha256(b"\0".join((function.serialize().encode(), *more))).hexdigest()
    return f"{kind} {ca.CasadiMeta.version()} {digest}"


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
    tolerances: tuple[float, float],
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
    options = dict(chosen.options) | dict(zip(("reltol", "abstol"), tolerances, strict=True))
    if inputs is not None:
        options["max_step_size"] = float(np.diff(inputs.time).min())
    if grouped:
        options["control_group_size"] = [len(grid)]
    run = ca.integrator("run", chosen.plugin, problem, grid[0], list(grid), options)

    def stats() -> dict[str, Any]:
        raw = run.stats(1)  # the memory that `Function.buffer` takes; 0 belongs to plain calls
        if grouped:
            keys = {"n_steps": "steps", "n_rhs": "rhs_calls", "n_jac": "jacobian_calls"}
        else:
            keys = {"nsteps": "steps", "nfevals": "rhs_calls", "nlinsetups": "jacobian_calls"}
        return {name: int(raw[key]) for key, name in keys.items() if key in raw}

    return Engine(run, np.empty(0), not grouped, stats, compiled)


def _generated(
    dae: Dae,
    grid: Vector,
    chosen: Method,
    tolerances: tuple[float, float],
    inputs: InputSeries | None,
) -> Engine:
    """CasADi's generated integrator on the unit interval; span and tolerances come with `p`."""
    unit_grid = _unit_grid(grid)
    function = equations(dae)
    s, x, z, u, p = _symbols(function)
    span = MX.sym("span", 4)  # start, length, relative and absolute tolerance
    t = span[0] + span[1] * s
    ode, alg = function(t, x, z, driven(dae, inputs, t, u), p)
    symbols = [s, x, z, u, ca.vertcat(p, span)]
    problem = dict(zip(_CALL, symbols, strict=True)) | {"ode": span[1] * ode, "alg": alg}
    options = dict(chosen.options) | {"control_group_size": [len(grid)]}
    if inputs is not None:
        options["max_step_size"] = float(np.diff(inputs.time).min() / (grid[-1] - grid[0]))
    original = ca.Function("driven", symbols, [problem["ode"], alg])

    def generate() -> str:
        run = ca.integrator("run", chosen.plugin, problem, 0.0, list(unit_grid), options)
        generator = ca.CodeGenerator("code", {"with_header": False})
        generator.add(run)
        first = dae.p.numel() + 2
        code = run_time_tolerances(
            str(generator.dump()), f"arg[2][{first}]", f"arg[2][{first + 1}]"
        )
        code = reporting(code)
        return in_one_piece(code) if chosen.plugin == "erk" else code

    details = (unit_grid.tobytes(), repr(options.get("max_step_size")).encode())
    key = cache_key(f"generated-3 {chosen.plugin}", original, *details)
    path = str(cached_library(key, generate))
    extra = np.array([grid[0], grid[-1] - grid[0], *tolerances])
    report = _report(path)

    def stats() -> dict[str, Any]:
        steps, rhs, jacobians, status, _, _ = map(int, report())
        found = {"steps": steps, "rhs_calls": rhs, "jacobian_calls": jacobians}
        return found | ({"cause": _CAUSES.get(status, "it gave up")} if status else {})

    return Engine(ca.external("run", path), extra, False, stats, True)


_CAUSES = {1: "too many steps", 2: "step size too small", 3: "inconsistent algebraic unknowns"}


def _report(path: str) -> Callable[[], list[float]]:
    read = ctypes.CDLL(path).cosim_report
    numbers = (ctypes.c_double * REPORT)()

    def report() -> list[float]:
        read(numbers)
        return list(numbers)

    return report


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
) -> Engine:
    """Steps of one size within each output interval, at most `step_size`."""
    intervals = np.diff(grid)
    largest = (
        number("solver", "step_size", step_size, positive=True) if step_size else intervals.max()
    )
    if largest < (grid[-1] - grid[0]) / 1e8:
        raise ParameterError(
            f"step_size = {largest:g} s makes more than 1e8 steps; give a larger one"
        )
    parts = np.maximum(1, np.ceil(intervals / largest * (1 - 1e-12))).astype(int)
    full = equations(dae)
    t, x, z, u, p = _symbols(full)
    ode, _ = full(t, x, z, driven(dae, inputs, t, u), p)
    rhs = ca.Function("rhs", [t, x, u, p], [ode])
    step = step_function(rhs, METHODS[name])
    if compiled:
        (step,) = external([step], cache_key(f"step {name}", rhs), ["step"])
    sizes = np.repeat(intervals / parts, parts)
    begins = np.concatenate(
        [a + np.arange(n) * (d / n) for a, d, n in zip(grid, intervals, parts, strict=False)]
    )
    total = len(sizes)
    run = step.mapaccum("steps", total) if total > 1 else step
    x0, u0 = MX.sym("x0", dae.x.numel()), MX.sym("u", dae.u.numel())
    p0 = MX.sym("p", dae.p.numel())
    states = run(
        x0, ca.DM(begins).T, ca.DM(sizes).T, ca.repmat(u0, 1, total), ca.repmat(p0, 1, total)
    )
    kept = [int(i) - 1 for i in np.cumsum(parts)]
    function = ca.Function(
        name,
        [x0, MX.sym("z0", 0), p0, u0],
        [ca.horzcat(x0, states[:, kept]), MX(0, len(grid))],
        ["x0", "z0", "p", "u"],
        ["xf", "zf"],
    )
    calls = {"steps": total, "rhs_calls": total * len(METHODS[name].b), "jacobian_calls": 0}
    return Engine(function, np.empty(0), False, lambda: dict(calls), compiled)


def _symbols(function: ca.Function) -> list[MX]:
    return [MX.sym(name, function.sparsity_in(i)) for i, name in enumerate(_CALL)]
