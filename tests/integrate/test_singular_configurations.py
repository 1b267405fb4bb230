"""Singular configurations: runs into them are rejected with the remedy, projection passes them."""

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from casadi import SX

import cosim
from casadi_models.dae import Dae, Model
from casadi_models.mechanics.kane import InertialTerm
from casadi_models.mechanics.mechanism import mechanism
from cosim.errors import SolverError, UsageError
from cosim.integrate.engine import Counts
from cosim.integrate.motion import Motion
from cosim.integrate.outputs import Observed
from cosim.integrate.validity import (
    first_singular_configuration,
    times_between,
    with_singularity_margin,
)

FOUR_BARS = f"{Path(__file__).parents[2] / 'examples' / 'four_bars_a02.py'}:build"
FIRST = 0.7144  # s, when all bars lie in a line
PROJECTED = {"drift_control": "projection"}
NAMED = [
    {},
    {"solver": "idas"},
    {"solver": "ode15s"},
    {"solver": "rosenbrock"},
    {"drift_control": "baumgarte"},
    {"compiled": False},
    {"stop_when": "y0 < -0.5"},
    {"output_times": [0.5, 1.0]},
]


@pytest.fixture(scope="module")
def bars() -> Dae:
    return cosim.load(FOUR_BARS)


def other_continuation(dae, **options):
    """Run past the configuration along another motion, without an error of the solver."""
    lenient = cosim.solvers.Idas(suppress_algebraic=True)
    return cosim.simulate(dae, solver=lenient, stop_time=2.0, compiled=False, **options)


@pytest.mark.slow_rows("{'solver': 'rosenbrock'}", "{'stop_when': 'y0 < -0.5'}")
@pytest.mark.parametrize("options", NAMED, ids=str)
def test_run_without_projection_is_rejected_with_the_remedy(bars, options):
    span = {} if "output_times" in options else {"stop_time": 1.0}
    with pytest.raises(SolverError, match='drift_control="projection"') as caught:
        cosim.simulate(bars, **span, **options)
    assert caught.value.partial.time[-1] <= FIRST


def test_projection_keeps_the_motion_and_its_energy(bars):
    """The cranks stay parallel."""
    run = cosim.simulate(bars, stop_time=2.0, **PROJECTED)
    np.testing.assert_allclose(run["y1"], run["y0"], rtol=0, atol=1e-9)
    near = run["y0"] ** 2 < 1e-4  # outputs next to a singular configuration carry its condition
    energy = run["energy"][~near]
    np.testing.assert_allclose(energy, energy[0], rtol=1e-7)  # measured 3e-9
    assert run.stats.solver == "dop853"
    assert "invalid" not in run.stats


@pytest.mark.parametrize("solver", ["dop853", "ode8", "rk4"])
def test_projected_steps_of_every_solver_keep_to_their_motion(bars, solver):
    run = cosim.simulate(bars, solver=solver, stop_time=2.0, **PROJECTED)
    np.testing.assert_allclose(run["y1"], run["y0"], rtol=0, atol=1e-9)
    other = other_continuation(bars, on_invalid="ignore")
    assert np.abs(other["y1"] - run["y1"]).max() > 0.1  # one of the cranks stops


@pytest.mark.parametrize("interval", [0.01, 0.05, 0.1])
def test_configuration_is_seen_whatever_the_output_interval(bars, interval):
    with pytest.raises(SolverError, match=r"singular configuration at 0\.71") as caught:
        other_continuation(bars, output_interval=interval)
    partial = caught.value.partial
    assert FIRST - interval < partial.time[-1] < FIRST
    assert partial.status.startswith("stopped after 0.7")


def test_configuration_late_in_time_is_reported_with_hundredths_of_a_second(bars):
    late = {"start_time": 1e4, "stop_time": 1e4 + 1, "compiled": False}
    lenient = cosim.solvers.Idas(suppress_algebraic=True)
    with pytest.raises(SolverError, match=r"singular configuration at 10000\.71 s"):
        cosim.simulate(bars, solver=lenient, **late)


def test_run_that_ignores_validity_goes_on(bars):
    run = other_continuation(bars, on_invalid="ignore")
    assert run.complete
    assert "invalid" not in run.stats


@pytest.mark.parametrize("stop", [0.7147, 0.717, 0.72, 1.25])
def test_configuration_in_the_last_interval_is_seen(bars, stop):
    with pytest.raises(SolverError, match="singular configuration"):
        cosim.simulate(bars, stop_time=stop)


def test_motion_that_stays_singular_is_reported_where_it_becomes_so(bars):
    """Two cranks that lock in line: the condition, once lost, does not fall again."""
    time = np.linspace(0.0, 0.2, 21)
    states, unknowns = np.zeros((12, 21)), np.zeros((11, 21))
    states[:6] = [[0.0], [1.0], [1.0], [1.0], [2.0], [1.0]]
    motion = Motion(bars, time, states, unknowns, np.empty((0, 1)), np.empty(0), Counts())
    distance = np.where(time < 0.105, 0.5, 1e-7)[:, None]
    seen = Observed(np.empty((21, 0)), unknowns.T, 21, distance)
    found = first_singular_configuration(motion, seen, 21)
    assert (found.position, found.reason.time) == (11, time[11])
    assert "constraint_condition 1e+07" in found.reason


