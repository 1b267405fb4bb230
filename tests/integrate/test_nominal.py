"""Tolerances that count in nominal values, given or found."""

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from casadi import SX

import cosim
from casadi_models.dae import Model
from cosim.api import simulate
from cosim.integrate.call import INTERRUPTED
from cosim.integrate.events import integrate
from cosim.integrate.nominal import Nominal, scaled
from cosim.integrate.solvers import SOLVERS
from cosim.model.inputs import InputSeries
from cosim.text import Ending

EXAMPLES = Path(__file__).parents[2] / "examples"
BINARY = 2.0**20  # micrometers in a meter, nearly, and no rounding
ADAPTIVE = [name for name, solver in SOLVERS.items() if solver.adaptive]


def swing(size: float, nominal: float, algebraic: bool):
    """Return a pendulum whose length is measured in another unit, 1 / size of the usual one."""
    model = Model("swing", stop_time=3.0, output_interval=0.1)
    facts = {"nominal": nominal} if nominal != 1 else {}
    s = model.state("s", "m", 0.5 * size, "arc", **facts)
    v = model.state("v", "m/s", 0.0, "speed", **facts)
    model.derivative(s, v)
    rate = -9.81 * size * ca.sin(s / size)
    if algebraic:
        a = model.algebraic("a", "m/s2", 0.0, "acceleration", **facts)
        model.equation((a - rate) / size)
        rate = a
    model.derivative(v, rate)
    return model.freeze()


def interpreted(solver: str) -> dict:
    return {"solver": solver, "compiled": solver == "dop853"}


@pytest.mark.slow_rows("dop853-False", "dop853-True")
@pytest.mark.parametrize("algebraic", [False, True])
@pytest.mark.parametrize("solver", ADAPTIVE)
def test_unit_of_measure_changes_no_bit_of_a_run(solver, algebraic):
    if algebraic and not SOLVERS[solver].solves_dae:
        return
    settings = interpreted(solver) | {"outputs": ["s", "v"], "absolute_tolerance": 1e-10}
    runs = [simulate(swing(size, size, algebraic), **settings) for size in (1.0, BINARY)]
    assert runs[0].stats["steps"] == runs[1].stats["steps"]
    np.testing.assert_array_equal(runs[0].values, runs[1].values / BINARY)


@pytest.mark.slow
def test_lanes_count_in_nominal_values_too():
    runs = [
        cosim.simulate_many(swing(size, size, False), {"v": np.linspace(0, 1, 5) * size})
        for size in (1.0, BINARY)
    ]
    np.testing.assert_array_equal(runs[0].steps, runs[1].steps)
    np.testing.assert_array_equal(runs[0]["s"], runs[1]["s"] / BINARY)


def test_given_absolute_tolerance_counts_in_nominal_values():
    steps = [
        simulate(swing(1.0, nominal, False), solver="erk", absolute_tolerance=a, compiled=False)
        for nominal, a in ((4.0, 1e-6), (1.0, 4e-6), (1.0, 1e-6))
    ]
    assert steps[0].stats["steps"] == steps[1].stats["steps"] != steps[2].stats["steps"]


def test_bare_integrator_counts_in_nominal_values():
    dae = swing(BINARY, BINARY, True)
    grid = np.linspace(0, 3, 31)
    run = simulate(dae, solver="idas", compiled=False)
    found = cosim.integrator(dae, grid, solver="idas", compiled=False)
    end = found(**cosim.start_vectors(dae))
    np.testing.assert_allclose(np.array(end["xf"])[0], run["s"], rtol=1e-13)
    np.testing.assert_allclose(np.array(end["zf"])[0], run["a"], rtol=1e-6)


def decay(size: float):
    """Return what turns into its square at a rate of its own size; none has a nominal value."""
    model = Model("decay", stop_time=2.0, output_interval=0.1)
    a = model.state("a", "1", size, "first")
    b = model.state("b", "1", 0.0, "what became of it")
    model.derivative(a, -(a**2) / size)
    model.derivative(b, a**2 / size)
    return model.freeze()


