"""Events in the runtime: saved states, event mode, time events, derivatives while sliding."""

import math
from ctypes import byref, c_bool, c_double, c_int, c_void_p

import pytest
from helpers import event_models, harness
from helpers.harness import DISCARD, ERROR, OK, EventInfo, reals

BALL = ("time", "h", "v", "n", "der(h)", "der(v)", "der(n)", "mode_1", "event_indicator_1")
BLOCK = ("time", "x", "v", "der(x)", "der(v)", "mode_1", "friction", "event_indicator_1")
LEFT = ("time", "x", "w", "der(x)", "der(w)", "u", "mode_1", "force")
SAMPLED = ("time", "x", "u", "der(x)", "der(u)", "mode_1")
HOLDING = ("time", "x", "n", "y", "der(x)", "der(n)", "der(y)", "u", "mode_1", "period")
HUMMING = ("time", "x", "der(x)", "y")
LIMITED = ("time", "x", "der(x)")
STUCK = ("time", "v", "der(v)", "u", "mode_1", "mu", "friction", "event_indicator_1")
POLE = ("time", "x", "y", "n", "der(x)", "der(y)", "der(n)", "mode_1", "valid_margin_1")


@pytest.fixture(scope="module")
def make(tmp_path_factory):
    """Make instances of a model: 0 for model exchange, 1 for co-simulation."""
    libraries, made = {}, []

    def instance(name, names, interface, version=2, given=(), solver="dop853", **options):
        key = name, version, solver
        if key not in libraries:
            folder = tmp_path_factory.mktemp(name)
            dae = getattr(event_models, name)(*given)
            event_models.write(folder, dae, solver, fmi=version, most_trials=2000)
            libraries[key] = harness.library(folder, version, folder)
        kind = harness.Fmu2 if version == 2 else harness.Fmu3
        made.append(kind(libraries[key], names, interface, **options))
        return made[-1]

    yield instance
    for fmu in made:
        fmu.free()


def update(fmu):
    """Call fmi2NewDiscreteStates."""
    info = EventInfo()
    assert fmu("NewDiscreteStates", byref(info)) == OK, fmu.said
    assert not info.needed
    return info


def move(fmu, time, *states):
    assert fmu("SetTime", c_double(time)) == OK
    assert fmu("SetContinuousStates", reals(*states), len(states)) == OK


@pytest.mark.slow
def test_a_rollback_in_the_middle_of_bounces_gives_the_same_bits(make):
    fmu, other = (make("ball", BALL, 1).initialize() for _ in range(2))
    for k in range(8):
        assert fmu("DoStep", k * 0.125, 0.125, 1) == OK
    snapshot = fmu.take()
    assert fmu("DoStep", 1.0, 1.0, 1) == OK
    once = fmu.get(*BALL)
    assert fmu("SetFMUstate", snapshot) == OK
    blob, copy = fmu.serialize(snapshot), c_void_p()
    assert other("DeSerializeFMUstate", blob, len(blob), byref(copy)) == OK
    assert other("SetFMUstate", copy) == OK
    for again in (fmu, other):
        assert again("DoStep", 1.0, 1.0, 1) == OK
        assert again.get(*BALL) == once
    assert once[3] == 4


@pytest.mark.quick_rows("64")
@pytest.mark.parametrize("steps", [1, 7, 64])
def test_impacts_do_not_depend_on_the_communication_step(make, steps):
    runs = []
    for count in (1, steps):
        fmu = make("ball", BALL, 1).initialize()
        for k in range(count):
            assert fmu("DoStep", c_double(k * 2 / count), c_double(2 / count), 1) == OK, fmu.said
        runs.append(fmu.get("h", "v", "n"))
    assert runs[0] == pytest.approx(runs[1], abs=1e-12)


