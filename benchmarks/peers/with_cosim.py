"""This project: parameters are symbols, so that other values need no new compilation."""

import os
import tempfile
from collections.abc import Iterator

import casadi as ca
import numpy as np
from entries import Evaluation, Run, Solver, Vector
from problem import Problem

import cosim
from cosim.codegen.casadi_library import cache_key, external
from cosim.integrate import call, engine
from cosim.integrate.solvers import engine_of, requested_solver

PACKAGES = ("cosim-rigid", "casadi")
EMPTY_CACHES: list[tempfile.TemporaryDirectory[str]] = []  # removed at exit


def solvers(problem: Problem) -> Iterator[Solver]:
    dae, grid, start = problem.dae, problem.grid, problem.start
    EMPTY_CACHES.append(tempfile.TemporaryDirectory(prefix="cosim-peers-"))
    os.environ["COSIM_CACHE"] = EMPTY_CACHES[-1].name  # preparation includes compilation
    values = (start["x0"], start["z0"], start["p"], start["u"])

    def prepared(solver: str) -> Solver:
        def prepare(tolerance: float) -> Run:
            task = engine.Problem(dae, grid.tobytes(), compiled=True)
            built = engine_of(task, requested_solver(dae, solver, tolerance))
            return lambda: call.call(built, *values).states.T

        return Solver(f"cosim {solver}", prepare)

    for solver in ("dop853", "erk", "cvodes_adams", "cvodes"):
        yield prepared(solver)

    names = [variable.name for variable in dae.states]

    def simulate(tolerance: float) -> Run:
        def run() -> np.ndarray:
            found = cosim.simulate(dae, solver="dop853", relative_tolerance=tolerance)
            return np.column_stack([found[name] for name in names])

        return run

    yield Solver("cosim.simulate, all outputs", simulate)


def evaluations(problem: Problem) -> Iterator[Evaluation]:
    dae, start = problem.dae, problem.start
    inputs = {"t": np.zeros(1), "x": problem.states, "u": start["u"], "p": start["p"]}
    numbers, symbols = ["t", "x"], ["t", "x", "u", "p"]
    open_graph = ca.Function("rhs", [dae.t, dae.x, dae.u, dae.p], [dae.ode], {"cse": True})
    yield from _called(problem.rhs, [inputs[name] for name in numbers], "cosim")
    label = "cosim, parameters as arguments"
    yield from _called(open_graph, [inputs[name] for name in symbols], label)


def _called(graph: ca.Function, arguments: list[Vector], name: str) -> Iterator[Evaluation]:
    """Compile a function of t, x and more; a loop over many states in C, and one call."""
    count = len(arguments[1])
    same = [i for i in range(len(arguments)) if i != 1]
    many = graph.map("many", "serial", count, same, [])
    key = cache_key("peers", many)
    results = np.empty_like(arguments[1])
    for function in external([graph, many], key, ["rhs", "many"]):
        buffer, evaluate = function.buffer()
        for i, values in enumerate(arguments):
            if values.size:
                buffer.set_arg(i, memoryview(values))
        buffer.set_res(0, memoryview(results))
        one = function.name() == "rhs"
        held = (buffer, arguments, results)
        yield Evaluation(name, evaluate, 1 if one else count, one, held)
