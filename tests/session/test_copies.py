"""Copies: closed forms, the runs of single sessions, exact values, and every kind of wrong call."""

from types import SimpleNamespace

import numpy as np
import pytest
from helpers.event_models import ball, stopping
from helpers.foreign_part import foreign_part
from helpers.small_models import decay, growing

import cosim
from casadi_models.dae import Model
from cosim.errors import FmuError, ParameterError, UnknownName, UsageError
from cosim.session.calls import StateCalls
from cosim.session.copies import Copies
from cosim.session.session import Session
from cosim.session.single_copies import SingleCopies

N = 5
RATES = np.array([0.0, 0.5, 1.0, 2.0, 100.0])


def both(build):
    """Return copies in lanes and copies that are sessions."""
    return [cosim.open(build(), copies=N), cosim.open(build(), copies=N, solver="erk")]


def exact(x, force, rate, t):
    """Return x(t) of x' = force - rate x."""
    safe = np.where(rate == 0, 1.0, rate)
    moved = x * np.exp(-rate * t) + force * -np.expm1(-rate * t) / safe
    return np.where(rate == 0, x + force * t, moved)


@pytest.mark.parametrize("solver", [None, "erk"])
def test_copies_follow_the_closed_form_with_inputs_and_parameters_of_their_own(solver):
    start = {"rate": RATES, "x": np.arange(N) - 2.0}
    with cosim.open(decay(), copies=N, start_values=start, solver=solver) as copies:
        assert len(copies) == N
        expected, force = start["x"], np.zeros(N)
        for step in range(6):
            assert copies.advance(0.1) == {}
            expected = exact(expected, force, RATES, 0.1)
            np.testing.assert_allclose(copies["x"], expected, rtol=1e-7, atol=1e-9)
            np.testing.assert_array_equal(copies.get(["y", "x"])[0], 2 * copies["x"])
            force = np.linspace(-1, 1, N) * step
            copies.set([force])
            np.testing.assert_array_equal(copies["force"], force)
        copies.set(rate=0.0, force="0 m/s")
        before = copies["x"]
        copies.advance(to=5.0)
        np.testing.assert_allclose(copies["x"], before, rtol=1e-12)
        assert copies.running.all()


def test_an_output_follows_an_input_that_is_set():
    for copies in both(growing):
        copies.set(u=np.arange(N))
        np.testing.assert_array_equal(copies["twice"], 2.0 + np.arange(N))
        assert copies.time == 0.0


def test_copies_are_closed_where_a_later_one_cannot_be_opened(monkeypatch):
    opened = []

    class Third(Session):
        def __init__(self, *given):
            if len(opened) == 2:
                raise FmuError("no third one")
            super().__init__(*given)
            opened.append(self)

    monkeypatch.setattr("cosim.session.open.Session", Third)
    with pytest.raises(FmuError, match="no third one"):
        cosim.open(decay(), copies=3, solver="erk")
    for session in opened:
        with pytest.raises(FmuError, match="closed"):
            session.get("x")


def test_a_copy_that_fails_disturbs_no_other():
    start = {"x": [0.0, 0.1, 2.0, -1.0, 0.5]}
    with cosim.open(growing(), copies=N, start_values=start) as copies:
        copies.advance(to=0.75)
        np.testing.assert_array_equal(copies.running, [True, True, False, True, True])
        x = copies["x"]
        assert np.isnan(x[2])
        np.testing.assert_allclose(x[[0, 1, 3, 4]], [0, 0.1 / 0.925, -1 / 1.75, 0.8], rtol=1e-7)
        assert "step size too small" in copies.reasons[2]
        assert sorted(copies.invalid) == [2, 4]  # copy 2 from its start on
        assert "x stays below 0.7" in copies.invalid[4]
        saved = copies.save()
        copies.reset({"x": 1.0}, only=[2])
        assert copies.time == 0.75
        copies.advance(0.5)
        np.testing.assert_allclose(copies["x"][2], 2.0, rtol=1e-7)
        copies.restore(saved)
        assert copies.time == 0.75
        np.testing.assert_array_equal(copies["x"], x)
        assert not copies.running[2]
        copies.reset()
        np.testing.assert_array_equal(copies["x"], start["x"])
        assert copies.running.all()


