"""What CasADi has reduced from index 3: consistent starts, and a period in closed form."""

import casadi as ca
import numpy as np
import pytest
from casadi import SX

import cosim
from cosim.errors import InitialConditionError


def pendulum(kind=SX, rates=None, **options) -> tuple:
    """Return a pendulum of index 3, reduced by CasADi."""
    x, y, u, v, lam, L = (kind.sym(n) for n in ("x", "y", "u", "v", "lam", "L"))
    rates = ca.vertcat(*(kind.sym(f"d{n}") for n in "xyuv")) if rates is None else rates
    laws = (
        rates[0] - u,
        rates[1] - v,
        rates[2] - lam * x,
        rates[3] - lam * y + 9.81,
        x**2 + y**2 - L**2,
    )
    system = {"x_impl": ca.vertcat(x, y, u, v), "dx_impl": rates, "z": lam, "p": L}
    return ca.dae_reduce_index(system | {"alg": ca.vertcat(*laws)}, options)


def period_at_amplitude(angle: float) -> float:
    """Return the period of a pendulum of 1 m: arithmetic-geometric mean."""
    a, b = 1.0, np.cos(angle / 2)
    for _ in range(10):
        a, b = (a + b) / 2, np.sqrt(a * b)
    return 2 * np.pi / np.sqrt(9.81) / a


@pytest.mark.slow
def test_reduced_index_3_pendulum_swings_with_its_period(tmp_path):
    dae = cosim.from_casadi(pendulum(), {"x": np.sin(1.0), "y": -np.cos(1.0), "L": 1.0})
    period = period_at_amplitude(1.0)
    run = cosim.simulate(dae, stop_time=period, relative_tolerance=1e-10)
    assert run["x"][-1] == pytest.approx(np.sin(1.0), abs=1e-6)
    assert run["y"][-1] == pytest.approx(-np.cos(1.0), abs=1e-6)
    path = cosim.export_fmu(dae, tmp_path / "pendulum.fmu")
    for interface in ("ModelExchange", "CoSimulation"):
        fmu = cosim.simulate_fmu(
            path, interface=interface, stop_time=period, relative_tolerance=1e-10
        )
        assert fmu["x"][-1] == pytest.approx(np.sin(1.0), abs=1e-6)


def test_constraint_that_moves_with_time_is_met_wherever_a_run_begins():
    """A pendulum whose pivot is lifted with constant acceleration: gravity is 9.81 + 2 m/s2."""
    x, y, u, v, lam, t = (SX.sym(name) for name in ("x", "y", "u", "v", "lam", "t"))
    rates, pivot = SX.sym("d", 4), 1 + t**2
    laws = (rates[0] - u, rates[1] - v, rates[2] - lam * x, rates[3] - lam * (y - pivot) + 9.81)
    system = {"t": t, "x_impl": ca.vertcat(x, y, u, v), "dx_impl": rates, "z": lam}
    system["alg"] = ca.vertcat(*laws, x**2 + (y - pivot) ** 2 - 1)
    dae = cosim.from_casadi(ca.dae_reduce_index(system)[0], {"x": np.sin(1.0), "u": 0.0})
    period = period_at_amplitude(1.0) * np.sqrt(9.81 / 11.81)
    for begin in (0.0, 0.5):
        end = begin + period
        run = cosim.simulate(dae, start_time=begin, stop_time=end, relative_tolerance=1e-10)
        below = run["y"][[0, -1]] - 1 - run.time[[0, -1]] ** 2
        assert -below == pytest.approx(np.cos(1.0), abs=1e-7)
        assert run["x"][-1] == pytest.approx(np.sin(1.0), abs=1e-6)
        assert run["v"][0] == pytest.approx(2 * begin, abs=1e-12)


def test_vector_that_a_reduction_divides_keeps_casadis_names():
    dae = cosim.from_casadi(pendulum(rates=SX.sym("d", 4)), {"x": 0.6, "y": -0.8, "L": 1.0})
    names = [v.name for v in (*dae.states, *dae.algebraics)]
    assert {"d_0", "d_1", "d_2", "d_3"} <= {*names}
    assert len({*names}) == len(names)
    scalars = cosim.from_casadi(pendulum(), {"x": 0.6, "y": -0.8, "L": 1.0})
    runs = [cosim.simulate(form, stop_time=1.0, relative_tolerance=1e-9) for form in (dae, scalars)]
    assert runs[0]["x"][-1] == pytest.approx(runs[1]["x"][-1], abs=1e-8)


@pytest.mark.parametrize("length", [1e-12, 1e-9, 1e-6, 1.0, 1e6, 1e12])
def test_starts_of_any_size_satisfy_the_constraints(length):
    given = {"x": 0.6 * length, "y": -0.8 * length, "u": 0.4 * length, "L": length}
    dae = cosim.from_casadi(pendulum(), given)
    v = dae.x_start[[s.name for s in dae.states].index("v")]
    assert v == pytest.approx(0.3 * length, rel=1e-12)  # before: 0 at micrometers
    assert len(dae.start_rules[0].states) == 4
    with pytest.raises(InitialConditionError, match="cannot vanish with the given starts"):
        cosim.from_casadi(pendulum(), given | {"y": -0.9 * length})


def test_starts_that_nobody_gave_satisfy_the_constraints_and_follow_the_parameters():
    dae = cosim.from_casadi(pendulum(), {"x": 0.6, "y": -0.8, "u": 0.5, "L": 1.0})
    run = cosim.simulate(dae, stop_time=0.01)
    assert run["v"][0] == pytest.approx(0.6 * 0.5 / 0.8, abs=1e-12)
    longer = cosim.simulate(dae, stop_time=0.01, start_values={"L": 2.0})
    assert np.hypot(longer["x"][0], longer["y"][0]) == pytest.approx(2.0, abs=1e-12)


def test_given_starts_that_contradict_the_constraints_are_refused():
    with pytest.raises(InitialConditionError, match=r"given starts .x, y"):
        cosim.from_casadi(pendulum(), {"x": 0.6, "y": -0.9, "L": 1.0})