@pytest.mark.parametrize("solver", ["cvodes", "rosenbrock", "dop853"])
@pytest.mark.parametrize("size", [1e-6, 1e-9])
def test_small_initial_values_are_their_own_nominal_values(solver, size):
    """a(t) = size / (1 + t)."""
    run = simulate(decay(size), **interpreted(solver))
    exact = size / (1 + run.time)
    wrong = np.abs(run["a"] / exact - 1).max()
    assert wrong < 1e-6  # measured 2e-8 to 3e-7
    given = simulate(decay(size), **interpreted(solver), absolute_tolerance=1e-10)
    assert np.abs(given["a"] / exact - 1).max() > 100 * wrong  # as it was requested
    assert "note" not in given.stats


def swinging(size: float):
    """Return x(t) = size cos(2 t)."""
    model = Model("swinging", stop_time=5.0)
    x, v = model.state("x", "m", size, "place"), model.state("v", "m/s", 0.0, "speed")
    force = model.input("force", "m/s2", 0.0, "force over mass")
    model.derivative(x, v)
    model.derivative(v, force - 4 * x)
    return model.freeze()


SIZES = [1e-300, 1e-100, 1e-20, 1e-14, 1e-9, 1e-7, 1e-3, 1.0, 1e3]


def error_of_swing(run, size):
    return np.abs(run["x"] / size - np.cos(2 * run.time)).max()


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("solver", ADAPTIVE)
@pytest.mark.parametrize("size", SIZES)
def test_swing_of_any_size_is_as_accurate_as_that_of_1(solver, size):
    run = simulate(swinging(1.0), start_values={"x": size}, **interpreted(solver))
    assert error_of_swing(run, size) < 1e-5  # measured 4e-8 (erk) to 6e-6 (idas)


def test_small_swing_stays_accurate_after_a_jump_of_an_input():
    still = InputSeries(("force",), [0.0, 1.0, 1.0, 5.0], [[0.0], [0.0], [0.0], [0.0]])
    run = simulate(swinging(1e-9), inputs=still)
    assert error_of_swing(run, 1e-9) < 1e-5  # measured 2e-6; 0.4 if each piece has its own sizes


@pytest.mark.quick_rows("1e-09")
@pytest.mark.parametrize("size", [1e-100, 1e-9, 1e-7])
def test_fmu_and_bare_integrator_follow_a_small_swing(size, tmp_path):
    dae = swinging(size)
    path = cosim.export_fmu(dae, tmp_path / "swing.fmu")
    for interface in ("ModelExchange", "CoSimulation"):
        run = cosim.simulate_fmu(path, interface=interface, relative_tolerance=1e-8)
        assert error_of_swing(run, size) < 1e-4  # measured 5e-6; 0.1 for 1e-7 with nominal 1
    found = cosim.integrator(dae, [0.0, 5.0], solver="cvodes", derivatives=False)
    end = float(found(**cosim.start_vectors(dae))["xf"][0, 1])
    assert end / size == pytest.approx(np.cos(10.0), abs=1e-5)


@pytest.mark.parametrize("size", SIZES)
def test_lanes_follow_swings_of_any_size(size):
    many = cosim.simulate_many(swinging(1.0), {"x": [1.0, size, 1e-9]}, lanes=1)
    errors = np.abs(many["x"] / many.start_values["x"][:, None] - np.cos(2 * many.time))
    assert errors.max() < 1e-6  # measured 3e-7; 0.1 for 1e-9 with nominal 1