def test_a_reset_forgets_all_events(make):
    fmu = make("ball", BALL, 1).initialize()
    assert fmu("DoStep", 0.0, 1.0, 1) == OK
    used = fmu.get(*BALL)
    assert fmu("Reset") == OK
    fmu.initialize()
    assert fmu("DoStep", 0.0, 1.0, 1) == OK
    assert fmu.get(*BALL) == used


def test_an_impact_happens_once_and_a_look_without_motion_changes_nothing(make):
    fmu = make("ball", BALL, 0).initialize()
    assert not update(fmu).values
    assert fmu("EnterContinuousTimeMode") == OK
    move(fmu, 0.45, -1e-16, -4.4, 0.0)
    assert fmu("EnterEventMode") == OK
    info = update(fmu)
    assert info.values
    assert not info.defined
    assert fmu.get("h", "v", "n", "mode_1") == pytest.approx([0, 0.7 * 4.4, 1, -1], abs=1e-15)
    before = fmu.get(*BALL)
    assert not update(fmu).values
    assert fmu.get(*BALL) == before
    indicator = reals(0)
    assert fmu("GetEventIndicators", indicator, 1) == OK
    assert 0 < indicator[0] < 1e-12


def test_modes_are_no_inputs(make):
    fmu = make("ball", BALL, 0).initialize()
    assert fmu.set(mode_1=1.0) == ERROR
    assert fmu.said.endswith("mode_1, a calculated mode, cannot be set now")


@pytest.mark.slow
def test_samples_are_time_events(make):
    fmu = make("sampled", SAMPLED, 0).initialize()
    info = update(fmu)
    assert (info.values, info.defined) == (1, 1)
    assert info.next_time == 0.1
    assert fmu.get("u") == [-2.0]
    assert fmu("EnterContinuousTimeMode") == OK
    move(fmu, 0.1, 0.8, -2.0)
    assert fmu("EnterEventMode") == OK
    assert update(fmu).next_time == 0.2
    assert fmu.get("u") == [-1.6]


@pytest.mark.slow
def test_a_stop_ends_the_simulation_in_both_versions(make):
    names = ("time", "x", "der(x)", "mode_1", "event_indicator_1")
    fmu = make("stopping", names, 1).initialize()
    assert fmu("DoStep", 0.0, 1.0, 1) == DISCARD
    assert fmu.said == "fmi2DoStep: the run ends at 0.777 s: the wall is reached"
    ended, last = c_int(), c_double()
    assert fmu("GetBooleanStatus", 3, byref(ended)) == OK
    assert fmu("GetRealStatus", 2, byref(last)) == OK
    assert (ended.value, last.value) == (1, pytest.approx(0.777, abs=1e-15))
    status, (event, ends, early), reached = (
        make("stopping", names, 1, 3).initialize().step(0.0, 1.0)
    )
    assert (status, event, ends, early) == (OK, False, True, False)
    assert reached == last.value


@pytest.mark.slow
def test_there_are_derivatives_of_the_present_mode_but_none_while_sliding(make):
    fmu, result = make("block", BLOCK, 1).initialize(), reals(0)

    def derivative():
        known, unknown = fmu.refs("v"), fmu.refs("der(x)")
        return fmu("GetDirectionalDerivative", unknown, 1, known, 1, reals(1.0), result)

    assert derivative() == OK
    assert result[0] == 1.0
    assert fmu("DoStep", 0.0, 1.0, 1) == OK
    assert fmu.get("v", "der(v)", "mode_1", "friction") == pytest.approx([0] * 4, abs=1e-12)
    assert derivative() == DISCARD
    assert fmu.said.endswith("there are no derivatives while an expression slides along 0")


