"""Explicit methods in C: order conditions, dense output, arguments that compile nothing."""

import os
import subprocess
from math import prod
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from helpers.engines import build
from helpers.order_conditions import density, trees
from helpers.oscillators import oscillator

from cosim.api import simulate
from cosim.codegen.compiler import find_compiler
from cosim.codegen.kernel_library import NO_LAWS
from cosim.codegen.runge_kutta import dop853
from cosim.codegen.runge_kutta.explicit_library import (
    _solver_text,
    dop853_method,
    fixed_step_method,
)
from cosim.errors import MissingTool, UsageError
from cosim.integrate.families.fixed_step import tableau_of
from cosim.integrate.solvers import SOLVERS
from cosim.model.catalogue import load
from cosim.model.solver import Tolerance
from cosim.verify.reference import reference

FIXED_STEP = [name for name, solver in SOLVERS.items() if not solver.adaptive]

STAGES = 12  # of a step; the slope at its end is the first stage of the next step
EXTENDED = 16  # with those of the dense output


def matrix(rows):
    table = np.zeros((len(rows), EXTENDED))
    for row, weights in zip(table, rows, strict=True):
        for stage, weight in weights:
            row[stage - 1] = weight
    return table


A = matrix(dop853.A)


def stage_weights(tree):
    inner = [A @ stage_weights(branch) for branch in tree]
    return prod(inner, start=np.ones(EXTENDED))


def interpolant(s):
    """Return the weights of the slopes at a fraction s of the step, from Hairer's nested form."""
    first, end = np.eye(EXTENDED)[[0, STAGES]]
    (change,) = matrix([dop853.B])
    bend = first - change
    rows = [change, bend, change - end - bend, *matrix(dop853.DENSE)]
    total = np.zeros(EXTENDED)
    for j, row in reversed(list(enumerate(rows))):
        total = (s if j % 2 == 0 else 1 - s) * (row + total)
    return total


@pytest.mark.parametrize("nodes", range(1, 9))
def test_solution_of_dop853_has_order_8(nodes):
    (b,) = matrix([dop853.B])
    off = [abs(b @ stage_weights(tree) - 1 / density(tree)) for tree in trees(nodes)]
    assert max(off) < 1e-14  # rounding; measured 0 to 1e-15


def test_order_of_dop853_is_not_higher():
    (b,) = matrix([dop853.B])
    off = [abs(b @ stage_weights(tree) - 1 / density(tree)) for tree in trees(9)]
    assert max(off) > 1e-6  # measured 3e-5


@pytest.mark.parametrize("s", [0.1, 0.37, 0.5, 0.9, 1.0])
@pytest.mark.parametrize("nodes", range(1, 8))
def test_dense_output_has_order_7(nodes, s):
    b = interpolant(s)
    size = s**nodes
    off = [abs(b @ stage_weights(tree) - size / density(tree)) for tree in trees(nodes)]
    assert max(off) < 1e-12  # rounding of coefficients up to 500; measured 2e-15


@pytest.mark.parametrize(("row", "order"), [(dop853.ERROR_5, 5), (dop853.ERROR_3, 3)])
def test_embedded_solutions_have_the_orders_that_the_estimate_takes_them_for(row, order):
    (weights,) = matrix([row])
    for nodes in range(1, order + 1):
        assert max(abs(weights @ stage_weights(tree)) for tree in trees(nodes)) < 1e-14
    assert max(abs(weights @ stage_weights(tree)) for tree in trees(order + 1)) > 1e-5


def test_coefficients_are_those_that_scipy_ships():
    published = pytest.importorskip("scipy.integrate._ivp.dop853_coefficients")
    assert (published.A == A).all()
    assert (published.C == dop853.NODES).all()
    assert (A[12, :12] == published.B).all()
    assert (matrix(dop853.DENSE) == published.D).all()
    assert (matrix([dop853.ERROR_5])[0, :13] == published.E5).all()
    assert (matrix([dop853.ERROR_3])[0, :13] == published.E3).all()


def test_nodes_are_the_row_sums():
    np.testing.assert_allclose(A.sum(axis=1), dop853.NODES, rtol=0, atol=2e-15)  # measured 1e-15


@pytest.mark.parametrize("name", FIXED_STEP)
def test_fixed_steps_in_c_are_those_of_casadi(name):
    dae, _ = oscillator()
    compiled, interpreted = (
        simulate(dae, solver=name, step_size=0.02, output_interval=0.05, compiled=c)
        for c in (True, False)
    )
    apart = np.abs(compiled.values - interpreted.values).max()
    assert apart < 1e-14  # rounding; measured 0
    assert compiled.stats["steps"] == interpreted.stats["steps"]
    assert compiled.stats["rhs_calls"] == interpreted.stats["rhs_calls"]


