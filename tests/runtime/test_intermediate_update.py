"""FMI 3.0 co-simulation: what an importer sees and may do between communication points."""

import numpy as np
import pytest
from helpers.harness import DISCARD, ERROR, NAN, OK, reals
from scipy.integrate import solve_ivp

pytestmark = pytest.mark.parametrize("solver", ["dop853"], scope="session")
STRETCH = 3.0  # s, many steps of the solver


def rates(t, x):
    """The toy's equations, solved for a by hand; see `test_co_simulation`."""
    q, v, w, _ = x
    return [v, (0.1 * w - 0.5 * v - 8 * q) / 1.8, -w * np.sqrt(q + 10), 0.0]


class Watch:
    """A callback that keeps what it is told and sees, and may wish to stop."""

    def __init__(self, stop_after=None, wanted=None, call=None):
        self.seen, self.told = [], []
        self.stop_after, self.wanted, self.call = stop_after, wanted, call
        self.fmu = None

    def __call__(self, _, time, *rest):
        *flags, early, until = rest
        self.told.append(flags)
        self.seen.append((time, *self.fmu.get("time", "q", "v", "energy")))
        if self.call:
            self.call(self.fmu)
        if self.stop_after is not None and time > self.stop_after:
            early[0] = True
            until[0] = time if self.wanted is None else self.wanted


def stepped(fmi3, watch, **options):
    fmu = watch.fmu = fmi3(1, update=watch, **options)
    fmu.initialize({"tolerance": 1e-8})
    return fmu, fmu.step(0.0, STRETCH)


@pytest.mark.slow
def test_the_solvers_steps_are_shown_and_change_nothing(fmi3):
    watch = Watch()
    fmu, (status, flags, reached) = stepped(fmi3, watch)
    assert (status, flags, reached) == (OK, [False] * 3, STRETCH)
    assert len(watch.seen) > 5
    assert all(told == [False, True, True, True] for told in watch.told)  # get, finished, early
    times = np.array([row[0] for row in watch.seen])
    assert (np.diff(times) > 0).all()
    assert times[-1] < STRETCH
    run = solve_ivp(
        rates, (0, STRETCH), [1, 0, 1, 1], "DOP853", t_eval=times, rtol=1e-10, atol=1e-12
    )
    seen = np.array(watch.seen)
    np.testing.assert_array_equal(seen[:, 1], times)
    np.testing.assert_allclose(seen[:, 2:4], run.y[:2].T, rtol=0, atol=1e-8)  # measured 2e-10
    energy = run.y[1] ** 2 + 4 * run.y[0] ** 2
    np.testing.assert_allclose(seen[:, 4], energy, rtol=0, atol=1e-7)
    silent = fmi3(1).initialize({"tolerance": 1e-8})
    silent.step(0.0, STRETCH)
    assert silent.get(*silent.reference) == fmu.get(*fmu.reference)  # bit for bit


def test_a_step_of_the_solver_is_shown_where_communication_steps_are_shorter(fmi3):
    whole, parts = Watch(), Watch()
    stepped(fmi3, whole)
    fmu = parts.fmu = fmi3(1, update=parts)
    fmu.initialize({"tolerance": 1e-8})
    for k in range(96):
        assert fmu.step(k / 32, 1 / 32)[0] == OK
    assert len(parts.seen) > 5
    assert parts.seen == whole.seen


@pytest.mark.parametrize("wanted", [None, 1.6, 0.0, NAN])
def test_a_step_ends_early_where_the_importer_wishes(fmi3, wanted):
    watch = Watch(stop_after=1.0, wanted=wanted)
    fmu, (status, flags, reached) = stepped(fmi3, watch)
    stop = STRETCH if wanted != wanted else 1.6 if wanted == 1.6 else watch.seen[-1][0]
    assert (status, flags) == (OK, [False, False, stop < STRETCH])
    assert reached == stop == fmu.get("time")[0]
    q, v = fmu.get("q", "v")
    run = solve_ivp(rates, (0, reached), [1, 0, 1, 1], "DOP853", rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose([q, v], run.y[:2, -1], rtol=0, atol=1e-8)
    watch.stop_after = None
    if reached < STRETCH:  # and goes on from there
        assert fmu.step(reached, STRETCH - reached)[::2] == (OK, STRETCH)


def test_no_step_ends_early_where_that_is_not_allowed(fmi3):
    watch = Watch(stop_after=0.5)
    _, (status, flags, reached) = stepped(fmi3, watch, early=False)
    assert (status, flags, reached) == (OK, [False] * 3, STRETCH)
    assert not any(told[3] for told in watch.told)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda fmu: fmu.set(force=1.0), "fmi3SetFloat64: not allowed in an intermediate update"),
        (lambda fmu: fmu.step(0.0, 0.1), "fmi3DoStep: not allowed in an intermediate update"),
    ],
)
def test_what_is_not_allowed_between_ends_the_step_with_an_error(fmi3, call, said):
    fmu, (status, _, _) = stepped(fmi3, Watch(call=call))
    assert status == ERROR
    assert fmu.said == said
    assert fmu.step(0.0, 0.1)[0] == ERROR  # terminated


