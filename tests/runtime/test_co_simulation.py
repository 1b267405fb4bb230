"""FMI 2.0 co-simulation against SciPy, at any communication step, and its early ends."""

from ctypes import byref, c_double, c_int

import numpy as np
import pytest
from helpers.harness import DISCARD, ERROR, INF, NAN, OK, WARNING, reals, references
from scipy.integrate import solve_ivp

ONE = (c_int * 1)(1)
pytestmark = pytest.mark.parametrize("solver", ["step", "dop853"], scope="session")


def rates(t, x, force, damping):
    """The toy's equations, solved for a by hand: 1.8 a = 0.1 w + force - damping v - 8 q."""
    q, v, w, _ = x
    return [v, (0.1 * w + force(t) - damping * v - 8 * q) / 1.8, -w * np.sqrt(q + 10), 0.0]


def solution(end, force=lambda t: 0.0, damping=0.5):
    options = {"rtol": 1e-12, "atol": 1e-13, "args": (force, damping)}
    return solve_ivp(rates, (0, end), [1, 0, 1, 1], "DOP853", **options).y[:, -1]


def walk(fmu, end, step, slope=None):
    time, count = 0.0, round(end / step)
    for k in range(count):
        if slope is not None:
            assert fmu.set(force=slope * time) == OK
            assert fmu("SetRealInputDerivatives", fmu.refs("force"), 1, ONE, reals(slope)) == OK
        assert fmu("DoStep", time, step, 1) == OK, fmu.said
        time = (k + 1) * step
    return np.array(fmu.get("q", "v", "w", "s"))


@pytest.mark.slow_rows("0.001-step", "0.001-dop853")
@pytest.mark.parametrize("step", [1e-3, 1e-2, 0.1, 2.0])
def test_the_result_does_not_depend_on_the_communication_step(cs, step):
    cs.initialize({"tolerance": 1e-10})
    error = np.abs(walk(cs, 2.0, step) - solution(2.0)).max()
    assert error < 100e-10  # measured 1.3e-11 ... 2.4e-9


def test_the_tolerance_of_the_importer_is_honored(fmi2):
    tolerances, exact, errors = [1e-4, 1e-7, 1e-10], solution(2.0), []
    for tolerance in tolerances:
        fmu = fmi2(1).initialize({"tolerance": tolerance})
        errors.append(np.abs(walk(fmu, 2.0, 2.0) - exact).max())
        assert errors[-1] < 100 * tolerance  # measured 2 to 25 tolerance; dop853 far less
    assert errors[0] > 10 * errors[1] > 100 * errors[2]


def test_a_change_of_inputs_at_a_communication_point_counts_from_there_on(cs):
    cs.initialize({"tolerance": 1e-10})
    x = np.array([1.0, 0.0, 1.0, 1.0])
    for k, force in enumerate([0.0, 5.0, 5.0, -3.0, -3.0]):
        assert cs.set(force=force) == OK
        assert cs("DoStep", 0.4 * k, 0.4, 1) == OK
        law = (lambda t, level=force: level, 0.5)
        x = solve_ivp(rates, (0, 0.4), x, "DOP853", rtol=1e-12, atol=1e-13, args=law).y[:, -1]
    assert np.abs(np.array(cs.get("q", "v", "w", "s")) - x).max() < 1e-10  # measured 7e-12


def test_a_change_of_a_parameter_at_a_communication_point_counts_from_there_on(cs, fmi2):
    """An instance that begins at the changed state with the new value goes the same way."""
    walk(cs.initialize(q=1.0, v=0.5), 1.0, 0.25)
    q, v, w, s = cs.get("q", "v", "w", "s")
    assert cs.set(damping=0.9) == OK
    for i in range(4):
        assert cs("DoStep", 1.0 + 0.25 * i, 0.25, 1) == OK
    other = fmi2(1)
    other.initialize({"start": 1.0}, q=q, v=v, s=s, load=w + w**2, damping=0.9)
    for i in range(4):
        assert other("DoStep", 1.0 + 0.25 * i, 0.25, 1) == OK
    np.testing.assert_allclose(cs.get("q", "v"), other.get("q", "v"), rtol=0, atol=1e-7)
    assert cs.get("q")[0] != pytest.approx(solution(2.0)[0], abs=1e-3)  # it had an influence


