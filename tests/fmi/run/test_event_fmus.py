"""FMUs of models with events against closed forms, in every interface and master."""

from contextlib import closing

import casadi as ca
import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu
from helpers import event_models
from helpers.random_models import model_with_events, random_model

import cosim
from casadi_models.dae import Model
from cosim.api import execute, requested
from cosim.backend import Backend
from cosim.errors import FmuError, SolverError, UsageError
from cosim.fmi.run.opened import OpenedFmu

VERSIONS = pytest.mark.parametrize("fmi", [2, 3])
# interface, master, error of a run at relative tolerance 1e-9
RUNS = [
    ("CoSimulation", "fmpy", 1e-9),
    ("CoSimulation", "c", 1e-9),
    ("ModelExchange", "fmpy", 2e-7),
    ("ModelExchange", "c", 2e-7),
]
EACH_RUN = pytest.mark.parametrize(("interface", "master", "bound"), RUNS)


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """Return what exports a model once."""
    folder, known = tmp_path_factory.mktemp("events"), {}

    def export(name, fmi=2, *arguments, **options):
        key = f"{name}_{'_'.join(map(str, arguments))}_{fmi}{options.get('solver', '')}"
        if key not in known:
            dae = getattr(event_models, name)(*arguments)
            known[key] = cosim.export_fmu(dae, folder / f"{key}.fmu", fmi=fmi, **options)
        return known[key]

    return export


def simulate(path, interface, master, **options):
    return cosim.simulate_fmu(
        path, interface=interface, master=master, relative_tolerance=1e-9, **options
    )


def height(t):
    """Return the height of the ball, by the closed form of its impacts."""
    begin, v = np.sqrt(2 / event_models.G), np.sqrt(2 * event_models.G)
    if t < begin:
        return 1 - event_models.G * t**2 / 2
    v *= event_models.RESTITUTION
    while t > begin + 2 * v / event_models.G:
        begin += 2 * v / event_models.G
        v *= event_models.RESTITUTION
    return v * (t - begin) - event_models.G * (t - begin) ** 2 / 2


@pytest.mark.slow_rows("2-CoSimulation-fmpy-1e-09", "3-CoSimulation-fmpy-1e-09")
@EACH_RUN
@VERSIONS
def test_a_ball_bounces_at_the_times_of_the_closed_form(exported, fmi, interface, master, bound):
    run = simulate(exported("ball", fmi), interface, master)
    assert run.final["n"] == 4
    # measured 2e-15, 2e-15, 6e-9, 1e-12
    np.testing.assert_allclose(run["h"], [height(t) for t in run.time], rtol=0, atol=bound)


def test_the_impacts_of_the_step_solver_are_exact_as_well(exported):
    run = simulate(exported("ball", solver="rosenbrock"), "CoSimulation", "c")
    np.testing.assert_allclose(run["h"], [height(t) for t in run.time], rtol=0, atol=1e-9)


def test_fmpy_itself_runs_the_ball(exported):
    rows = fmpy.simulate_fmu(
        str(exported("ball")), fmi_type="ModelExchange", relative_tolerance=1e-9
    )
    assert rows["n"][-1] == 4
    assert rows["h"][-1] == pytest.approx(height(rows["time"][-1]), abs=2e-7)


@pytest.mark.quick_share(0.3)
@pytest.mark.slow_rows("0.001-CoSimulation-fmpy-1e-09", "1e-06-CoSimulation-fmpy-1e-09")
@EACH_RUN
@pytest.mark.parametrize("width", [1e-3, 1e-6])
def test_a_short_push_has_its_exact_impulse(exported, width, interface, master, bound):
    run = simulate(exported("pulse", 2, width), interface, master)
    assert run.final["v"] == pytest.approx(1000 * width, abs=1e-11)  # measured 1e-12


@pytest.mark.slow_rows("CoSimulation-fmpy-1e-09")
@EACH_RUN
def test_half_waves_add_up_to_four(exported, interface, master, bound):
    run = simulate(exported("rectified"), interface, master)
    assert run.final["y"] == pytest.approx(4, abs=2 * bound)  # measured 4e-14; fmpy's CVODE 2e-7