def test_rates_of_outputs_at_an_event_count_no_input_that_was_asked_for(make):
    """u = 2 t and x = t leave the spring at 0.1 s; with u at rest its force falls by 100 N/s."""
    fmu = None

    def give(_, time, asks, *__):
        if asks:
            fmu.set(u=2 * time)

    fmu = make("left", LEFT, 1, 3, events=True, update=give, wanted=["u"])
    fmu.initialize({"tolerance": 1e-9})
    assert fmu("EnterStepMode") == OK
    status, (event, *_), reached = fmu.step(0.0, 1.0)
    assert (status, event) == (OK, True)
    assert reached == pytest.approx(0.1, abs=1e-12)
    rate = reals(0.0)
    assert fmu("GetOutputDerivatives", fmu.refs("force"), 1, (c_int * 1)(1), rate, 1) == OK
    assert rate[0] in (pytest.approx(0), pytest.approx(-100))  # either side; -300 with that of u


def test_rates_of_an_output_that_varies_faster_than_the_states_are_accurate(make):
    fmu = make("humming", HUMMING, 1).initialize({"stop": 1000.0})
    assert fmu("DoStep", 0.0, 0.25, 1) == OK
    rates, orders = reals(0, 0, 0), (c_int * 3)(1, 2, 3)
    assert fmu("GetRealOutputDerivatives", fmu.refs(*["y"] * 3), 3, orders, rates) == OK
    exact = [100 * math.cos(25), -(100**2) * math.sin(25), -(100**3) * math.cos(25)]
    assert list(rates) == pytest.approx(exact, rel=1e-8)


@pytest.mark.parametrize("start", [1e6, 1e9])
def test_rates_of_an_output_are_accurate_at_late_times(make, start):
    fmu = make("swinging", HUMMING, 1).initialize({"start": start})
    rates = math.cos(start), -math.sin(start), -math.cos(start)
    for order, exact in enumerate(rates, start=1):
        rate = reals(math.nan)
        status = fmu("GetRealOutputDerivatives", fmu.refs("y"), 1, (c_int * 1)(order), rate)
        assert (status, *rate) == (OK, pytest.approx(exact, abs=1e-6))  # measured 2e-7


def test_a_state_that_is_set_in_event_mode_goes_on_from_there(make):
    fmu = make("ball", BALL, 1, 3, events=True).initialize({"stop": 2.0})
    assert fmu("EnterStepMode") == OK
    assert fmu.step(0.0, 0.125)[0] == OK
    assert fmu("EnterEventMode") == OK
    assert fmu.set(h=5.0, v=0.0) == OK
    assert fmu("EnterStepMode") == OK
    assert fmu.step(0.125, 0.125)[::2] == (OK, 0.25)
    fallen = [5 - 9.81 * 0.125**2 / 2, -9.81 * 0.125]
    assert fmu.get("h", "v") == pytest.approx(fallen, abs=1e-14)


def test_a_state_that_is_set_after_an_event_at_a_communication_point_is_not_undone(make):
    fmu = make("holding", HOLDING, 1, 3, events=True, early=False).initialize()
    assert fmu("EnterStepMode") == OK
    assert fmu.step(0.0, 0.25)[::2] == (OK, 0.25)
    assert fmu("EnterEventMode") == OK
    assert fmu.set(x=5.0, u=1.0) == OK
    assert fmu("EnterStepMode") == OK
    assert fmu.step(0.25, 0.125)[::2] == (OK, 0.375)
    assert fmu.get("x", "n", "y") == pytest.approx([5.125, 2, 0], abs=1e-12)


@pytest.mark.parametrize(("period", "later"), [(0.125, 10), (0.2, 7), (0.25, 5), (0.5, 3)])
def test_a_sample_with_a_new_input_happens_once_whatever_the_new_period(make, period, later):
    fmu = make("holding", HOLDING, 1).initialize()
    for k in range(3):
        assert fmu("DoStep", 0.25 * k, 0.25, 1) == OK
    assert fmu.get("n", "y") == [4, 0]
    assert fmu.set(u=1.0, period=period) == OK
    assert fmu("DoStep", 0.75, 0.0625, 1) == OK
    assert fmu.get("n", "y") == [4 + (period == 0.2), 1]
    assert fmu("DoStep", 0.8125, 1.1875, 1) == OK
    assert fmu.get("n", "y") == [4 + later, 1]