@pytest.mark.parametrize("start", [1e-11, 1e-5])
@pytest.mark.parametrize("solver", ["cvodes", "erk", "dop853"])
def test_growth_from_a_small_start_is_as_accurate_as_from_1(solver, start):
    """x(t) = start exp(t)."""
    model = Model("growth", stop_time=float(np.log(1 / start)))
    x = model.state("x", "1", start, "what grows")
    model.derivative(x, x)
    run = simulate(model.freeze(), **interpreted(solver))
    assert run["x"][-1] == pytest.approx(1.0, rel=3e-6)  # measured 1e-9 (dop853) to 1e-6


def test_rounding_errors_are_no_nominal_values():
    declared = Nominal.declared(decay(1e-16))
    beside_one = declared.from_start(decay(1e-16), np.array([1e-16, 1.0]), np.empty(0), 1e-10)
    assert beside_one.x == (1, 1)
    alone = declared.from_start(decay(1e-16), np.array([1e-16, 0.0]), np.empty(0), 1e-10)
    assert alone.x == (2.0**-53, 1)


@pytest.mark.filterwarnings("error")
def test_start_whose_reciprocal_overflows_is_no_nominal_value():
    dae = swing(1.0, 1.0, algebraic=False)
    for start in (1e-320, 5e-324):
        many = cosim.simulate_many(dae, {"s": [start]}, output_times=[1.0])
        run = simulate(dae, start_values={"s": start}, stop_time=1.0, solver="dop853")
        for end in (many["s"][0, 0], run.final["s"]):
            assert end == pytest.approx(np.cos(np.sqrt(9.81)) * start, abs=1e-321)


@pytest.mark.slow
def test_large_unknowns_without_nominal_values_stop_idas_no_longer():
    """Accelerations of 1e5 rad/s2 pass 0, where 1e-12 of them was asked for."""
    dae = cosim.load(f"{EXAMPLES / 'andrews.py'}:build")

    def bare(variables):
        return tuple(replace(v, nominal=1.0) for v in variables)

    plain = replace(dae, states=bare(dae.states), algebraics=bare(dae.algebraics))
    settings = {"relative_tolerance": 1e-10, "compiled": False, "outputs": ["q_1"]}
    run, other = simulate(plain, **settings), simulate(dae, **settings)
    assert run["q_1"][-1] == pytest.approx(other["q_1"][-1], rel=1e-8)


def test_scaled_invariants_vanish_with_the_model_s():
    dae = swing(BINARY, BINARY, False)
    assert scaled(dae, Nominal.none(dae)) is dae
    assert Nominal.declared(dae) == Nominal((BINARY, BINARY), ())
    pendulum = cosim.load(f"{EXAMPLES / 'pendulum_a01.py'}:build")
    nominal = Nominal((4.0,) * len(pendulum.states), (1.0,) * len(pendulum.algebraics))
    inner = scaled(pendulum, nominal)
    for old, new in zip(pendulum.invariants, inner.invariants, strict=True):
        laws = [
            ca.Function("law", [pendulum.x, pendulum.p], [i.residual, SX(i.sizes)])
            for i in (old, new)
        ]
        x = np.arange(1.0, 1 + len(pendulum.states))
        p = [v.start for v in pendulum.parameters]
        (residual, sizes), (again, less) = laws[0](x, p), laws[1](x / 4, p)
        np.testing.assert_array_equal(np.array(residual), np.array(again))
        np.testing.assert_allclose(np.array(sizes), 4 * np.array(less))


@pytest.mark.slow_rows("rosenbrock")
@pytest.mark.parametrize("solver", ["idas", "rosenbrock"])
def test_one_library_serves_every_start(solver):
    """An unknown without nominal value begins at 3, at 3e3 and at 3e6."""
    model = Model(f"served_by_{solver}", stop_time=1.0)
    x = model.state("x", "m", 1.0, "place")
    z = model.algebraic("z", "N", 0.0, "force")
    model.derivative(x, -x)
    model.equation(z - 3 * x)
    dae = model.freeze()
    compiled = []
    for size in (1.0, 1e3, 1e6):
        run = simulate(dae, start_values={"x": size}, solver=solver, compiled=True)
        compiled.append(run.stats.compile_time is not None)
        np.testing.assert_allclose(run["z"], 3 * size * np.exp(-run.time), rtol=0, atol=1e-4 * size)
    assert compiled[1:] == [False, False]