def test_a_violated_condition_is_named_with_its_time():
    """x = tan t exceeds 0.7 at atan 0.7."""
    with cosim.open(growing(), start_values={"x": 0.0, "u": 1.0}) as session:
        session.advance(to=0.6)
        assert session.invalid is None
        saved = session.save()
        session.advance(to=0.9)
        assert session.invalid.time == pytest.approx(np.arctan(0.7), abs=1e-8)
        assert session.copy().invalid == session.invalid
        session.restore(saved)
        assert session.invalid is None
        session.reset({"x": 0.8})
        session.advance(0.1)
        assert session.invalid.time == 0.0
    start = {"x": [0.0, -1.0], "u": 1.0}
    for solver in (None, "erk"):
        with cosim.open(growing(), copies=2, start_values=start, solver=solver) as copies:
            copies.advance(to=0.9)
            assert list(copies.invalid) == [0]
            assert copies.invalid[0].time == pytest.approx(np.arctan(0.7), abs=1e-6)


@pytest.mark.parametrize("solver", [None, "erk"])
def test_a_saved_state_leads_to_the_same_bits(solver):
    start = {"rate": RATES}
    with cosim.open(decay(), copies=N, start_values=start, solver=solver) as copies:
        copies.set(force=RATES)
        copies.advance(0.3)
        saved = copies.save()
        copies.advance(0.3)
        there = copies.get(["x", "y"])
        copies.set(force=7.0)
        copies.advance(1.0)
        copies.restore(saved)
        copies.set(force=RATES)
        copies.advance(0.3)
        np.testing.assert_array_equal(copies.get(["x", "y"]), there)


def _pushed():
    """Return x' = push + pull - rate x; compiled code checks the bound of the parameter."""
    model = Model("pushed", stop_time=1.0)
    x = model.state("x", "m", 1.0, "place")
    push, pull = (model.input(name, "m/s", 0.0, "speed") for name in ("push", "pull"))
    rate = model.parameter("rate", "1/s", 0.5, "rate", minimum=0.0)
    model.derivative(x, push + pull - rate * x)
    return model.freeze()


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("names", [("push", "pull", "rate"), ("rate", "pull", "push")])
def test_a_rejected_value_leaves_all_others_as_they_were(fmi, names, tmp_path):
    path = cosim.export_fmu(_pushed(), tmp_path / "pushed.fmu", fmi=fmi)
    wrong = {"push": 3.0, "pull": 4.0, "rate": -1.0}
    with cosim.open(path) as one, cosim.open(path, copies=2) as many:
        one.set(push=1.0, pull=2.0)
        many.set(push=1.0, pull=[2.0, 5.0])
        with pytest.raises(FmuError, match="rate"):
            one.set({name: wrong[name] for name in names})
        np.testing.assert_array_equal(one.get(["push", "pull", "rate"]), [1.0, 2.0, 0.5])
        columns = {name: [wrong[name] if name != "rate" else 1.0, wrong[name]] for name in names}
        with pytest.raises(FmuError, match=r"copy 1: .*rate"):
            many.set(columns)
        kept = [[1.0, 1.0], [2.0, 5.0], [0.5, 0.5]]
        np.testing.assert_array_equal(many.get(["push", "pull", "rate"]), kept)


@pytest.mark.parametrize(
    "names", [("a.push", "b.rate"), ("b.rate", "a.push"), ("a.push", "a.rate")]
)
def test_a_rejected_value_leaves_all_parts_as_they_were(names, tmp_path):
    path = cosim.export_fmu(_pushed(), tmp_path / "pushed.fmu", fmi=3)
    wrong = {"push": 3.0, "rate": -1.0}
    with cosim.open(cosim.couple({"a": path, "b": path}, {}), macro_step=0.1) as session:
        with pytest.raises(FmuError, match="rate"):
            session.set({name: wrong[name[2:]] for name in names})
        np.testing.assert_array_equal(session.get(["a.push", "a.rate", "b.rate"]), [0, 0.5, 0.5])
        session.advance(0.1)
        np.testing.assert_allclose(session.get(["a.x", "b.x"]), np.exp(-0.05), rtol=1e-7)


def _falling(rate):
    """Return the declarations of x' = -rate x."""
    model = Model("lag", stop_time=3.0)
    x = model.state("x", "m", 1.0, "height")
    model.derivative(x, -rate * x)
    return model


