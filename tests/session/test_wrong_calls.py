"""Sessions: wrong calls, and arguments and values that fit nothing."""

import numpy as np
import pytest
from helpers.foreign_part import foreign_part
from helpers.small_models import decay
from helpers.typed_part import typed_part

import cosim
from cosim.errors import CosimError, FmuError, ParameterError, UnknownName, UsageError


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize(
    ("call", "kind", "says"),
    [
        (lambda s: s.advance(), UsageError, "give one"),
        (lambda s: s.advance(0.1, to=0.2), UsageError, "give one"),
        (lambda s: s.advance(-0.1), ParameterError, "goes backwards"),
        (lambda s: s.advance(to=-0.1), ParameterError, "before the present time"),
        (lambda s: s.advance(float("nan")), ParameterError, "not finite"),
        (lambda s: s.advance(to=float("inf")), ParameterError, "not finite"),
        (lambda s: (s.advance(0.5), s.advance(1e-20)), ParameterError, "too short"),
        (lambda s: s.advance("0.1"), ParameterError, "not a real number"),
        (lambda s: s.set(forse=1.0), UnknownName, "did you mean force"),
        (lambda s: s.set(x=1.0), UsageError, "cannot be set during a run"),
        (lambda s: s.set(force="3 kg"), ParameterError, "cannot be converted"),
        (lambda s: s.set(force=None), ParameterError, "not a real number"),
        (lambda s: s.set([1.0, 2.0]), UsageError, "1 inputs force"),
        (lambda s: s.set(3.0), UsageError, "values by name"),
        (lambda s: s.set(rate=1e9), FmuError, "not within"),
        (lambda s: s.get("x"), UsageError, "list of names"),
        (lambda s: s.get(["z"]), UnknownName, "no variable 'z'"),
        (lambda s: s["z"], UnknownName, "no variable 'z'"),
        (lambda s: s.reset({"x": float("inf")}), ParameterError, "not finite"),
        (lambda s: s.reset([1.0]), UsageError, "values by name"),
        (lambda s: s.linearize(["z"]), UnknownName, "no output 'z'"),
        (lambda s: s.reset(start_time=7.0), ParameterError, "5 s lies before start_time = 7 s"),
    ],
)
def test_wrong_call_is_rejected_and_the_session_goes_on(call, kind, says):
    with cosim.open(decay(), stop_time=5.0) as session:
        with pytest.raises(kind, match=says):
            call(session)
        session.advance(to=1.0)
        assert session["x"] == pytest.approx(np.exp(-0.5), rel=1e-9)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda bike: bike[[]],
        lambda bike: bike[{"x": 1}],
        lambda bike: bike.get([[]]),
        lambda bike: bike.advance(np.ones(2)),
        lambda bike: bike.reset(start_values=3),
        lambda bike: bike.linearize(outputs=[[1, 2]]),
    ],
)
def test_argument_of_a_session_that_fits_nothing_is_named(wrong):
    with cosim.open(decay()) as bike, pytest.raises(CosimError) as caught:
        wrong(bike)  # before: unhashable type, ambiguous truth value
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda many: many.set(force=[[1, 2], [3]]),
        lambda many: many.set([[1, 2], [3]]),
        lambda many: many.set(force=10**400),
        lambda many: many.set(force=[10**400, 1.0]),  # before: OverflowError
        lambda many: many.reset(only=[[1, 2], [3]]),
        lambda many: many.advance(np.ones(2)),
    ],
)
def test_argument_of_copies_that_fits_nothing_is_named(wrong):
    with cosim.open(decay(), copies=2) as many, pytest.raises(CosimError):
        wrong(many)


@pytest.mark.parametrize("copies", [None, 2])
@pytest.mark.parametrize(
    ("name", "value"),
    [("count_in", 3.7), ("count_in", 3e9), ("on_in", 0.5), ("on_in", 2.0), ("mode_in", 2.5)],
)
def test_value_that_a_type_does_not_have_is_rejected(name, value, copies, tmp_path):
    with cosim.open(typed_part(tmp_path, 2), copies=copies) as part:
        part.set({name: 1})
        with pytest.raises(ParameterError, match=f"{name} = {value}"):
            part.set({name: value})  # before: 3.7 became 3, and 0.5 true
        part.advance(0.1)
        assert np.all(part[name] == 1)
        part.set({name: 3.0 if name == "count_in" else 1.0})


