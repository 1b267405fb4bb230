"""Validity conditions are located in time on every backend, whatever the output times are."""

import casadi as ca
import fmpy
import numpy as np
import pytest

import cosim
from casadi_models.dae import Dae, Model
from cosim.errors import SolverError

SPARSE = [0.0, 3.14159, 12.566]  # s, at which the oscillator is valid
# limits of x = sin t, and when each is left: late, for 28 ms only, never, at once
LEAVES = {0.9: np.arcsin(0.9), 0.9999: np.arcsin(0.9999), 1.0001: None, 0.0: 0.0}
NATIVE = ["dop853", "cvodes", "idas", "erk", "rosenbrock", "rk4", "ode8"]


def oscillator(limit: float) -> Dae:
    """Return x = sin t, valid for x below a limit."""
    model = Model("oscillator", description="oscillator", source="a test", stop_time=13.0)
    x = model.state("x", "m", 0.0, "place")
    v = model.state("v", "m/s", 1.0, "velocity")
    model.derivative(x, v)
    model.derivative(v, -x)
    model.limit(limit - x, "x is small")
    return model.freeze()


def expect(stats, limit, within):
    """Compare the reported violation with the closed form."""
    if LEAVES[limit] is None:
        assert "invalid" not in stats
    else:
        (reason,) = stats["invalid"]
        assert reason.what == "not fulfilled: x is small"
        assert reason.time == pytest.approx(LEAVES[limit], abs=within)


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("limit", LEAVES)
@pytest.mark.parametrize("solver", NATIVE)
def test_native_run_with_few_output_times(solver, limit):
    run = cosim.simulate(oscillator(limit), solver=solver, output_times=SPARSE)
    # near the top, an error of x moves the time by 70 times as much; CVODES and IDAS: 4e-7 of x
    expect(run.stats, limit, 1e-4 if limit > 0.99 else 2e-6)
    assert len(run) == 3


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("limit", LEAVES)
def test_runs_in_lanes_with_few_output_times(limit):
    many = cosim.simulate_many(oscillator(limit), {"v": [1.0, 0.5, 1.0]}, output_times=SPARSE)
    assert "lanes" in many.stats
    for i in (0, 2):
        expect(many.run(i).stats, limit, 1e-6 if limit > 0.99 else 1e-8)  # measured 1e-8, 3e-11
    assert (1 in many.invalid) == (limit == 0.0)


def test_runs_in_lanes_end_where_they_leave_a_limit():
    what = {"on_invalid": "stop", "output_interval": 0.1}
    many = cosim.simulate_many(oscillator(0.9), {"v": [1.0, 0.5]}, **what)
    assert [str(state) for state in many.states] == ["stopped", "complete"]
    assert many.time[many.reached[0] - 1] == pytest.approx(1.1)
    assert many.steps[0] < many.steps[1] / 3
    what = {"on_invalid": "ignore", "output_interval": 0.1}
    many = cosim.simulate_many(oscillator(0.9), {"v": [1.0, 0.5]}, **what)
    assert many.status == "2 complete"
    assert not many.invalid


def test_sweep_with_few_output_times():
    found = cosim.sweep(oscillator(0.9), {"v": [1.0, 0.5]}, output_times=SPARSE, workers=0)
    assert found.reasons == {0: "invalid from 1.12 s: not fulfilled: x is small"}


@pytest.mark.parametrize("solver", ["dop853", "cvodes", "rk4"])
def test_native_run_ends_at_its_limit(solver):
    what = {"on_invalid": "stop", "output_times": SPARSE}
    with pytest.raises(SolverError, match=r"invalid from 1\.11977 s"):
        cosim.simulate(oscillator(0.9), solver=solver, **what)