@pytest.mark.parametrize("solver", [None, "erk"])
def test_state_of_another_model_of_the_same_name_and_sizes_is_rejected(solver):
    slow, fast = (_falling(rate).freeze() for rate in (1.0, 2.0))
    with (
        cosim.open(slow, copies=2, solver=solver) as here,
        cosim.open(fast, copies=2, solver=solver) as there,
        cosim.open(_falling(1.0).freeze(), copies=2, solver=solver) as again,
    ):
        here.advance(0.5)
        saved, x = here.save(), here["x"]
        with pytest.raises(UsageError, match="saved by copies of another model"):
            there.restore(saved)
        np.testing.assert_array_equal(there["x"], [1.0, 1.0])
        assert there.time == 0.0
        again.restore(saved)  # built anew, with the same equations
        np.testing.assert_array_equal(again["x"], x)


def test_state_of_ended_copies_of_another_model_is_rejected():
    models = [_falling(rate) for rate in (1.0, 2.0)]
    for model in models:
        model.stop(model.t > 0.25, "late")
    slow, fast = (model.freeze() for model in models)
    with cosim.open(slow, copies=2) as here, cosim.open(fast, copies=2) as there:
        here.advance(1.0)
        assert not here.running.any()
        with pytest.raises(UsageError, match="saved by copies of another model"):
            there.restore(here.save())
        assert there.running.all()


def test_saved_copies_of_a_file_hold_for_the_same_file_elsewhere(tmp_path):
    path = cosim.export_fmu(_falling(1.0).freeze(), tmp_path / "lag.fmu")
    other = tmp_path / "copy.fmu"
    other.write_bytes(path.read_bytes())
    with cosim.open(path, copies=2) as here, cosim.open(other, copies=2) as there:
        here.advance(0.5)
        there.restore(here.save())
        np.testing.assert_array_equal(there["x"], here["x"])


@pytest.fixture
def lags(tmp_path):
    """x' = -x in copies whose states hold for their own instances only."""
    path = foreign_part(tmp_path, "lag", canSerializeFMUstate="false")
    with cosim.open(path, copies=3, start_values={"x": [1.0, 2.0, 3.0]}) as copies:
        yield copies


def test_a_state_that_one_copy_cannot_take_changes_no_copy(lags):
    saved = lags.save()
    lags.advance(0.5)
    lags.reset(only=[1])
    before = lags["x"]
    with pytest.raises(UsageError, match=r"copy 1: .*this state was freed by a reset"):
        lags.restore(saved)
    np.testing.assert_array_equal(lags["x"], before)
    assert (lags.time, lags.reasons) == (0.5, {})


def test_a_copy_whose_file_rejects_its_state_fails_alone(lags, monkeypatch):
    saved = lags.save()
    lags.advance(0.5)
    put = StateCalls.restore

    def reject(calls, content, size):
        if calls is lags._engine._sessions[1]._states:
            raise FmuError("rejected")
        return put(calls, content, size)

    with monkeypatch.context() as patched:
        patched.setattr(StateCalls, "restore", reject)
        lags.restore(saved)
    assert (lags.time, lags.reasons) == (0.0, {1: "rejected"})
    lags.advance(1.0)
    np.testing.assert_allclose(lags["x"], [np.exp(-1), np.nan, 3 * np.exp(-1)], atol=1e-5)
    lags.restore(saved)
    np.testing.assert_array_equal(lags["x"], [1.0, 2.0, 3.0])


def test_models_with_events_are_sessions_that_go_on_alone():
    with cosim.open(ball(), copies=3, start_values={"h": [1.0, 0.5, 2.0]}) as balls:
        events = balls.advance(to=0.5)
    assert sorted(events) == [0, 1]
    np.testing.assert_allclose(
        [events[i][0].time for i in (0, 1)], np.sqrt([2 / 9.81, 1 / 9.81]), rtol=1e-7
    )


def test_a_copy_whose_model_ends_its_run_keeps_its_last_values():
    with cosim.open(stopping(), copies=2) as copies:
        while copies.running.any():
            copies.advance(0.5)
        assert sorted(copies.reasons) == [0, 1]
        assert np.isfinite(copies.get()).all()


