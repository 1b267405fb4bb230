"""Sessions: wrong calls, and arguments and values that fit nothing."""

import numpy as np
import pytest
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
    ],
)
def test_wrong_call_is_rejected_and_the_session_goes_on(call, kind, says, session):
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
