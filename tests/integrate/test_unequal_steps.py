"""Bumps that are longer than the average step, under a step that is far longer than it."""

from math import erf, pi, sqrt

import casadi as ca
import pytest

import cosim


def bump():
    """v' = 2 exp(-((x - place) / width)^2) / width, with x = t."""
    x, v, place, width = (ca.SX.sym(name) for name in ("x", "v", "place", "width"))
    law = 2 * ca.exp(-(((x - place) / width) ** 2)) / width
    equations = {"x": ca.vertcat(x, v), "p": ca.vertcat(place, width), "ode": ca.vertcat(1, law)}
    return cosim.from_casadi(equations, start_values={"place": 1, "width": 0.1}, name="bump")


@pytest.mark.parametrize(("solver", "span", "place", "width", "tolerance", "rows"), [
    ("cvodes", 2.0, 1.0, 0.1, 1e-12, 20),
    ("cvodes_adams", 2.0, 1.0, 0.1, 1e-12, 20),
    ("cvodes", 13.85, 0.59 * 13.85, 0.0629 * 13.85, 3.4e-5, 1000),
    ("cvodes", 864.2115335323647, 511.3537, 52.5444, 3.1e-8, 10),  # rows alone let it be seen
    ("idas", 27.63777, 17.511, 0.75538, 7.4e-6, 10),
    ("idas", 1.59189, 1.36517, 0.0327676, 1e-8, 1000),
])  # fmt: skip
def test_a_step_that_is_far_longer_than_the_average_passes_over_no_bump(
    solver, span, place, width, tolerance, rows
):
    run = cosim.simulate(
        bump(),
        solver=solver,
        stop_time=span,
        output_interval=span / rows,
        relative_tolerance=tolerance,
        start_values={"place": place, "width": width},
    )
    exact = sqrt(pi) * (erf((span - place) / width) + erf(place / width))
    assert run.final["v"] == pytest.approx(exact, rel=1000 * tolerance)  # before: 0
    assert not run.stats.get("note")