@pytest.mark.slow_rows("CoSimulation-fmpy-1e-09")
@EACH_RUN
def test_every_period_of_a_square_wave_is_met(exported, interface, master, bound):
    run = simulate(exported("square_wave"), interface, master)
    assert run.final["x"] == pytest.approx(0.002, abs=bound)  # measured 3e-16; fmpy's CVODE 1e-15


@pytest.mark.slow_rows("CoSimulation-fmpy-1e-09")
@EACH_RUN
def test_a_single_state_goes_on_after_its_event_at_0(exported, interface, master, bound):
    run = simulate(exported("falling"), interface, master)
    assert run.final["x"] == pytest.approx(-2 / 3, abs=bound)


@pytest.mark.quick_rows(
    "fmax-CoSimulation-c-1e-09", "fmax-ModelExchange-fmpy-2e-07", "fmax-ModelExchange-c-2e-07"
)
@EACH_RUN
@pytest.mark.parametrize("form", ["fmax", "if_else", "power"])
def test_branch_ends_where_its_law_is_not_defined(exported, form, interface, master, bound):
    run = simulate(exported("draining", 2, form), interface, master)
    assert run.final["x"] == pytest.approx(event_models.DRAINED, abs=bound)


@pytest.mark.slow_rows("2-CoSimulation-fmpy-1e-09", "3-CoSimulation-fmpy-1e-09")
@EACH_RUN
@VERSIONS
def test_a_sampled_controller_acts_at_its_samples(exported, fmi, interface, master, bound):
    run = simulate(exported("sampled", fmi), interface, master)
    samples = run["x"][::2][: 20 + 1]
    np.testing.assert_allclose(samples, 0.8 ** np.arange(21), rtol=0, atol=bound)