def test_inputs_with_derivatives_move_linearly_within_a_step(cs):
    cs.initialize({"tolerance": 1e-10})
    error = np.abs(walk(cs, 2.0, 0.5, slope=3.0) - solution(2.0, lambda t: 3 * t)).max()
    assert error < 100e-10  # measured 6e-10
    assert cs.get("force") == [pytest.approx(6.0, rel=1e-15)]


def test_inputs_move_as_polynomials_of_order_3_within_a_step(cs):
    """One step of 2 s, and two of 1 s with the same polynomial, against scipy."""
    law, orders = np.polynomial.Polynomial([2.0, -1.0, 3.0, -4.0]), (c_int * 3)(1, 2, 3)
    for steps in (1, 2):
        cs("Reset")
        cs.initialize({"tolerance": 1e-11})
        for k in range(steps):
            time, length = 2.0 * k / steps, 2.0 / steps
            assert cs.set(force=law(time)) == OK
            derivatives = reals(*(law.deriv(n)(time) for n in (1, 2, 3)))
            force = cs.refs("force", "force", "force")
            assert cs("SetRealInputDerivatives", force, 3, orders, derivatives) == OK
            assert cs("DoStep", time, length, 1) == OK
        error = np.abs(np.array(cs.get("q", "v", "w", "s")) - solution(2.0, law)).max()
        assert error < 1e-8  # measured 2e-10
        assert cs.get("force") == [pytest.approx(law(2.0), rel=1e-14)]


def test_an_input_derivative_holds_for_one_step_only(cs):
    cs.initialize()
    assert cs("SetRealInputDerivatives", cs.refs("force"), 1, ONE, reals(3.0)) == OK
    assert cs("DoStep", 0.0, 0.5, 1) == OK
    assert cs("DoStep", 0.5, 0.5, 1) == OK
    assert cs.get("force") == [1.5]


def test_output_derivatives_are_the_total_derivatives_along_the_solution(cs):
    cs.initialize({"tolerance": 1e-12})
    names = ("energy", "wave", "v")

    def outputs_at(time):
        cs("Reset")
        cs.initialize({"tolerance": 1e-12})
        cs("SetRealInputDerivatives", cs.refs("push"), 1, ONE, reals(2.0))
        assert cs("DoStep", 0.0, time, 1) == OK
        return np.array(cs.get(*names))

    after, before = outputs_at(0.7 + 1e-4), outputs_at(0.7 - 1e-4)
    outputs_at(0.7)
    exact, order = reals(0, 0, 0), (c_int * 3)(1, 1, 1)
    assert cs("GetRealOutputDerivatives", cs.refs(*names), 3, order, exact) == OK
    error = np.abs(np.array(exact) - (after - before) / 2e-4).max()
    assert error < 1e-6  # of the central difference; measured 1.1e-7


def test_output_derivatives_of_each_order_are_those_of_the_order_below(cs):
    names = ("energy", "wave", "v")

    def derivatives_at(time, order):
        cs("Reset")
        cs.initialize({"tolerance": 1e-12})
        motion = (c_int * 3)(1, 2, 3)
        cs("SetRealInputDerivatives", cs.refs(*["push"] * 3), 3, motion, reals(2.0, -3.0, 4.0))
        assert cs("DoStep", 0.0, time, 1) == OK
        values, orders = reals(0, 0, 0), (c_int * 3)(order, order, order)
        assert cs("GetRealOutputDerivatives", cs.refs(*names), 3, orders, values) == OK
        return np.array(values)

    for order in (2, 3):
        after, before = (derivatives_at(0.7 + side, order - 1) for side in (1e-3, -1e-3))
        found = derivatives_at(0.7, order)
        # of the central difference; measured 2e-5
        np.testing.assert_allclose(found, (after - before) / 2e-3, rtol=1e-4, atol=1e-4)


def test_output_derivatives_do_not_change_the_run(cs):
    def end(order):
        cs("Reset")
        cs.initialize()
        walk(cs, 0.5, 0.25)
        orders = (c_int * 1)(order)
        assert cs("GetRealOutputDerivatives", cs.refs("v"), 1, orders, reals(0.0)) == OK
        assert cs("DoStep", 0.5, 0.25, 1) == OK
        return cs.get("q", "v", "w", "s")

    assert end(3) == end(1)