def fmu_stats(folder, limit, fmi, solver, **run):
    path = cosim.export_fmu(oscillator(limit), folder / "oscillator.fmu", fmi=fmi, solver=solver)
    return cosim.simulate_fmu(path, output_interval=6.5, **run).stats


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("limit", LEAVES)
def test_co_simulation_with_long_steps(tmp_path, limit):
    stats = fmu_stats(tmp_path, limit, 3, "dop853")
    expect(stats, limit, 1e-6 if limit > 0.99 else 1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("limit", LEAVES)
@pytest.mark.parametrize("solver", ["dop853", "erk", "rosenbrock", "rk4", "ode8"])
@pytest.mark.parametrize("fmi", [2, 3])
def test_co_simulation_with_every_solver(tmp_path, fmi, solver, limit):
    for master in ("fmpy", "c"):
        stats = fmu_stats(tmp_path, limit, fmi, solver, master=master)
        expect(stats, limit, 1e-4 if limit > 0.99 else 1e-7)


@pytest.mark.parametrize("interface", ["CoSimulation", "ModelExchange"])
def test_an_importer_is_warned_once_of_a_limit_that_each_step_leaves(tmp_path, interface):
    path = cosim.export_fmu(oscillator(0.9), tmp_path / "oscillator.fmu", valid=True)
    told = list[bytes]()
    fmpy.simulate_fmu(
        path,
        fmi_type=interface,
        stop_time=100.0,  # it is left sixteen times
        output_interval=10.0,
        debug_logging=True,
        logger=lambda *facts: told.append(facts[-1]),
    )
    (only,) = (text for text in told if b"invalid from" in text)
    assert b"invalid from 1.1197" in only


@pytest.mark.parametrize("limit", [0.9, 0.0])
@pytest.mark.parametrize("master", ["fmpy", "c"])
def test_model_exchange_with_long_steps(tmp_path, master, limit):
    stats = fmu_stats(tmp_path, limit, 2, None, interface="ModelExchange", master=master)
    expect(stats, limit, 1e-6)


def test_sweep_of_an_fmu_names_what_is_invalid(tmp_path):
    path = cosim.export_fmu(oscillator(0.9), tmp_path / "oscillator.fmu")
    found = cosim.sweep(path, {"v": [1.0, 0.5]}, output_interval=6.5, workers=0)
    assert found.reasons == {0: "invalid from 1.12 s: not fulfilled: x is small"}


@pytest.mark.quick_share(0.3)
@pytest.mark.slow_rows("dop853-place-1e-05", "dop853-time-0.02", "dop853-time-1e-05")
@pytest.mark.parametrize("width", [0.02, 1e-5])
@pytest.mark.parametrize("kind", ["place", "time"])
@pytest.mark.parametrize("solver", ["dop853", "cvodes"])
def test_a_limit_is_left_within_a_short_bump(solver, kind, width):
    """At 10 m/s, the spring over a bump exceeds half the height for 1.7 widths."""
    model = Model("road", description="road", source="a test", stop_time=7.0)
    s = model.state("s", "m", 0.0, "way")
    x = model.state("x", "m", 0.0, "height")
    v = model.state("v", "m/s", 0.0, "velocity")
    way = s if kind == "place" else 10 * model.t
    ground = 0.05 * ca.exp(-(((way - 50.3) / width) ** 2))
    model.derivative(s, ca.SX(10))
    model.derivative(x, v)
    model.derivative(v, -25 * (x - ground) - v)
    model.limit(0.025 - ground + x, "the spring is short")
    run = cosim.simulate(model.freeze(), solver=solver, output_times=[0.0, 4.0, 7.0])
    (reason,) = run.stats["invalid"]  # before: none
    leaves = 5.03 - width / 10 * np.sqrt(np.log(2))
    assert reason.time == pytest.approx(leaves, abs=0.01 * width)
    assert run.time.tolist() == [0.0, 4.0, 7.0]


def test_rows_within_a_pulse_are_not_in_the_result_of_a_run_that_an_event_ends():
    model = Model("kick", description="kick", source="a test", stop_time=10.0)
    x, v = model.state("x", "m", 0.0, "place"), model.state("v", "m/s", 1.0, "velocity")
    model.derivative(x, v)
    model.derivative(v, 5 * ca.exp(-(((model.t - 0.5) / 1e-4) ** 2)))
    model.limit(100 - v, "v is small")
    model.stop(x > 1, "it is far")
    run = cosim.simulate(model.freeze(), output_interval=0.01)  # before: 90 rows more
    np.testing.assert_allclose(run.time[:-1], 0.01 * np.arange(100), atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("start", "leaves"), [({"speed": 3.2}, 1.58978), ({"phi_dot": 2.5}, 0.40212)]
)
def test_bicycle_on_every_backend(start, leaves):
    dae = cosim.load("bicycle")
    run = cosim.simulate(dae, start_values=start, output_times=[0.0, 1.7])
    many = cosim.simulate_many(dae, {k: [v] * 3 for k, v in start.items()}, output_times=[0, 1.7])
    for stats in (run.stats, many.run(1).stats):
        assert stats["invalid"][0].time == pytest.approx(leaves, abs=1e-5)
        assert stats["invalid"][0].what == "the rear wheel would lift off"


def test_many_limits_are_left_where_the_closed_form_says():
    """x = sin t + 0.3 sin 5.3 t: most limits are left by one of its many tops."""
    model = Model("beat", description="beat", source="a test", stop_time=12.0)
    places = []
    for name, size, speed in (("a", 1.0, 1.0), ("b", 0.3, 5.3)):
        x = model.state(name, "m", 0.0, "place")
        v = model.state(f"{name}_dot", "m/s", size * speed, "velocity")
        model.derivative(x, v)
        model.derivative(v, -(speed**2) * x)
        places.append(x)
    top = model.parameter("top", "m", 1.0, "limit")
    model.limit(top - places[0] - places[1], "x is small")
    tops = np.random.default_rng(4).uniform(0.02, 1.35, 300)
    many = cosim.simulate_many(model.freeze(), {"top": tops}, output_times=[0.0, 12.0])
    t = np.linspace(0, 12, 1_200_001)
    x = np.sin(t) + 0.3 * np.sin(5.3 * t)
    assert "lanes" in many.stats
    for i, top in enumerate(tops):
        if not (x > top).any():
            assert i not in many.invalid or top - x.max() < 1e-6
        else:
            assert many.invalid[i].time == pytest.approx(t[np.argmax(x > top)], abs=2e-5)
