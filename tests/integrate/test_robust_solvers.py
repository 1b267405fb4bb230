"""Solvers where their defaults gave up: long spans, tight tolerances of DAEs."""

import re
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from helpers.oscillators import blow_up
from scipy.integrate import solve_ivp

import cosim
from casadi_models.dae import Model
from cosim.api import simulate
from cosim.errors import SolverError

# Mazzia & Magherini, Test Set for Initial Value Problem Solvers (Bari, 2008), ROBER at 1e11
ROBERTSON = (0.2083340149701255e-07, 0.8333360770334713e-13, 0.9999999791665050)


def robertson():
    model = Model("robertson", stop_time=1e11, output_interval=2.5e10)
    a = model.state("a", "1", 1.0, "first share")
    b = model.state("b", "1", 0.0, "second share", nominal=1e-5)
    c = model.state("c", "1", 0.0, "third share")
    slow, fast = 0.04 * a - 1e4 * b * c, 3e7 * b**2
    model.derivative(a, -slow)
    model.derivative(b, slow - fast)
    model.derivative(c, fast)
    return model.freeze()


@pytest.mark.slow_rows("True")
@pytest.mark.parametrize("compiled", [False, True])
def test_rosenbrock_begins_a_long_span_with_a_small_step(compiled):
    """Its smallest step is a part of the time, not of the span: 1e-14 of 1e11 s were too long."""
    run = simulate(
        robertson(),
        solver="rosenbrock",
        relative_tolerance=1e-8,
        absolute_tolerance=1e-20,
        compiled=compiled,
    )
    end = np.array([run[name][-1] for name in "abc"])
    np.testing.assert_allclose(end, ROBERTSON, rtol=1e-6)  # measured 2e-9


@pytest.mark.parametrize("compiled", [False, True])
def test_step_that_time_cannot_resolve_still_ends_a_run(compiled):
    with pytest.raises(SolverError, match=r"step size too small|not finite") as caught:
        simulate(blow_up(), solver="rosenbrock", compiled=compiled)
    assert caught.value.partial.time[-1] == pytest.approx(0.99, abs=0.011)


@pytest.mark.slow
def test_idas_goes_on_without_errors_of_algebraic_unknowns_and_says_so():
    """At 1e-13 the rounding of contact forces exceeds what the tolerance allows in newtons."""
    dae = cosim.load("bicycle/multipliers")
    settings = {"stop_time": 1.0, "relative_tolerance": 1e-13}
    unknown = tuple(replace(v, nominal=1.0) for v in dae.algebraics)
    plain = replace(dae, algebraics=unknown)
    run = simulate(plain, solver="idas", absolute_tolerance=1e-15, **settings)
    assert simulate(dae, solver="idas", **settings).complete  # in nominal values there is no need
    assert run.complete
    # rounding decides how IDAS fails with them
    said = r"without the algebraic unknowns in its error test; with them: IDA_(ERR_FAIL|TOO_MUCH)"
    assert re.search(said, run.stats["note"])
    other = simulate(dae, solver="dop853", **settings)
    for name in ("phi", "delta", "fz_P"):
        apart = np.abs(run[name] - other[name]).max() / run.column(name).nominal
        assert apart < 1e-10  # measured 1e-12
    assert "note" not in simulate(dae, solver="idas", stop_time=1.0).stats


def test_failure_of_a_dae_names_the_solvers_that_are_left():
    model = Model("singular", stop_time=2.0)
    x = model.state("x", "1", 1.0, "x")
    z = model.algebraic("z", "1", 1.0, "its inverse")
    model.derivative(x, -1)
    model.equation(x * z - 1)
    with pytest.raises(SolverError, match=r"or solver \(rosenbrock, dop853\)"):
        simulate(model.freeze(), solver="idas")


@pytest.mark.slow
def test_motion_slides_on_a_surface_that_no_step_can_leave():
    """Dry friction: the sign of a sliding speed."""
    model = Model("slide", stop_time=2.0)
    x = model.state("x", "m", 1.0, "place")
    v = model.state("v", "m/s", 0.0, "speed")
    model.derivative(x, v)
    model.derivative(v, -x - 5e4 * ca.sign(v + 0.3 * x))
    run = simulate(model.freeze(), solver="dop853")
    reached = next(event for event in run.events if event.name.startswith("sign of"))
    after = run.time > reached.time
    exact = reached.after["x"] * np.exp(-0.3 * (run.time[after] - reached.time))
    np.testing.assert_allclose(run["x"][after], exact, rtol=1e-8)
    np.testing.assert_allclose(run["v"][after], -0.3 * exact, rtol=1e-8)


def test_failure_of_a_smooth_model_names_no_kink():
    with pytest.raises(SolverError) as caught:
        simulate(blow_up(), solver="dop853")
    assert "switches" not in str(caught.value)


def behind_a_bump(kind):
    """A mass on a spring over a bump, whose slope is 1e-156 a while after it."""
    model = Model(kind, stop_time=7.0)
    s, h = model.state("s", "m", 0.0, "place"), model.state("h", "m", 0.01, "height")
    v = model.state("v", "m/s", 0.0, "speed")
    bump = ca.exp(-(((s - 35) / 1.84) ** 2))
    a = bump
    if kind == "unknowns":
        a, b = (model.algebraic(name, "m", 0.0, "height") for name in "ab")
        model.equation(a - b * bump - 1)
        model.equation(b - a * bump / 2 - 0.2)
    model.derivative(s, 10)
    model.derivative(h, v)
    model.derivative(v, -25 * h - v + a * bump)
    return model.freeze()


def height_behind_a_bump(kind):
    def slope(t, x):
        bump = np.exp(-(((10 * t - 35) / 1.84) ** 2))
        a = (1 + 0.2 * bump) / (1 - bump**2 / 2) if kind == "unknowns" else bump
        return [x[1], -25 * x[0] - x[1] + a * bump]

    options = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-14, "max_step": 0.01}
    return solve_ivp(slope, (0, 7), [0.01, 0.0], **options).y[0, -1]


@pytest.mark.parametrize(
    ("kind", "solver"),
    [("bump", "rosenbrock"), *(("unknowns", s) for s in ("rosenbrock", "idas", "dop853", "fmu"))],
)
def test_elements_whose_squares_underflow_end_no_run(kind, solver, tmp_path):
    if solver == "fmu":
        path = cosim.export_fmu(behind_a_bump(kind), tmp_path / "bump.fmu", solver="rosenbrock")
        run = cosim.simulate_fmu(path, interface="CoSimulation")
    else:
        run = cosim.simulate(behind_a_bump(kind), solver=solver)
    # before: no start values, or steps of 1e-17 s
    assert run["h"][-1] == pytest.approx(height_behind_a_bump(kind), abs=1e-7)