@pytest.mark.slow
def test_lanes_and_sessions_agree_on_the_bicycle():
    start = {"speed": "5 m/s", "phi": np.linspace(-0.1, 0.1, 3)}
    found = []
    for solver in (None, "rosenbrock"):
        with cosim.open("bicycle", copies=3, start_values=start, solver=solver) as copies:
            copies.set(steer_torque=[0.0, 0.1, -0.1])
            copies.advance(0.3)
            found.append(copies.get())
    np.testing.assert_allclose(*found, rtol=1e-5, atol=1e-6)


def of_later_zip(saved):
    """Damage the version of the format that an entry of the archive needs."""
    place = saved.index(b"PK\x01\x02") + 6
    return saved[:place] + bytes([82]) + saved[place + 1 :]


@pytest.mark.parametrize(
    ("call", "error", "said"),
    [
        (lambda c: c.set(nothing=1.0), UnknownName, "nothing"),
        (lambda c: c.set(x=1.0), UsageError, "x cannot be set during a run"),
        (lambda c: c.set(force=[1.0, 2.0]), ParameterError, "shape"),
        (lambda c: c.set(force=["a"] * N), ParameterError, "force"),
        (lambda c: c.set(force=[0, 0, np.nan, 0, 0]), ParameterError, "copy 2"),
        (lambda c: c.set(np.zeros((2, N))), UsageError, "1 inputs and 5 copies"),
        (lambda c: c.get(["nothing"]), UnknownName, "nothing"),
        (lambda c: c.get("x"), UsageError, "list of names"),
        (lambda c: c.advance(-0.1), ParameterError, "backwards"),
        (lambda c: c.advance(), UsageError, "give one"),
        (lambda c: c.reset({"rate": -1.0}), ParameterError, "copy 0"),
        (lambda c: c.reset({"rate": [1, 1, 1, 1, -1]}), ParameterError, "copy 4"),
        (lambda c: c.reset({"rate": [1, 2]}), ParameterError, "shape"),
        (lambda c: c.reset([1.0]), UsageError, "values by name"),
        (lambda c: c.reset(only=[5]), UsageError, "numbers from 0 to 4"),
        (lambda c: c.reset(only=[-1]), UsageError, "numbers from 0 to 4"),
        (lambda c: c.reset(only=[1, 1]), UsageError, "names a copy twice"),
        (lambda c: c.reset(only="one"), UsageError, "numbers from 0 to 4"),
        (lambda c: c.restore(b""), UsageError, "no saved copies"),
        (lambda c: c.restore(c.save()[:-30]), UsageError, "no saved copies"),
        (lambda c: c.restore(of_later_zip(c.save())), UsageError, "no saved copies"),
        (lambda c: c.restore(1), UsageError, "what save has returned"),
    ],
)
def test_wrong_call_is_refused_and_changes_nothing(call, error, said):
    with cosim.open(decay(), copies=N, start_values={"rate": RATES}) as copies:
        copies.advance(0.1)
        before = copies.get(["x", "force", "rate"])
        with pytest.raises(error, match=said):
            call(copies)
        np.testing.assert_array_equal(copies.get(["x", "force", "rate"]), before)
        assert copies.time == 0.1


def test_saved_copies_of_another_model_or_number_are_refused():
    with cosim.open(decay(), copies=N) as five, cosim.open(decay(), copies=2) as two:
        with pytest.raises(UsageError, match="another number"):
            two.restore(five.save())
        with cosim.open(growing(), copies=N) as other, pytest.raises(UsageError, match="another"):
            other.restore(five.save())


def test_start_values_that_cannot_be_are_named_with_their_copy():
    with pytest.raises(ParameterError, match="copy 1: "):
        cosim.open(decay(), copies=2, start_values={"rate": [1.0, -1.0]})
    with pytest.raises(ParameterError, match="rate has the shape"):
        cosim.open(decay(), copies=3, start_values={"rate": [1.0, 2.0]})
    with pytest.raises(UsageError, match="positive whole number"):
        cosim.open(decay(), copies=0)


def test_closed_copies_take_no_calls():
    with cosim.open(decay(), copies=2) as copies:
        pass
    with pytest.raises(FmuError, match="closed"):
        copies.advance(0.1)
    copies.close()


def test_values_belong_to_the_copies_in_the_order_in_which_they_are_named():
    with cosim.open(decay(), copies=N) as copies:
        copies.reset({"x": [3.0, 1.0]}, only=[3, 1])
        np.testing.assert_array_equal(copies["x"], [1, 1, 1, 3, 1])