def test_nothing_is_compiled_when_tolerance_grid_or_values_change(monkeypatch, tmp_path):
    monkeypatch.setenv("COSIM_CACHE", str(tmp_path))
    dae, _ = oscillator()
    for name, options in (
        ("dop853", {"relative_tolerance": 1e-6}),
        ("ode8", {"step_size": 0.02}),
    ):
        simulate(dae, solver=name)
        kept = sorted(tmp_path.iterdir())
        simulate(dae, solver=name, output_interval=0.037, stop_time=3.0, start_time=1.0, **options)
        simulate(dae, solver=name, start_values={"k": 5.0, "x": 0.3, "push": 0.1})
        new = [path for path in tmp_path.iterdir() if path not in kept]
        assert new == []


def test_functions_of_one_library_keep_their_own_number_of_output_times():
    dae, _ = oscillator()
    grids = [np.linspace(0, 1, n) for n in (3, 11, 5)]
    engines = [build(dae, grid, "dop853", Tolerance(1e-10), compiled=True) for grid in grids]
    assert [engine.functions.function.size2_out(0) for engine in engines] == [3, 11, 5]
    ends = [simulate(dae, solver="dop853", stop_time=1.0, output_interval=d)["x"][-1]
            for d in (0.5, 0.1, 0.25)]  # fmt: skip
    assert len(set(ends)) == 1


def test_output_times_do_not_change_the_steps():
    dae = load("double_pendulum/quaternion")
    fine, coarse = (
        simulate(dae, solver="dop853", stop_time=4.0, output_interval=d) for d in (0.01, 0.5)
    )
    assert fine.stats["steps"] == coarse.stats["steps"]
    assert (fine["w2_y"][::50] == coarse["w2_y"]).all()


def test_error_between_the_steps_is_that_of_the_steps():
    """Two outputs of three come from the interpolant."""
    dae = load("double_pendulum/quaternion")
    truth = reference(dae).run
    run = simulate(dae, solver="dop853", relative_tolerance=1e-9)
    error = np.abs(run["w2_y"] - truth["w2_y"])
    assert run.stats["steps"] < len(run) / 2
    assert error.max() < 1e-7  # 100 tolerances; measured 4e-8, and 3e-8 at every 50th output


@pytest.mark.slow
@pytest.mark.parametrize(
    "pair",
    [("bicycle/multipliers", "bicycle/independent"),
     ("disk_two_bars/multipliers", "disk_two_bars/reduced")],
)  # fmt: skip
def test_algebraic_unknowns_are_solved_for_within_the_right_hand_side(pair):
    """DAE against ODE: other equations, other unknowns."""
    dae, ode = (
        simulate(load(name), solver="dop853", relative_tolerance=1e-12, stop_time=2.0)
        for name in pair
    )
    names = [name for name in dae.names if name in ode.names]
    for name in names:
        apart = np.abs(dae[name] - ode[name]).max() / ode.column(name).nominal
        assert apart < 1e-8, name  # 1e4 tolerances; measured 0 to 2e-10
    assert len(names) > 10


def test_it_exists_as_compiled_code_only(monkeypatch):
    dae, _ = oscillator()
    with pytest.raises(UsageError, match="compiled code only; use erk"):
        simulate(dae, solver="dop853", compiled=False)
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr("cosim.codegen.compiler.find_spec", lambda _: None)
    with pytest.raises(MissingTool, match="no C compiler found"):
        simulate(dae, solver="dop853")


TOY = """
static int rhs(const double **arg, double **res, long long *iw, double *w, int mem) {
    (void)iw; (void)w; (void)mem;
    if (res[0]) res[0][0] = -arg[4][0] * arg[1][0];
    if (res[1]) res[1][0] = arg[1][0];
    return 0;
}
#define WORK_ARG 5
#define WORK_RES 2
#define WORK_IW 0
#define WORK_W 0
#define NX 1
#define NZ 1
#define NU 1
#define NC 1
"""


TOY_PROJECTION = """
static int project(const double **arg, double **res, long long *iw, double *w, int mem) {
    (void)iw; (void)w; (void)mem;
    res[0][0] = arg[0][0];
    res[1][0] = 0;
    return 0;
}
"""


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("projected", [False, True])
@pytest.mark.parametrize("solver", ["dop853", *FIXED_STEP])
def test_c_code_is_clean(solver, projected, tmp_path):
    x, c = ca.SX.sym("x"), ca.SX.sym("c")
    project = ca.Function("project", [x, c], [x, 0]) if projected else None
    chosen = SOLVERS[solver]
    method = dop853_method() if chosen.adaptive else fixed_step_method(tableau_of(chosen))
    text = _solver_text(method, project, None, NO_LAWS)
    parts = [TOY, NO_LAWS.sizes, TOY_PROJECTION * projected, text]
    source = Path(tmp_path / "code.c")
    source.write_text("\n".join(parts))
    flags = "-std=c11 -O2 -Wall -Wextra -Wpedantic -Wconversion"
    call = [*find_compiler(), *flags.split(), "-Werror", "-c", str(source), "-o", os.devnull]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
