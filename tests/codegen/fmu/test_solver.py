"""The solver for co-simulation inside an FMU: choice and rejection."""

import zipfile

import casadi as ca
import numpy as np
import pytest

import casadi_models
import cosim
from casadi_models.dae import Model
from cosim.codegen.fmu.solver import fastest_decay, solver_for
from cosim.errors import UnknownName, UsageError


def relaxation(rate: float):
    """Return x' = rate (force - x): the error of a start dies out at this rate."""
    model = Model("relaxation", stop_time=1.0, output_interval=0.01)
    x = model.state("x", "1", 2.0, "what relaxes")
    force = model.input("force", "1", 1.0, "where it goes")
    speed = model.parameter("rate", "1/s", rate, "how fast")
    model.derivative(x, speed * (force - x))
    return model.freeze()


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("name", casadi_models.CATALOG)
def test_no_model_of_the_catalogue_is_stiff(name):
    assert solver_for(cosim.load(name), None) == "dop853"


def test_the_fastest_decay_is_an_eigenvalue_of_the_model():
    assert fastest_decay(relaxation(3e4)) == pytest.approx(3e4, rel=1e-14)
    assert fastest_decay(relaxation(-2.0)) == 0.0  # it grows
    two = (fastest_decay(cosim.load(f"bar_on_frame/{name}")) for name in ("reduced", "two_body"))
    assert next(two) == pytest.approx(next(two), rel=1e-9)


def test_the_fastest_decay_of_many_states_is_that_of_the_fastest_mode():
    n = 400
    T = ca.SX.sym("T", n)
    flow = ca.vertcat(T[1:], 0) - 2 * T + ca.vertcat(0, T[:-1])
    dae = cosim.from_casadi({"x": T, "ode": (n + 1) ** 2 * flow}, {"T": 1.0})
    exact = (2 * (n + 1) * np.cos(np.pi / (2 * n + 2))) ** 2  # of a rod held cold at its ends
    assert 0.99 * exact < fastest_decay(dae) < 1.000001 * exact  # measured 0.9997


@pytest.mark.slow
def test_fast_vibrations_of_many_states_are_no_fast_decay():
    n, damping = 150, 4.0
    x, v = ca.SX.sym("x", n), ca.SX.sym("v", n)
    stretch = ca.vertcat(x[1:], 0) - 2 * x + ca.vertcat(0, x[:-1])
    system = {"x": ca.vertcat(x, v), "ode": ca.vertcat(v, 1e10 * stretch - damping * v)}
    dae = cosim.from_casadi(system, {"x": 1.0, "v": 0.0})
    assert fastest_decay(dae) == pytest.approx(damping / 2, rel=1e-4)
    assert solver_for(dae, None) == "dop853"


@pytest.mark.slow_rows("1000000.0-rosenbrock")
@pytest.mark.parametrize(("rate", "solver"), [(10.0, "dop853"), (1e6, "rosenbrock")])
def test_a_stiff_model_gets_the_implicit_solver_and_runs(rate, solver, tmp_path):
    path = cosim.export_fmu(relaxation(rate), tmp_path / "model.fmu")
    with zipfile.ZipFile(path) as archive:
        assert ("sources/dop853.h" in archive.namelist()) == (solver == "dop853")
    run = cosim.simulate_fmu(path, interface="CoSimulation", relative_tolerance=1e-8)
    exact = 1 + np.exp(-rate * run.time)
    assert np.abs(run["x"] - exact).max() < 1e-7  # measured 2e-12 and 0


def test_unsuitable_solver_is_rejected_with_suitable_ones(tmp_path):
    ode, dae = (cosim.load(f"crank_shaft/{name}") for name in ("driven", "multipliers"))
    with pytest.raises(UnknownName, match=r"solver 'dop583'.*dop853"):
        cosim.export_fmu(ode, tmp_path / "model.fmu", solver="dop583")
    with pytest.raises(UsageError, match=r"algebraic unknowns.*dop853 or rosenbrock"):
        cosim.export_fmu(dae, tmp_path / "model.fmu", solver="erk")
    assert not list(tmp_path.iterdir())
