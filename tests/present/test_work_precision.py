"""Figures of trade-off studies: solvers look different, whatever their names are."""

from types import SimpleNamespace

import cosim
from cosim.backend import Backend
from cosim.colors import solver_look
from cosim.integrate.families.casadi_rk import Erk
from cosim.integrate.solvers import SOLVERS
from cosim.present.study_figures import draw_tradeoff
from cosim.study.tradeoff.configuration import Configuration
from cosim.study.tradeoff.measurement import Measurement, Outcome, Timing

NAMES = ("cvodes", "erk", "a_new_solver")
DAE = cosim.load("crank_shaft/driven")


def configuration(solver):
    kind = type(solver, (Erk,), {"name": solver})
    return Configuration(cosim.requested(DAE, solver=kind(relative_tolerance=1e-3)), Backend.NATIVE)


def measured(solver, cost, error):
    return Measurement(
        configuration(solver), Outcome(), {"x": error},
        rhs_calls=cost, solver_time=Timing(cost, cost, cost, 1),
    )  # fmt: skip


def test_solvers_of_the_table_look_different():
    looks = [solver_look(name, tuple(SOLVERS)) for name in SOLVERS]
    assert len({color for color, _ in looks}) == len({marker for _, marker in looks}) == len(looks)


def test_looks_of_the_solvers_do_not_change():
    looks = {name: solver_look(name, tuple(SOLVERS)) for name in (*SOLVERS, "cvode")}
    assert looks == {
        "cvodes": ("#0072B2", "o"), "cvodes_adams": ("#56B4E9", "s"), "idas": ("#CC79A7", "D"),
        "erk": ("#D55E00", "^"), "rosenbrock": ("#009E73", "v"), "rk4": ("#E69F00", "X"),
        "ode8": ("#8B6914", "*"), "dop853": ("#6A3D9A", "P"), "cvode": ("#444444", "v"),
    }  # fmt: skip


def test_figures_draw_a_solver_that_is_not_in_the_table():
    points = [measured(n, 10.0 * k, 10.0**-k) for n in NAMES for k in (3, 5)]
    study = SimpleNamespace(
        scene="s", competing=points, measurements=points, invariants=(), reference_error=1e-9,
        pareto_front=lambda cost: points[:2], provenance={}, shown_error=lambda m: m.error,
        reference=SimpleNamespace(method="a", check="b"),
    )  # fmt: skip
    axis = draw_tradeoff(study).axes[0]
    assert {line.get_label().partition(",")[0] for line in axis.lines[:3]} == set(NAMES)