def test_derivatives_of_outputs_are_told_between(fmi3):
    rates_seen = []

    def ask(fmu):
        value = reals(0.0)
        from ctypes import c_int32

        arguments = fmu.refs("q"), 1, (c_int32 * 1)(1), value, 1
        assert fmu("GetOutputDerivatives", *arguments) == OK, fmu.said
        rates_seen.append((value[0], fmu.get("v")[0]))

    stepped(fmi3, Watch(call=ask))
    assert rates_seen
    assert all(rate == v for rate, v in rates_seen)  # q' = v


class Source:
    """A callback that gives an input its values where they are asked for."""

    def __init__(self, law, call=None):
        self.law, self.call, self.asked, self.fmu = law, call, [], None

    def __call__(self, _, time, asks, readable, finished, may_return, *__):
        assert (readable, finished) == (not asks, not asks)
        if asks:
            assert not may_return
            self.asked.append(time)
            assert self.fmu.set(force=self.law(time)) == OK
            if self.call:
                self.call(self.fmu)


def driven(fmi3, law, **options):
    source = Source(law, **options)
    fmu = source.fmu = fmi3(1, update=source, wanted=["force"])
    return fmu.initialize({"tolerance": 1e-11}), source


def test_inputs_are_asked_for_and_move_on_the_cubic_through_their_values(fmi3):
    law = np.polynomial.Polynomial([2.0, -1.0, 3.0, -4.0])
    fmu, source = driven(fmi3, law)
    for k in range(2):
        assert fmu.step(1.0 * k, 1.0)[::2] == (OK, k + 1.0)
        times = k + np.array([0, 1, 2, 3]) / 3
        np.testing.assert_allclose(source.asked[4 * k :], times, rtol=1e-15, atol=1e-15)

    def forced(t, x):
        q, v, w, _ = x
        return [v, (0.1 * w - 0.5 * v - 8 * q + law(t)) / 1.8, -w * np.sqrt(q + 10), 0.0]

    run = solve_ivp(forced, (0, 2), [1, 0, 1, 1], "DOP853", rtol=1e-12, atol=1e-13)
    error = np.abs(np.array(fmu.get("q", "v", "w")) - run.y[:3, -1]).max()
    assert error < 1e-8  # measured 1.3e-10
    assert fmu.get("force") == [pytest.approx(law(2.0), rel=1e-13)]


def test_inputs_that_rest_change_no_bit(fmi3):
    fmu, source = driven(fmi3, lambda _: 1.5)
    plain = fmi3(1).initialize({"tolerance": 1e-11})
    plain.set(force=1.5)
    assert fmu.step(0.0, STRETCH) == plain.step(0.0, STRETCH)
    assert len(source.asked) == 4
    assert fmu.get(*fmu.reference) == plain.get(*plain.reference)


def test_only_inputs_that_the_importer_wants_are_asked_for(fmi3):
    told = []
    for wanted in ((), ["q", "energy"]):
        fmu = fmi3(1, update=lambda *flags: told.append(flags[2]), wanted=wanted)
        fmu.initialize()
        assert fmu.step(0.0, STRETCH)[0] == OK
    assert told
    assert not any(told)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda fmu: fmu.set(damping=1.0), "damping, a parameter, cannot be set now"),
        (
            lambda fmu: fmu.step(0.0, 0.1),
            "not allowed in an intermediate update that asks for inputs",
        ),
    ],
)
def test_a_callback_that_is_asked_for_inputs_may_do_nothing_else(fmi3, call, said):
    fmu, source = driven(fmi3, lambda _: 0.0, call=call)
    status, _, reached = fmu.step(0.0, 1.0)
    assert (status, reached) == (ERROR, 0.0)
    assert said in fmu.said
    assert len(source.asked) == 1
    assert fmu.step(0.0, 0.1)[0] == ERROR  # terminated


def test_an_input_that_is_not_finite_is_refused_and_keeps_its_value(fmi3):
    fmu, source = driven(fmi3, lambda _: 0.0)
    assert fmu.set(force=2.0) == OK
    source.law = lambda _: 2.0
    source.call = lambda fmu: fmu.set(force=NAN)
    assert fmu.step(0.0, 1.0)[0] == OK
    assert "not finite" in fmu.said
    assert fmu.get("force") == [2.0]


def test_a_discarded_step_leaves_no_derivatives_of_what_was_seen_within(fmi3):
    """dw'/dq = -w / (2 sqrt(q + 10)) at the start, where q = w = 1."""

    def column(fmu):
        value = reals(NAN)
        seed = fmu.refs("w_dot"), 1, fmu.refs("q"), 1, reals(1.0), 1
        assert fmu("GetDirectionalDerivative", *seed, value, 1) == OK, fmu.said
        return value[0]

    watch = Watch(call=column)
    fmu = watch.fmu = fmi3(1, update=watch)
    fmu.initialize({"tolerance": 1e-8}, blow=1.0)  # s blows up at 1 s
    start = pytest.approx(-1 / (2 * np.sqrt(11)), rel=1e-13)
    assert column(fmu) == start
    assert fmu.step(0.0, 2.0)[::2] == (DISCARD, 0.0)
    assert column(fmu) == start