def test_a_sample_at_0_happens_at_a_communication_point_that_rounding_leaves_before_it(make):
    """Steps of 0.1 s from -1 s add up to -1.4e-16 s."""
    fmu = make("counting", ("time", "x", "n", "der(x)", "der(n)", "mode_1"), 1, given=[10])
    fmu.initialize({"start": -1.0})
    time = -1.0
    for _ in range(10):
        assert fmu.get("n") == [0]
        assert fmu("DoStep", time, 0.1, 1) == OK
        time += 0.1
    assert -1e-15 < time < 0
    assert fmu.get("time", "n") == [0, 1]


def test_a_sample_at_0_happens_where_an_importer_of_model_exchange_comes_a_little_early(make):
    fmu = make("counting", ("time", "x", "n", "der(x)", "der(n)", "mode_1"), 0, given=[10])
    fmu.initialize({"start": -1.0})
    update(fmu)
    time = -1.0
    for k in range(-9, 1):
        time += 0.1
        assert fmu("EnterContinuousTimeMode") == OK
        move(fmu, time, time + 1, 0.0)
        assert fmu("EnterEventMode") == OK
        for _ in range(2):
            assert update(fmu).next_time == pytest.approx((k + 1) / 10, abs=1e-15)
            assert fmu.get("n") == [k == 0]
    assert -1e-15 < time < 0


def test_an_infinite_rate_is_no_event_and_no_part_of_a_state(make):
    fmu = make("pole", POLE, 0).initialize()
    update(fmu)
    assert fmu("EnterContinuousTimeMode") == OK
    move(fmu, 0.5, 0.5, 0.0, 0.0)
    indicators = reals(0.0, 0.0, 0.0)
    assert fmu("GetEventIndicators", indicators, 3) == OK
    assert [*indicators] == pytest.approx([5.5, 1.0, 0.5**2 - 0.01])
    snapshot = fmu.take()
    assert fmu("SetFMUstate", snapshot) == OK, fmu.said


def test_a_step_that_is_completed_where_nothing_slides_any_more_is_discarded(make):
    fmu = make("pushed_block", ("time", "x", "v", "der(x)", "der(v)", "mode_1"), 0).initialize()
    update(fmu)
    assert fmu.get("mode_1") == [pytest.approx(1 / 4)]
    assert fmu("EnterContinuousTimeMode") == OK
    move(fmu, 0.5, 2.0, 0.0)
    flags = c_int(), c_int()
    assert fmu("CompletedIntegratorStep", 1, *map(byref, flags)) == DISCARD
    move(fmu, 0.5, 0.0, 0.0)
    assert fmu("CompletedIntegratorStep", 1, *map(byref, flags)) == OK


