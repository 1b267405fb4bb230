"""Pulses of time alone that lie between the stages of every solver."""

import casadi as ca
import fmpy
import numpy as np
import pytest

import cosim
from casadi_models.dae import Model
from cosim.api import execute, requested
from cosim.backend import Backend
from cosim.codegen.terms import pulse_times

ERRORS = {"dop853": 1e-7, "erk": 1e-6, "rosenbrock": 1e-5, "cvodes": 1e-5, "cvodes_adams": 1e-5,
          "idas": 1e-5, "ode8": 1e-4, "rk4": 2e-3}  # fmt: skip
RATE = 3.0  # rad/s of the spring


def spring(force, **parameters):
    """Return a spring of 1 kg at rest, pushed by a function of time."""
    model = Model("spring", stop_time=10.0)
    x, v = model.state("x", "m", 0.0, "place"), model.state("v", "m/s", 0.0, "speed")
    more = [model.parameter(n, "s", value, n) for n, value in parameters.items()]
    model.derivative(x, v)
    model.derivative(v, -(RATE**2) * x + force(model.t, *more))
    return model.freeze()


def gauss(t, middle, width):
    return ca.exp(-(((t - middle) / width) ** 2))


def options(solver):
    return {} if solver in ("rk4", "ode8") else {"relative_tolerance": 1e-9}


def moved(t, middle, width):
    """Return the place of the spring after a pulse."""
    push = width * np.sqrt(np.pi) * np.exp(-((RATE * width) ** 2) / 4)
    return push * np.sin(RATE * (t - middle)) / RATE


def ends_of(dae, step=0.1):
    """Return the times at which steps of a model must end that are this long at most, s."""
    p = np.array([parameter.start for parameter in dae.parameters])
    return pulse_times(dae, p, 0.0, 10.0, step)


@pytest.mark.quick_share(0.3)
@pytest.mark.slow_rows(
    "dop853-0.001",
    "erk-0.001",
    "erk-0.01",
    "erk-0.1",
    "rosenbrock-0.001",
    "rosenbrock-0.01",
    "rosenbrock-0.1",
    "ode8-0.001",
)
@pytest.mark.parametrize("width", [1e-3, 1e-2, 0.1])
@pytest.mark.parametrize("solver", ERRORS)
def test_no_gauss_pulse_is_stepped_over(solver, width):
    dae = spring(gauss, middle=5.0, width=width)
    for middle in np.random.default_rng(3).uniform(1, 8, 3):
        run = cosim.simulate(dae, solver=solver, start_values={"middle": middle}, **options(solver))
        after = run.time > middle + 6 * width
        exact = moved(run.time[after], middle, width)
        np.testing.assert_allclose(run["x"][after], exact, atol=ERRORS[solver] * abs(exact).max())


def test_a_pulse_in_a_formula_of_an_input_is_seen():
    model = Model("driven", stop_time=10.0)
    v, f = model.state("v", "m/s", 0.0, "speed"), model.input("f", "N", 0.0, "force")
    model.derivative(v, f)
    run = cosim.simulate(model.freeze(), inputs={"f": "exp(-((t - 6.4321)/0.0005)**2)"})
    assert run.final["v"] == pytest.approx(5e-4 * np.sqrt(np.pi), rel=1e-5)


@pytest.mark.slow
def test_a_pulse_beside_a_large_slow_term_is_seen():
    dae = spring(lambda t: 100 * ca.sin(t) + gauss(t, 5.0, 1e-3))
    plain = cosim.simulate(spring(lambda t: 100 * ca.sin(t)), solver="dop853", **options("dop853"))
    run = cosim.simulate(dae, solver="dop853", **options("dop853"))
    after = run.time > 5.01
    exact = moved(run.time[after], 5.0, 1e-3)
    np.testing.assert_allclose((run["x"] - plain["x"])[after], exact, atol=2e-6)


def test_a_steep_rise_is_met_by_the_ends_of_steps():
    ends = ends_of(spring(lambda t: ca.tanh((t - 4.3) / 1e-3)))
    assert len(ends) > 5
    assert abs(ends - 4.3).max() < 2e-2