@pytest.mark.parametrize("copies", [None, 2])
def test_equal_steps_that_leave_the_time_where_it_is_are_rejected(copies):
    """At 1e9 s, times are 1.2e-7 s apart: the third and the fourth step of 1e-7 s end at one."""
    start, step = 1e9, 1e-7
    assert start + 4 * step == start + 3 * step
    with cosim.open(decay(), copies=copies, start_time=start) as session:
        for _ in range(3):
            session.advance(step)
        with pytest.raises(ParameterError, match="too short at 1000000000 s"):
            session.advance(step)  # before: nothing happened, in this step and in all others
        session.advance(1e-6)
        assert session.time == start + 3 * step + 1e-6


@pytest.mark.parametrize("outputs", [["force"], ["y", "rate"]])
def test_input_or_parameter_is_no_output_of_a_linear_system(outputs, session):
    with pytest.raises(UnknownName, match=f"no output '{outputs[-1]}'"):
        session.linearize(outputs)  # before: the session failed
    session.advance(to=1.0)
    assert session["x"] == pytest.approx(np.exp(-0.5), rel=1e-9)


@pytest.mark.parametrize("kind", ["file", "system"])
def test_start_after_the_stop_time_leaves_the_session_as_it_was(kind, tmp_path):
    path = foreign_part(tmp_path, "lag")
    model = path if kind == "file" else cosim.couple({"a": path}, {})
    with cosim.open(model, stop_time=5.0) as session:
        session.advance(1.0)
        with pytest.raises(ParameterError, match=r"stop_time = 5 s lies before start_time = 10 s"):
            session.reset(start_time=10.0)  # before: a file went on beyond its end
        assert session.time == 1.0
        session.reset(start_time=4.0)
        session.advance(to=5.0)


def test_file_that_takes_steps_of_one_length_rejects_others(tmp_path):
    name = "canHandleVariableCommunicationStepSize"
    with cosim.open(foreign_part(tmp_path, "lag", **{name: "false"})) as session:
        session.set(u=1.0)
        for _ in range(3):
            session.advance(0.1)
        for step in ({"step": 0.15}, {"to": 0.35}):
            with pytest.raises(ParameterError, match=r"one length only, which has been 0\.1 s"):
                session.advance(**step)  # before: the file took what it need not take
        session.advance(to=0.4)
        assert session["y"] == pytest.approx(1 - np.exp(-0.4), rel=1e-9)


@pytest.mark.parametrize("kind", [set, dict.fromkeys, iter, list, tuple, np.array])
def test_value_that_is_not_finite_is_named_whatever_lists_the_names(kind, tmp_path):
    with cosim.open(foreign_part(tmp_path, "controller")) as session:
        session.set(u=1e308)  # whose thousandfold is no number
        with pytest.raises(FmuError, match=r"der\(x\) is not finite at 0 s"):
            session.get(kind(["der(x)"]))  # before: 'set' object is not subscriptable


def test_session_whose_reset_makes_no_instance_calls_nothing_of_the_file(tmp_path, monkeypatch):
    monkeypatch.delenv("LAG_WAS_MADE", raising=False)
    once = 'if (getenv("LAG_WAS_MADE")) return 0; setenv("LAG_WAS_MADE", "1", 1)'
    with cosim.open(
        foreign_part(tmp_path, "lag", fault={"MADE": once}), start_values={"x": 1.0}
    ) as session:
        saved = session.save()
        with pytest.raises(FmuError, match="Failed to instantiate"):
            session.reset()
        with pytest.raises(FmuError, match="has not begun; begin again with reset"):
            session.restore(saved)  # before: it called functions of a library that was unloaded