def charge(nominal: float = 1.0, capacity: float = 1e-9):
    """Return an RC circuit on a sine of 5 V, 1 kHz, and its charge at 5 ms by the closed form."""
    t, q = SX.sym("t"), SX.sym("q")
    w, resistance = 2 * np.pi * 1000, 1e-5 / capacity
    problem = {"t": t, "x": q, "ode": (5 * ca.sin(w * t) - q / capacity) / resistance}
    times = {"stop_time": 0.005, "output_interval": 1e-5}
    dae = cosim.from_casadi(problem, {"q": 0.0}, {}, nominals={"q": nominal}, name="rc", **times)
    turn = w * 1e-5
    return dae, capacity * 5 / (1 + turn**2) * (np.sin(w * 0.005) - turn * np.cos(w * 0.005))


@pytest.mark.parametrize("solver", ["cvodes", "dop853"])
def test_the_note_names_the_states_whose_digits_are_not_controlled(solver):
    dae, exact = charge()
    run = simulate(dae, solver=solver)
    assert "most digits of q (at most" in run.stats.note
    for dae, exact in (charge(nominal=1e-9), charge(capacity=0.1)):
        run = simulate(dae, solver=solver)
        assert run.stats.note is None
        assert run.final["q"] == pytest.approx(exact, rel=1e-4)
    assert simulate(charge()[0], solver=solver, absolute_tolerance=1e-18).stats.note is None


def oscillator():
    model = Model("oscillator", stop_time=2 * np.pi, output_interval=np.pi)
    x, v = model.state("x", "m", 1.0, "place"), model.state("v", "m/s", 0.0, "speed")
    model.derivative(x, v)
    model.derivative(v, -x)
    return model.freeze()


@pytest.mark.parametrize("solver", ["cvodes", "dop853", "fmu"])
def test_states_that_are_small_in_the_rows_only_are_not_noted(solver, tmp_path):
    dae = oscillator()
    if solver == "fmu":
        path = cosim.export_fmu(dae, tmp_path / "oscillator.fmu")
        run = cosim.simulate_fmu(path, interface="ModelExchange")
        assert not run.stats.get("note")
    else:
        assert simulate(dae, solver=solver, output_times=[np.pi]).stats.note is None


def test_ctrl_c_while_small_states_are_looked_at_ends_the_run(monkeypatch):
    reasons = iter([Ending(), INTERRUPTED])
    monkeypatch.setattr(
        "cosim.integrate.run.integrate",
        lambda *values: replace(integrate(*values), reason=next(reasons)),
    )
    with pytest.raises(KeyboardInterrupt):
        simulate(oscillator(), output_times=[np.pi])


def hunters(start: float):
    """Return prey and predators, x' = x (1 - y), y' = y (x - 1), with equal starts."""
    model = Model("hunters", stop_time=60.0, output_interval=0.1)
    x, y = (model.state(name, "1", start, name) for name in "xy")
    model.derivative(x, x * (1 - y))
    model.derivative(y, y * (x - 1))
    return model.freeze()


def test_the_note_names_states_that_grow_from_a_trough():
    note = simulate(hunters(12.0)).stats.note
    assert "x shrinks to" in note
    assert simulate(hunters(2.0)).stats.note is None


@pytest.mark.parametrize("start", [0.0, 1e-17, 1.0])
def test_no_note_for_what_rests_decays_or_is_rounding(start):
    model = Model("decay", stop_time=40.0, output_interval=0.1)
    x, y = (model.state(name, "1", value, name) for name, value in (("x", start), ("y", 1.0)))
    model.derivative(x, -x)
    model.derivative(y, 0 * y)
    assert simulate(model.freeze()).stats.note is None