@pytest.mark.parametrize("solver", [None, "erk"])
def test_a_value_that_does_not_fit_changes_no_copy(solver):
    with cosim.open(decay(), copies=2, solver=solver) as copies:
        copies.set(force=[1.0, 2.0])
        copies.advance(0.1)
        before = copies.get(["x", "force", "rate"])
        for call in (copies.set, copies.reset):
            name = "force" if call == copies.set else "x"
            with pytest.raises(ParameterError, match="copy 1: "):
                call({name: [0.5, np.nan]})
            np.testing.assert_array_equal(copies.get(["x", "force", "rate"]), before)
        assert copies.time == 0.1


def test_no_step_leads_beyond_the_stop_time():
    with cosim.open(decay(), copies=2, stop_time=0.5) as copies:
        copies.advance(to=0.5)
        with pytest.raises(UsageError, match="beyond the stop time"):
            copies.advance(0.1)
    with cosim.open(decay(), copies=2, stop_time=0.5, solver="erk") as copies:
        copies.advance(0.6)
        assert "beyond the stop time" in copies.reasons[0]


def test_each_copy_gets_its_integer_as_it_is():
    """From 2^53 on, floats do not hold every one."""
    given = []
    counter = SimpleNamespace(name="counter", inputs=(), outputs=(), states=(), invalid=None)
    counter.identity = bytes
    counter.checked = given.append
    counter.reset = lambda values, start_time: None
    Copies(SingleCopies([counter] * 2), 2, {"n": [2**53 + 1, 3]}, 0.0)
    assert given == [{"n": 2**53 + 1}, {"n": 3}]


def test_integers_are_as_before_after_a_set_that_failed():
    given = []

    def session(number):
        def take(values):
            if number:
                raise FmuError("rejected")
            given.append(values)

        own = SimpleNamespace(name="n", inputs=(), outputs=(), states=(), invalid=None, set=take)
        own.identity, own.present = bytes, lambda values: {"n": 2**53 + 1}
        return own

    copies = SingleCopies([session(0), session(1)])
    with pytest.raises(FmuError, match="copy 1: rejected"):
        copies.set({"n": 3})
    assert given == [{"n": 3}, {"n": 2**53 + 1}]


def test_no_step_leads_beyond_a_stop_time_far_from_0():
    far = 1e9  # s, of which a billionth is as long as the run
    with cosim.open(decay(), copies=N, start_time=far, stop_time=far + 1) as copies:
        copies.advance(to=far + 1)
        with pytest.raises(UsageError, match="beyond the stop time"):
            copies.advance(0.5)


def test_arrays_of_the_caller_are_copied():
    x = np.array([1.0, 2.0])
    with cosim.open(decay(), copies=2, start_values={"x": x}) as copies:
        x[:] = 7.0
        copies.reset()
        np.testing.assert_array_equal(copies["x"], [1, 2])


def test_a_copy_whose_file_rejects_its_start_fails_alone(tmp_path):
    path = foreign_part(tmp_path, "lag", fault={"READY": "if (self->u < 0) return 3"})
    with cosim.open(path, copies=3) as copies:
        copies.advance(1.0)
        copies.reset({"u": [0.5, -1.0, 0.5]})  # before: two copies at 0 s and one at 1 s
        assert list(copies.reasons) == [1]
        assert "status 3" in copies.reasons[1]
        copies.advance(to=0.5)
        expected = 0.5 * (1 - np.exp(-0.5))
        np.testing.assert_allclose(copies["x"], [expected, np.nan, expected], rtol=1e-8)
        copies.reset({"u": 2.0}, only=[1])
        copies.advance(0.5)
        assert copies["x"][1] == pytest.approx(2 * (1 - np.exp(-0.5)), rel=1e-8)
    with pytest.raises(FmuError, match=r"copy 1: .*status 3"):
        cosim.open(path, copies=2, start_values={"u": [0.0, -1.0]})


def test_saved_copies_of_another_model_of_the_name_are_refused():
    model = Model("decay", stop_time=1.0)
    x, y = model.state("x", "m", 1.0, "place"), model.state("y", "m", 1.0, "place")
    model.derivative(x, -x)
    model.derivative(y, -y)
    with cosim.open(decay(), copies=2) as one:
        saved = one.save()
    other = cosim.open(model.freeze(), copies=2)
    with pytest.raises(UsageError, match="another model"):
        other.restore(saved)