@pytest.mark.slow_rows("wanted0")
@pytest.mark.parametrize("wanted", [{"stop_when": "y0 < -0.5"}, {"output_times": [0.5, 1.0]}])
def test_projection_works_with_stop_conditions_and_output_times(bars, wanted):
    run = cosim.simulate(bars, outputs=["y0", "y1"], **wanted, **PROJECTED)
    np.testing.assert_allclose(run["y1"], run["y0"], rtol=0, atol=1e-9)


def test_variants_end_as_single_runs_do(bars):
    settings = {"outputs": ["y0", "y1"], "stop_time": 1.0}
    starts = {"x0_dot": [1.0, 3.0]}
    many = cosim.simulate_many(bars, starts, **settings, **PROJECTED)
    assert many.complete.all()
    one = cosim.simulate(bars, start_values={"x0_dot": 3.0}, **settings, **PROJECTED)
    np.testing.assert_array_equal(many.run(1)["y0"], one["y0"])
    without = cosim.simulate_many(bars, starts, **settings)
    assert not without.complete.any()
    assert all("singular configuration" in without.reasons[i] for i in range(2))


def test_reduced_model_is_watched_like_the_full_one(bars):
    small = cosim.reduce(bars, ["x0", "y0"])
    with pytest.raises(SolverError, match=r"singular configuration (at|near) 0\.71"):
        cosim.simulate(small, stop_time=2.0)
    run = cosim.simulate(small, stop_time=2.0, **PROJECTED)
    assert run.names == ("x0", "y0")


def test_failure_elsewhere_is_no_singular_configuration(bars):
    """The model ends where it has no solution; its configuration is not singular."""
    ending = replace(bars, alg=bars.alg / (bars.t < 0.3))
    with pytest.raises(SolverError, match=r"idas stopped after 0\.[23]") as caught:
        cosim.simulate(ending, stop_time=0.5)
    assert "singular configuration at" not in str(caught.value)


@pytest.mark.parametrize(
    "name", ["bicycle/multipliers", "disk_two_bars/multipliers", "bicycle/independent"]
)
def test_no_alarm_where_rank_is_kept(name):
    dae = cosim.load(name)
    assert with_singularity_margin(dae) is not dae
    run = cosim.simulate(dae, compiled=False, outputs=["energy"], stop_time=5.0)
    assert not [text for text in run.stats.get("invalid", ()) if "rank" in text]


@pytest.mark.slow
def test_fixed_steps_take_multipliers_with_projection_only(bars):
    with pytest.raises(UsageError, match="or drift control by projection"):
        cosim.simulate(bars, solver="ode8")
    dae = cosim.load("bicycle/multipliers")
    settings = {"stop_time": 2.0, "outputs": ["phi", "delta", "fz_P"]}
    run = cosim.simulate(dae, solver="ode8", **PROJECTED, **settings)
    other = cosim.simulate(dae, solver="rosenbrock", relative_tolerance=1e-10, **settings)
    assert cosim.compare(run, other).worst.scaled < 1e-8  # measured 3e-11


def test_times_between_outputs_keep_them_and_are_close_enough():
    dae = cosim.load("bicycle/multipliers")
    given = np.array([0.0, 0.005, 1.0])
    found = times_between(dae, given)
    assert {*given.tolist()} <= {*found.tolist()}
    assert np.diff(found).max() <= dae.experiment.output_interval * (1 + 1e-12)
    assert times_between(dae, found) is found
    assert len(times_between(dae, np.array([0.0, 1e6]))) == 20_001
    plain = cosim.load("crank_shaft")  # explicit, and valid always
    assert times_between(plain, given) is given


def parallel_linkage(turn):
    """Declare two cranks of 1 m and a coupler of 2 m, which are in a line where the cranks are.

    Args:
        turn: Angle by which the drawing is turned against the axes, rad.
    """
    model = Model("parallel_linkage", stop_time=1.0)
    starts = {"crank_1": 0.5037, "coupler": 0.0, "crank_2": 0.5037}
    q = ca.vertcat(*(model.state(n, "rad", start, n) for n, start in starts.items()))
    u, base = SX.sym("u", 3), 2 * ca.vertcat(np.cos(turn), np.sin(turn))
    first, coupler, second = (
        ca.vertcat(ca.cos(q[i] + turn), ca.sin(q[i] + turn)) for i in range(3)
    )
    inertias = []
    for i, (center, length) in enumerate(
        [(first / 2, 1), (first + coupler, 2), (base + second / 2, 1)]
    ):
        velocity = ca.jtimes(center, q, u)
        inertias += [InertialTerm(velocity, length * velocity)]
        inertias += [InertialTerm(u[i], length**3 / 12 * u[i])]
    loops = {"loop": first + 2 * coupler - second - base}
    mechanism(model, q, u, inertias, loops=loops, speed_starts={"crank_1": -1.0})
    return model.freeze()


@pytest.mark.parametrize("turn", [0.0, 0.1])
def test_loop_along_the_axes_hides_no_singular_configuration(turn):
    dae = parallel_linkage(turn)
    condition = ca.Function("condition", [dae.x], [dae.constraint_condition])
    for angle in (1e-2, 1e-4):
        near = np.array([angle, 0, angle, 0, 0, 0])
        found = float(condition(near))
        assert 0.1 < found * angle < 1  # measured 0.32, 0.42; 0.02 with rows of length 1
    with pytest.raises(SolverError, match=r"singular configuration .*projection"):
        cosim.simulate(dae)
