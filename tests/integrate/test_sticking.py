"""What dry friction does at rest, by any law of friction; impacts that die out; rare samples."""

import casadi as ca
import numpy as np
import pytest

import cosim
from cosim.errors import CosimError, SolverError

SOLVERS = ("cvodes", "dop853", "idas", "rosenbrock")


def block(law, load, speed=1.0):
    """A block of 1 kg under a load, with a friction force as an output."""
    model = cosim.Model("block", stop_time=6.0, output_interval=0.01)
    v = model.state("v", "m/s", speed, "speed")
    force = load(model.t)
    model.derivative(v, force - law(v))
    model.output("friction", "N", law(v), "friction force")
    model.output("a", "m/s2", force - law(v), "acceleration")
    return model.freeze()


LAWS = {
    "sign": ca.sign,
    "sides": lambda v: ca.if_else(v > 0, 1 + 0.1 * v, -1 + 0.1 * v),
    "three sides": lambda v: ca.if_else(v > 0, 1.0, ca.if_else(v < 0, -1.0, 0.0)),
    "stribeck": lambda v: ca.sign(v) * (0.8 + 0.3 * ca.exp(-ca.fabs(v) / 0.1)),
    "viscous": lambda v: ca.sign(v) * (1 + 0.1 * ca.fabs(v)),
    "quotient": lambda v: v / ca.fabs(v),
}


@pytest.mark.parametrize("backend", [*SOLVERS, "CoSimulation", "ModelExchange"])
@pytest.mark.parametrize("law", LAWS)
def test_friction_at_rest_equals_the_load(law, backend, tmp_path):
    mean = 0.7 if law == "three sides" else 0.1  # which has no side between load and no load
    dae = block(LAWS[law], lambda t: mean + 0.4 * ca.sin(t) - 0.2)
    if backend in SOLVERS:
        run = cosim.simulate(dae, solver=backend)
    else:
        run = cosim.simulate_fmu(cosim.export_fmu(dae, tmp_path / "b.fmu"), interface=backend)
    rests = np.abs(run["v"]) < 1e-10
    assert rests[run.time > 4].all()
    load = mean + 0.4 * np.sin(run.time[rests]) - 0.2
    np.testing.assert_allclose(run["friction"][rests], load, rtol=0, atol=1e-9)
    np.testing.assert_allclose(run["a"][rests], 0, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    "solver", ["cvodes", "cvodes_adams", "idas", "erk", "rosenbrock", "dop853"]
)
@pytest.mark.parametrize("restitution", [0.1, 0.4])
def test_impacts_that_die_out_end_the_run(restitution, solver):
    """Bounces smaller than the solver's error are none of which it could fall through."""
    model = cosim.Model("ball", stop_time=2.5)
    h, v = model.state("h", "m", 1.0, "height"), model.state("v", "m/s", 0.0, "speed")
    model.derivative(h, v)
    model.derivative(v, -9.81)
    model.when(h < 0, {v: -restitution * v}, name="impact")
    last = np.sqrt(2 / 9.81) * (1 + restitution) / (1 - restitution)
    for tolerance in (1e-6, 1e-8, 1e-10):
        with pytest.raises(SolverError, match="Zeno") as caught:
            cosim.simulate(model.freeze(), solver=solver, relative_tolerance=tolerance)
        assert caught.value.partial.time[-1] == pytest.approx(last, abs=0.02)
        assert caught.value.partial["h"].min() > -1e-9


@pytest.mark.parametrize("period", [2.0, 60.0, 1e6])
def test_the_sample_at_the_start_is_taken_however_rare_samples_are(period, tmp_path):
    model = cosim.Model("counter", stop_time=2.5 * period, output_interval=period / 2)
    count = model.discrete("count", "1", 0.0, "samples")
    model.every(period, {count: count + 1}, name="sample")
    dae = model.freeze()
    file = cosim.export_fmu(dae, tmp_path / "counter.fmu")
    runs = [cosim.simulate(dae), cosim.simulate(dae, solver="dop853"), cosim.simulate_fmu(file)]
    for run in runs:
        np.testing.assert_array_equal(run["count"], [1, 1, 2, 2, 3, 3])


@pytest.mark.parametrize("backend", ["cvodes", "dop853", "CoSimulation", "ModelExchange"])
def test_two_events_do_not_give_one_variable_two_values(backend, tmp_path):
    model = cosim.Model("two", stop_time=2.0)
    d = model.discrete("d", "1", 0.0, "value")
    model.when(model.t > 1, {d: d + 1}, name="first")
    model.when(2 * model.t > 2, {d: d + 10}, name="second")
    dae = model.freeze()
    file = cosim.export_fmu(dae, tmp_path / "two.fmu")
    run, ways = cosim.simulate, {"solver": backend}
    if backend not in SOLVERS:
        dae, run, ways = file, cosim.simulate_fmu, {"interface": backend}
    with pytest.raises(CosimError, match=r"'first' and 'second' give d different values at 1 s"):
        run(dae, **ways)


@pytest.mark.parametrize("solver", SOLVERS)
def test_events_within_rounding_of_the_end_do_not_stop_a_run(solver):
    model = cosim.Model("timer", stop_time=1.0)
    x, count = model.state("x", "s", 0.0, "since the last"), model.discrete("n", "1", 0.0, "number")
    period = model.parameter("T", "s", 0.5, "time between two")
    model.derivative(x, 1 + 0 * x)
    model.when(x > period, {x: 0.0, count: count + 1}, name="reset")
    dae = model.freeze()
    for length in (0.5, 0.25, 0.2, 0.1, 0.05, 1 / 3, 0.125, 1.0, 0.3, 0.7, 0.15, 1 / 7):
        for stop in (1.0, 2.0, 3.0):
            values = {"T": length}
            run = cosim.simulate(dae, solver=solver, start_values=values, stop_time=stop)
            assert run.final["n"] * length + run.final["x"] == pytest.approx(stop, abs=1e-6)


@pytest.mark.parametrize("solver", ["dop853", "cvodes", "idas"])
def test_play_follows_its_pin_though_the_solver_drifts_from_it(solver):
    """The pin sin(t) moves the slot by its edges, 0.3 away on both sides."""
    model = cosim.Model("play", stop_time=10.0)
    w, u, du = model.state("w", "1", 0.0, "slot"), ca.sin(model.t), ca.cos(model.t)
    right, left = (ca.logic_and(s * (u - w) >= 0.3, s * du > 0) for s in (1, -1))
    model.derivative(w, ca.if_else(ca.logic_or(right, left), du, 0))
    run = cosim.simulate(model.freeze(), solver=solver)
    exact = np.sin(run.time) - 0.3  # pushed to the right at first
    turned = run.time > 1.5 * np.pi
    assert run.final["w"] == pytest.approx(np.sin(10.0) + 0.3, abs=1e-6)
    assert np.abs(run["w"] - exact)[(run.time > 0.4) & (run.time < np.pi / 2)].max() < 1e-6
    assert run["w"][turned].min() == pytest.approx(-0.7, abs=1e-6)