@pytest.mark.quick_share(0.3)
@pytest.mark.slow_rows(
    "7-CoSimulation-fmpy-1e-09", "10-CoSimulation-fmpy-1e-09", "23-CoSimulation-fmpy-1e-09"
)
@EACH_RUN
@pytest.mark.parametrize("period", [7, 10, 23])
def test_samples_at_output_times_are_in_their_rows(exported, period, interface, master, bound):
    run = simulate(exported("counting", 2, period), interface, master)
    np.testing.assert_array_equal(run["n"], 1 + np.arange(301) // period)


@pytest.mark.slow_rows("0.3")
@pytest.mark.parametrize("start", [0.3, 3 * 0.1, 0.6, 0.65])  # 3 * 0.1 is larger than 0.3
def test_samples_at_the_start_are_met_whatever_rounding_makes_of_it(exported, start):
    options = {"start_time": start, "stop_time": start + 0.25, "outputs": ["n"]}
    runs = [cosim.simulate(event_models.counting(10), **options)]
    runs += [simulate(exported("counting", 2, 10), *run[:2], **options) for run in RUNS]
    first = int(start != 0.65)
    for run in runs:
        assert [run["n"][0], run["n"][-1]] == [first, first + 2 + (start == 0.65)]


@pytest.mark.slow_rows("erk")
@pytest.mark.parametrize("solver", ["erk", "rosenbrock"])
def test_samples_at_communication_points_are_met_by_other_solvers(exported, solver):
    run = simulate(exported("counting", 3, 7, solver=solver), "CoSimulation", "c")
    np.testing.assert_array_equal(run["n"], 1 + np.arange(301) // 7)


def test_files_that_are_open_at_once_log_their_own_events(exported):
    files = exported("ball"), exported("counting", 2, 10)
    with closing(OpenedFmu(files[0], None)) as ball, closing(OpenedFmu(files[1], None)) as counter:
        runs = [fmu.run(fmu.request()) for fmu in (ball, counter, ball)]
        counter.close()
        runs.append(ball.run(ball.request()))
    impacts, samples, *again = [[event.name for event in run.events] for run in runs]
    assert {*impacts} == {"impact"}
    assert samples == ["sample"] * 31
    assert again == [impacts, impacts]


@pytest.mark.quick_share(0.3)
@pytest.mark.slow_rows("2-CoSimulation-fmpy-1e-09", "3-CoSimulation-fmpy-1e-09")
@EACH_RUN
@VERSIONS
def test_what_happens_at_the_stop_time_happens(exported, fmi, interface, master, bound):
    path = exported("late", fmi)
    run = simulate(path, interface, master, outputs=["n", "x"])
    assert (run.final["n"], run.final["x"]) == (16, 5)
    assert (run["n"][-2], run["x"][-2]) == (15, 0)


@pytest.mark.quick_share(0.3)
@pytest.mark.slow_rows("False-CoSimulation-fmpy-1e-09", "True-CoSimulation-fmpy-1e-09")
@EACH_RUN
@pytest.mark.parametrize("branches", [False, True])
def test_dry_friction_stops_a_block_and_holds_it(tmp_path, branches, interface, master, bound):
    path = cosim.export_fmu(event_models.block(branches=branches), tmp_path / "block.fmu")
    run = simulate(path, interface, master)
    standing = run.time > 0.75 + 1e-9  # s, 3 / 4
    assert np.abs(run["v"][standing]).max() < bound
    np.testing.assert_allclose(run["x"][standing], 9 / 8, rtol=0, atol=2 * bound)
    assert np.abs(run["friction"][standing]).max() < 1e-9


@pytest.mark.slow_rows("fmu-me")
@pytest.mark.parametrize("backend", ["fmu-me", "fmu-cs"])
def test_a_stop_of_the_model_completes_the_run_of_a_backend(backend):
    run = execute(requested(event_models.stopping()), Backend(backend))
    assert run.complete
    assert (run.time[-1], run.final["x"]) == pytest.approx((0.777, 0.777), abs=1e-9)


@pytest.mark.slow_rows("2-CoSimulation-fmpy-1e-09", "3-CoSimulation-fmpy-1e-09")
@EACH_RUN
@VERSIONS
def test_a_stop_of_the_model_ends_the_run_of_a_file(exported, fmi, interface, master, bound):
    run = simulate(exported("stopping", fmi), interface, master)
    assert run.complete
    assert len(run) == 79
    assert (run.time[-1], run.final["x"]) == pytest.approx((0.777, 0.777), abs=1e-9)
    assert run.stats["stop_time"] == run.time[-1]
    assert run.stats["stop"].startswith("the wall is reached from 0.77")
    native = cosim.simulate(event_models.stopping())
    assert run.stats["stop"].split()[:-3] == native.stats["stop"].split()[:-3]
    assert cosim.compare(native, run, resample=False).agrees


def test_crossings_between_two_steps_are_seen_in_co_simulation(exported):
    run = simulate(exported("glimpses"), "CoSimulation", "c")
    once = np.arccos(0.9999) / 20  # s
    assert run.final["y"] == pytest.approx(19 * once, abs=1e-7)  # 9 whole ones and half of one


@pytest.mark.slow_rows("ModelExchange-fmpy-2e-07")
@EACH_RUN
def test_impacts_that_come_ever_faster_are_an_error(tmp_path, interface, master, bound):
    path = cosim.export_fmu(event_models.ball(4.0), tmp_path / "ball.fmu")
    with pytest.raises(FmuError, match=r"'impact' happens ever faster before 2\.558"):
        simulate(path, interface, master)


@pytest.mark.slow
def test_a_solver_that_cannot_slide_says_so(exported):
    with pytest.raises(FmuError, match=r"slides along 0 at 0\.75 s.*solver dop853"):
        simulate(exported("block", solver="rosenbrock"), "CoSimulation", "c")


@pytest.mark.slow
@VERSIONS
def test_every_kind_of_event_agrees_with_native_simulation(exported, fmi):
    native = cosim.simulate(event_models.everything(), solver="rosenbrock")
    for interface, master, _ in RUNS:
        run = simulate(exported("everything", fmi), interface, master)
        assert run.final["n"] == pytest.approx(native.final["n"], abs=1e-12)
        assert run.final["x"] == pytest.approx(native.final["x"], abs=1e-6)


@pytest.mark.slow_rows("everything-3")
@VERSIONS
@pytest.mark.parametrize("name", ["ball", "everything", "sampled"])
def test_files_with_events_are_valid(exported, name, fmi):
    path = exported(name, fmi)
    assert validate_fmu(str(path)) == []
    assert cosim.check_fmu(path) == []


def test_a_variable_that_is_named_like_a_mode_is_rejected(tmp_path):
    model = Model("taken")
    x = model.state("mode_1", "m", 1.0, "place")
    model.derivative(x, -1.0)
    model.when(x < 0, {x: 1.0})
    with pytest.raises(UsageError, match="has a variable 'mode_1' of its own; rename it"):
        cosim.export_fmu(model.freeze(), tmp_path / "taken.fmu")


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(24))
def test_random_models_are_those_of_native_simulation(seed, tmp_path):
    dae = random_model(seed, algebraic=seed % 3 == 0)
    names = [variable.name for variable in dae.states]
    try:
        native = cosim.simulate(dae, relative_tolerance=1e-9)[names].values
    except SolverError:
        pytest.skip("it slides on the edge of a floor, which is rejected")
    path = cosim.export_fmu(dae, tmp_path / "random.fmu", fmi=2 + seed % 2)
    for interface in ("CoSimulation", "ModelExchange"):
        run = cosim.simulate_fmu(path, interface=interface, relative_tolerance=1e-8)
        # measured 4e-6 at most, by fmpy's CVODE after 40 events
        np.testing.assert_allclose(run[names].values, native, rtol=0, atol=2e-5)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 13))