@pytest.mark.parametrize("order", [0, 4, -1])
def test_output_derivatives_of_other_orders_are_rejected(cs, order):
    cs.initialize()
    orders = (c_int * 1)(order)
    assert cs("GetRealOutputDerivatives", cs.refs("v"), 1, orders, reals(7.0)) == ERROR
    assert cs.said.endswith(f"derivatives have orders 1 to 3, not {order}")


def test_repeating_a_step_from_a_saved_state_gives_the_same_bits(cs):
    cs.initialize()
    walk(cs, 0.4, 0.1)
    snapshot = cs.take()
    assert cs("DoStep", 0.4, 0.3, 0) == OK
    first = cs.get(*cs.reference)
    assert cs("SetFMUstate", snapshot) == OK
    assert cs("DoStep", 0.4, 0.15, 0) == OK
    assert cs("SetFMUstate", snapshot) == OK
    assert cs("DoStep", 0.4, 0.3, 0) == OK
    assert cs.get(*cs.reference) == first
    cs("FreeFMUstate", byref(snapshot))


def test_reading_outputs_between_steps_changes_nothing(cs, fmi2):
    silent = fmi2(1)
    for fmu in (cs, silent):
        fmu.initialize()
    for k in range(10):
        assert cs("DoStep", k * 0.1, 0.1, 1) == silent("DoStep", k * 0.1, 0.1, 1) == OK
        cs.get(*cs.reference)
    assert cs.get(*cs.reference) == silent.get(*silent.reference)


def test_reset_forgets_experiment_and_input_derivatives(cs, fmi2):
    cs.initialize({"stop": 0.1, "tolerance": 1e-3})
    assert cs("SetRealInputDerivatives", cs.refs("force"), 1, ONE, reals(3.0)) == OK
    assert cs("Reset") == OK
    fresh = fmi2(1)
    for fmu in (cs, fresh):
        fmu.initialize()
        assert fmu("DoStep", 0.0, 0.5, 1) == OK, fmu.said
    assert cs.get(*cs.reference) == fresh.get(*fresh.reference)
    assert cs("Reset") == OK
    assert cs("EnterInitializationMode") == ERROR  # an experiment is due again


def test_a_blow_up_ends_the_step_early_at_the_last_good_state(cs):
    cs.initialize(blow=1.0)  # s = 1 / (1 - t)
    assert cs("DoStep", 0.0, 0.5, 1) == OK
    assert cs("DoStep", 0.5, 1.0, 1) == DISCARD
    assert "came no further than" in cs.said
    reached, status, ended = c_double(), c_int(), c_int(1)
    assert cs("GetRealStatus", 2, byref(reached)) == OK
    assert cs("GetStatus", 0, byref(status)) == OK
    assert cs("GetBooleanStatus", 3, byref(ended)) == OK
    assert 1 - 4**-4 < reached.value < 1 + 1e-6  # measured 1
    assert (status.value, ended.value) == (DISCARD, 0)
    time, s = cs.get("time", "s")
    assert time == reached.value
    assert s > 1e6  # measured 1.2e9


@pytest.mark.parametrize(
    ("q", "v", "joint"), [(0.0, 8.0, "invalid: not fulfilled:"), (1.0, 0.0, "the nearest limit:")]
)
def test_the_message_of_a_failed_step_tells_the_nearest_limit(cs, q, v, joint):
    """s blows up at 1 s; where q is then, SciPy says."""
    exact = solve_ivp(rates, (0, 1), [q, v, 1, 1], args=(lambda t: 0.0, 0.5), rtol=1e-6)
    at_the_end = exact.y[0, -1]
    assert (at_the_end > 2) == (v == 8.0)
    cs.initialize({"tolerance": 1e-8}, blow=1.0, s=1.0, q=q, v=v)
    assert cs("DoStep", 0.0, 2.0, 1) == DISCARD
    assert cs.said.endswith(f"; {joint} q < 2 m")


def test_a_limit_is_told_once_per_crossing_though_nobody_reads_an_output(cs):
    """q swings between +-3 m or so; within a long step, where the solver's steps end."""
    cs.initialize({"tolerance": 1e-8}, q=0.0, v=8.0, damping=0.0)
    told = []
    for k in range(60):
        assert cs("DoStep", 0.1 * k, 0.1, 1) == OK
        if len(cs.messages) > len(told):
            told.append(0.1 * (k + 1))
            assert cs.said.endswith(" s: not fulfilled: q < 2 m")
    run = solve_ivp(rates, (0, 6), [0, 8, 1, 1], max_step=0.01, args=(lambda t: 0.0, 0.0))
    leaves = run.t[1:][(run.y[0, 1:] >= 2) & (run.y[0, :-1] < 2)]
    assert len(told) == len(leaves) == 2
    np.testing.assert_allclose(told, leaves, rtol=0, atol=0.11)  # at communication points