@pytest.mark.parametrize("digits", ["1", "12"])
def test_a_long_message_ends_with_a_whole_character(make, digits):
    fmu = make("pole", POLE, 0).initialize()
    update(fmu)
    assert fmu("EnterContinuousTimeMode") == OK
    assert fmu("SetTime", float(f"0.{digits}")) == OK
    assert fmu("SetContinuousStates", reals(1.0, -2.0, 0.0), 3) == OK
    fmu.get("valid_margin_1")
    head, _, text = fmu.said.rpartition(" ")
    assert head.endswith(f"invalid from 0.{digits} s: not fulfilled:")
    room = event_models.TEXT_SIZE - len(f"{head} ") - 1
    assert text in ("é" * (room // 2), "é" * (room // 2 - 1))


@pytest.mark.parametrize("solver", ["dop853", "rk4", "rosenbrock"])
def test_a_step_that_rounding_makes_none_keeps_the_input_that_it_asks_for(make, solver):
    def give(_, __, asks, *___):
        if asks:
            fmu.set(u=1.0)

    fmu = make("left", LEFT, 1, 3, solver=solver, update=give, wanted=["u"])
    fmu.initialize({"start": 1.0})
    assert fmu.step(1.0, 1e-20)[::2] == (OK, 1.0)
    assert fmu.get("u") == [1.0]
    assert fmu.step(1.0, 0.125)[::2] == (OK, 1.125)
    assert fmu.get("x") == [pytest.approx(0.125)]


@pytest.mark.parametrize("solver", ["dop853", "rk4", "ode8"])
def test_a_call_ends_however_long_its_step_is(make, solver):
    fmu = make("humming", HUMMING, 1, solver=solver).initialize()
    assert fmu("DoStep", 0.0, 1e6, 1) == DISCARD
    time, x = fmu.get("time", "x")
    assert 0 < time < 1e5
    assert x == pytest.approx(time, rel=1e-10)


@pytest.mark.parametrize("version", [2, 3])
def test_friction_that_a_parameter_changes_while_it_holds_is_no_event(make, version):
    fmu = make("stuck", STUCK, 1, version).initialize()
    for k in range(3):
        assert fmu.set(u=0.1 + 0.05 * k, mu=0.3 + 0.1 * k) == OK
        arguments = (k * 0.1, 0.1)
        status = fmu.step(*arguments)[0] if version == 3 else fmu("DoStep", *arguments, 1)
        assert status == OK
        assert fmu.get("friction") == pytest.approx([0.1 + 0.05 * k], abs=1e-15)
    assert fmu.messages == []  # before: "at 0.1 s: sign of v", "at 0.2 s: ..."


def test_reading_between_steps_changes_no_bit_of_a_motion_that_slides(make):
    states = []
    for reads in (False, True):
        fmu = make("stuck", STUCK, 1, 3, events=True).initialize()
        flags, next_time = [c_bool() for _ in range(5)], c_double()
        assert fmu("UpdateDiscreteStates", *map(byref, flags), byref(next_time)) == OK
        assert fmu("EnterStepMode") == OK
        for k in range(3):
            assert fmu.set(u=0.1 + 0.05 * k, mu=0.3 + 0.1 * k) == OK
            if reads:
                fmu.get(*STUCK)
            assert fmu.step(k * 0.1, 0.1)[:2] == (OK, [False, False, False])
        fmu.get(*STUCK)
        states.append(fmu.serialize(fmu.take()).raw)
    assert states[0] == states[1]


def test_each_of_many_limits_is_told_once(make):
    fmu = make("limited", LIMITED, 1, given=(70,)).initialize()
    for k in range(5):
        snapshot, before = fmu.take(), len(fmu.messages)
        for _ in range(2):
            assert fmu("SetFMUstate", snapshot) == OK
            assert fmu("DoStep", k * 1.25, 1.25, 1) == OK
        said = [text for *_, text in fmu.messages[before:]]
        limits = range(int(12.5 * k) + 1, int(12.5 * (k + 1)) + 1)
        told = "fmi2DoStep: invalid from {:.12g} s: not fulfilled: x below {} dm"
        assert said == 2 * [told.format(d / 10, d) for d in limits]


@pytest.mark.parametrize("sign", [-1, 1])
def test_friction_ends_where_an_importer_comes_a_little_early_to_its_end(make, sign):
    """Root finders may end on the near side of an indicator's zero, and find it there again."""
    fmu = make("stuck", STUCK, 0).initialize()
    update(fmu)
    assert fmu.set(u=sign * 0.3, mu=0.3 * (1 - 0.7e-12)) == OK
    (margin,) = fmu.get("event_indicator_1")
    assert 0 < margin < 1e-12
    update(fmu)
    assert fmu("EnterContinuousTimeMode") == OK
    assert fmu.set(u=sign * 0.4) == OK
    assert fmu.get("der(v)") == pytest.approx([sign * 0.1], abs=1e-9)