def test_events_of_random_models_are_those_of_native_simulation(seed, tmp_path):
    """Samples often fall on communication points, but for rounding."""
    dae = model_with_events(seed)
    try:
        native = cosim.simulate(dae, solver="dop853", relative_tolerance=1e-10)
    except SolverError:
        pytest.skip("its impacts come ever faster, which is rejected")
    events = np.array([event.time for event in native.events])
    apart = np.abs(native.time[:, None] - events).min(axis=1) > 1e-6  # which side is chance
    path = cosim.export_fmu(dae, tmp_path / "random.fmu", fmi=2 + seed % 2)
    for interface, master, _ in RUNS:
        run = simulate(path, interface, master)
        names = [variable.name for variable in dae.states]
        # measured 1e-9 in co-simulation, 1e-5 by fmpy's CVODE
        assert np.abs(run[names].values - native[names].values)[apart].max() < 1e-4


@pytest.mark.slow_rows(
    "CoSimulation-fmpy-1e-09-2",
    "CoSimulation-fmpy-1e-09-3",
    "CoSimulation-c-1e-09-3",
    "ModelExchange-fmpy-2e-07-3",
    "CoSimulation-c-1e-09-2",
    "ModelExchange-c-2e-07-3",
)
@VERSIONS
@EACH_RUN
def test_events_are_those_of_native_simulation(exported, fmi, interface, master, bound):
    for name in ("ball", "block", "square_wave"):
        native = cosim.simulate(getattr(event_models, name)(), relative_tolerance=1e-10)
        options = {"interface": interface, "master": master, "relative_tolerance": 1e-9}
        run = cosim.simulate_fmu(exported(name, fmi), **options)
        names = [[event.name for event in found.events] for found in (native, run)]
        assert names[0] == names[1]
        ours, others = ([event.time for event in found.events] for found in (native, run))
        np.testing.assert_allclose(ours, others, rtol=0, atol=max(bound, 1e-7))


@pytest.mark.slow_rows("rosenbrock")
@pytest.mark.parametrize("solver", ["rosenbrock", "erk"])
def test_events_within_long_communication_steps_are_met(exported, solver):
    """An oscillator of 95 Hz, whose passages upwards are counted."""
    path = exported("oscillator", 2, solver=solver)
    for interval in (0.5, 0.01, 1e-3):
        run = simulate(path, "CoSimulation", "c", output_interval=interval)
        assert run.final["n"] == int(600.0 * 2 / (2 * np.pi) + 0.25)


def test_crosscheck_compares_times_of_events():
    scene = cosim.Scene("ball", requested(event_models.ball()))
    rows = cosim.crosscheck(scene).rows()
    assert [row["events"] for row in rows] == ["4", "4"]
    assert all(row["event_shift"] < 1e-8 for row in rows)  # measured 4e-10


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("name", ["ball", "block", "square_wave", "sampled", "stopping"])
def test_event_mode_of_co_simulation_gives_the_same_run(exported, name):
    path = str(exported(name, 3))
    options = {"fmi_type": "CoSimulation", "relative_tolerance": 1e-9, "output_interval": 0.01}
    within = fmpy.simulate_fmu(path, **options)
    beside = fmpy.simulate_fmu(path, use_event_mode=True, early_return_allowed=True, **options)
    assert len(beside) > len(within)  # fmpy adds rows at events
    times, last = np.unique(beside["time"][::-1], return_index=True)  # with what is after them
    after = beside[::-1][last]
    for column in within.dtype.names[1:]:
        found = np.interp(within["time"], times, after[column])
        np.testing.assert_allclose(found, within[column], rtol=0, atol=1e-9, err_msg=column)