def test_after_an_early_end_the_step_can_be_retried_from_a_saved_state(cs):
    cs.initialize(blow=1.0)
    snapshot = cs.take()
    assert cs("DoStep", 0.0, 2.0, 0) == DISCARD
    assert cs("SetFMUstate", snapshot) == OK
    assert cs("DoStep", 0.0, 0.5, 0) == OK
    assert cs.get("s") == [pytest.approx(2.0, rel=1e-7)]
    cs("FreeFMUstate", byref(snapshot))


def test_a_step_that_needs_more_internal_steps_than_one_attempt_has_is_divided(cs):
    cs.initialize({"tolerance": 1e-9}, damping=0.0)
    assert cs("DoStep", 0.0, 60.0, 1) == OK  # one attempt comes to about 20 s
    error = np.abs(np.array(cs.get("q", "v")) - solution(60.0, damping=0.0)[:2]).max()
    assert error < 200e-9  # measured 5.4e-8


def test_a_step_beyond_what_can_be_done_ends_early(cs):
    cs.initialize()
    assert cs("DoStep", 0.0, 1e12, 1) == DISCARD
    assert cs.get("time")[0] < 1e12


@pytest.mark.parametrize("step", [NAN, INF, -INF, 0.0, -0.1])
def test_a_senseless_step_size_is_an_error(cs, step):
    cs.initialize()
    assert cs("DoStep", 0.0, step, 1) == ERROR
    assert cs.said.startswith("fmi2DoStep: step size ")


@pytest.mark.parametrize("begin", [NAN, INF, 0.1, -1.0, 1e-6])
def test_a_step_that_does_not_begin_now_is_an_error(cs, begin):
    cs.initialize()
    assert cs("DoStep", begin, 0.1, 1) == ERROR


def test_clocks_may_differ_by_rounding_and_the_end_is_met_exactly(cs):
    cs.initialize()
    time = 0.0
    for _ in range(10000):
        assert cs("DoStep", time, 1e-3, 1) == OK
        time += 1e-3  # differs from k * 1e-3 by rounding
        assert cs.get("time") == [time]


def test_a_step_beyond_the_stop_time_is_an_error(cs):
    cs.initialize({"stop": 0.25})
    assert cs("DoStep", 0.0, 0.2, 1) == OK
    assert cs("DoStep", 0.2, 0.05, 1) == OK
    assert cs("DoStep", 0.25, 0.05, 1) == ERROR
    assert "beyond the stop time 0.25" in cs.said


@pytest.mark.parametrize(
    ("name", "order", "value", "status"),
    [("q", 1, 1.0, ERROR), ("force", 1, NAN, DISCARD)],
)
def test_senseless_input_derivatives_are_refused(cs, name, order, value, status):
    cs.initialize()
    orders = (c_int * 1)(order)
    assert cs("SetRealInputDerivatives", cs.refs(name), 1, orders, reals(value)) == status


@pytest.mark.parametrize("order", [4, 5, 0, -1, 2**31 - 1])
def test_input_derivatives_of_other_orders_are_dropped_with_a_warning(cs, fmi2, order):
    other = fmi2(1).initialize()
    cs.initialize()
    for fmu, orders in ((cs, (1, order)), (other, (1,))):
        count = len(orders)
        references, values = fmu.refs(*["force"] * count), reals(*[2.0] * count)
        status = fmu("SetRealInputDerivatives", references, count, (c_int * count)(*orders), values)
        assert status == (OK if fmu is other else WARNING)
        assert fmu("DoStep", 0.0, 0.5, 1) == OK
    assert cs.messages[0][2].endswith(f"the derivative of order {order} of force is dropped")
    assert cs.get("q", "v") == other.get("q", "v")


def test_unknown_status_information_is_discarded(cs):
    cs.initialize()
    value = c_double()
    assert cs("GetRealStatus", 0, byref(value)) == DISCARD
    assert cs("GetIntegerStatus", 0, byref(value)) == DISCARD
    assert cs("GetStringStatus", 1, byref(value)) == DISCARD
    assert cs("GetRealOutputDerivatives", references(99), 1, ONE, reals(0)) == ERROR