@pytest.mark.parametrize(
    "force",
    [
        ca.sin,
        lambda t: ca.sin(2 * np.pi * 5 * t),
        lambda t: ca.sin(2 * np.pi * 50 * t) + t,
        lambda t: ca.exp(-t),
        lambda t: gauss(t, 5.0, 0.5),
        lambda t: ca.sin(t) ** 2 * ca.cos(7 * t),
    ],
)
@pytest.mark.parametrize("step", [0.1, 0.01])
def test_terms_that_are_smooth_change_nothing(force, step):
    assert ends_of(spring(force), step).size == 0


def test_terms_of_states_are_no_terms_of_time():
    model = Model("own", stop_time=10.0)
    x = model.state("x", "1", 0.0, "x")
    model.derivative(x, gauss(x, 5.0, 1e-3) * ca.sin(x))
    assert ends_of(model.freeze()).size == 0


@pytest.mark.slow_rows("2")
@pytest.mark.parametrize("fmi", [2, 3])
def test_no_gauss_pulse_is_stepped_over_by_an_fmu(fmi, tmp_path):
    dae = spring(lambda t, width: gauss(t, 5.0, width), width=1e-3)
    path = cosim.export_fmu(dae, tmp_path / "x.fmu", fmi=fmi)
    for interface, bound in (("CoSimulation", 1e-11), ("ModelExchange", 1e-7)):
        for master in ("fmpy", "c"):
            run = cosim.simulate_fmu(path, interface=interface, master=master)
            late = run.time > 5.01
            exact = moved(run.time[late], 5.0, 1e-3)
            assert np.abs(run["x"][late] - exact).max() < bound  # measured 1e-13, 4e-8


@pytest.mark.parametrize("interface", ["CoSimulation", "ModelExchange"])
def test_a_pulse_follows_a_parameter_of_an_fmu(interface, tmp_path):
    dae = spring(lambda t, middle, width: gauss(t, middle, width), middle=5.0, width=1e-3)
    path = cosim.export_fmu(dae, tmp_path / "x.fmu")
    values = {"middle": 6.0, "width": 1e-4}
    run = cosim.simulate_fmu(path, interface=interface, start_values=values)
    late = run.time > 6.01
    assert np.abs(run["x"][late] - moved(run.time[late], 6.0, 1e-4)).max() < 1e-6


def test_variants_see_pulses():
    dae = spring(lambda t, strength: strength * gauss(t, 5.0, 1e-3), strength=1.0)
    many = cosim.simulate_many(dae, {"strength": [1.0, 2.0]}, relative_tolerance=1e-9)
    exact = moved(10.0, 5.0, 1e-3)
    np.testing.assert_allclose(many["x"][:, -1], [exact, 2 * exact], rtol=1e-4)


def test_integrator_warns_of_pulses():
    dae = spring(lambda t: gauss(t, 5.0, 1e-3))
    with pytest.warns(UserWarning, match="changes from 4.99"):
        cosim.integrator(dae, [0.0, 10.0], solver="erk", compiled=False)


@pytest.mark.slow
def test_longest_step_of_an_fmu_is_kept():
    dae = spring(lambda t: gauss(t, 5.0, 0.02))
    request = requested(dae, max_step=1e-3, relative_tolerance=1e-3)
    run = execute(request, Backend.CO_SIMULATION)
    exact = moved(run.time[run.time > 5.2], 5.0, 0.02)
    assert np.abs(run["x"][run.time > 5.2] - exact).max() < 1e-5  # otherwise 1e-3
    assert execute(request, Backend.MODEL_EXCHANGE).stats["rhs_calls"] >= 10_000  # in 10 s


def test_an_fmu_does_not_warn_of_a_parameter_of_a_wave(tmp_path):
    dae = spring(lambda t, phase: ca.sin(t + phase) + ca.fabs(ca.sin(t)), phase=0.5)
    path, said = cosim.export_fmu(dae, tmp_path / "x.fmu"), []
    fmpy.simulate_fmu(
        path,
        start_values={"phase": 0.6},
        debug_logging=True,
        logger=lambda *message: said.append(message[-1]),
    )
    assert not any(b"phase moves" in message for message in said)