def test_event_mode_is_declared_where_there_are_events(exported, tmp_path):
    assert fmpy.read_model_description(exported("ball", 3)).coSimulation.hasEventMode
    path = cosim.export_fmu(cosim.load("crank_shaft"), tmp_path / "x.fmu", fmi=3)
    assert not fmpy.read_model_description(path).coSimulation.hasEventMode


@VERSIONS
def test_parameters_of_events_may_change_during_a_run(tmp_path, fmi):
    model = Model("tuned", stop_time=3.0)
    x, n = model.state("x", "m", 0.0, "place"), model.discrete("n", "1", 0.0, "number")
    far, more = model.parameter("far", "m", 0.4, "where"), model.parameter("more", "1", 2.0, "step")
    model.derivative(x, 1.0)
    model.when(x > far, {n: n + more}, name="there")
    path = cosim.export_fmu(
        model.freeze(), tmp_path / "tuned.fmu", fmi=fmi, tunable=["far", "more"]
    )
    description = fmpy.read_model_description(str(path))
    references = {v.name: v.valueReference for v in description.modelVariables}
    instance = fmpy.instantiate_fmu(fmpy.extract(str(path)), description, "CoSimulation")
    start = {"startTime": 0.0}
    if fmi == 2:
        instance.setupExperiment(**start)
    instance.enterInitializationMode(**({} if fmi == 2 else start))
    instance.exitInitializationMode()
    set_numbers = instance.setReal if fmi == 2 else instance.setFloat64
    get_numbers = instance.getReal if fmi == 2 else instance.getFloat64
    found = []
    for step in range(4):
        if step == 2:
            set_numbers([references["far"], references["more"]], [1.7, 5.0])
        instance.doStep(0.5 * step, 0.5)
        found += get_numbers([references["n"]])
    instance.terminate()
    instance.freeInstance()
    assert found == [2, 2, 2, 7]


@pytest.fixture(scope="module", params=[2, 3])
def threshold(request, tmp_path_factory):
    """Return an FMU that counts how often an input passes a state, and integrates its steps."""
    model = cosim.Model("threshold", description="an input and a state", stop_time=2.0)
    y, steps = (model.state(name, "1", 0.0, name) for name in ("y", "steps"))
    u = model.input("u", "1", 0.0, "input")
    rate, level = model.parameter("rate", "1/s", 0.0, "y'"), model.parameter("level", "1", 0.5, "c")
    count = model.discrete("count", "1", 0.0, "events")
    model.derivative(y, rate)
    model.derivative(steps, ca.floor(2 * (u - y)))
    model.when(u - y > level, {count: count + 1}, name="passed")
    folder = tmp_path_factory.mktemp("threshold")
    return cosim.export_fmu(model.freeze(), folder / "threshold.fmu", fmi=request.param)


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize(
    ("law", "rate", "level", "time"),
    [
        ("t", 0.5, 0.3, 0.6),
        ("t", 0.0, 0.5, 0.5),
        ("0.6*t", 0.0, 0.5, 0.5 / 0.6),
        ("0.37*t", 0.0, 0.5, 0.5 / 0.37),
        ("0.2*t", -0.5, 0.5, 0.5 / 0.7),
        ("2*t + 0.1*t^2", 1.0, 0.2, 5 * (np.sqrt(1.08) - 1)),
    ],
)
def test_threshold_that_an_input_passes_is_met_in_model_exchange(threshold, law, rate, level, time):
    """An importer of model exchange tells no rate of an input, which may oppose the known one."""
    run = cosim.simulate_fmu(
        threshold,
        interface="ModelExchange",
        inputs={"u": law},
        start_values={"rate": rate, "level": level},
        output_interval=0.07,
        relative_tolerance=1e-9,
    )
    passed = [event.time for event in run.events if event.name == "passed"]
    assert passed == pytest.approx([time], abs=1e-12)
    assert run.final["count"] == 1
    t = np.linspace(0, 2, 2_000_001)
    value = eval(law.replace("^", "**"), {"t": t}) - rate * t
    assert run.final["steps"] == pytest.approx(np.floor(2 * value).mean() * 2, abs=1e-5)
