"""Directional derivatives against finite differences of the values the FMU itself gives."""

from ctypes import byref

import numpy as np
import pytest
from helpers.harness import DISCARD, ERROR, OK, reals

UNKNOWNS = ("q_dot", "v_dot", "w_dot", "s_dot", "a", "r", "energy", "wave", "log")
KNOWNS = {"q": 0.8, "v": -0.4, "w": 0.9, "s": 1.1, "force": 0.3, "push": 0.2}
PARAMETERS = {"mass": 2.5, "stiffness": 7.0, "damping": 0.6, "load": 3.0, "blow": 0.1}


def directional(fmu, unknowns, knowns, seed):
    values = reals(*[0.0] * len(unknowns))
    status = fmu(
        "GetDirectionalDerivative", fmu.refs(*unknowns), len(unknowns),
        fmu.refs(*knowns), len(knowns), reals(*seed), values,
    )  # fmt: skip
    assert status == OK, fmu.said
    return np.array(values)


def jacobian(fmu, unknowns, knowns):
    return np.column_stack([directional(fmu, unknowns, [k], [1.0]) for k in knowns])


def differences(evaluate, values):
    """Central differences, step 1e-5: error about 1e-10."""
    columns = []
    for name in values:
        ahead, behind = (evaluate(values | {name: values[name] + h}) for h in (1e-5, -1e-5))
        columns.append((np.array(ahead) - np.array(behind)) / 2e-5)
    return np.column_stack(columns)


def test_in_continuous_time_the_jacobian_of_states_and_inputs_is_exact(me):
    me.initialize(**PARAMETERS)
    me("EnterContinuousTimeMode")
    me("SetTime", 0.4)

    def evaluate(values):
        assert me.set(**values) == OK
        return me.get(*UNKNOWNS)

    expected = differences(evaluate, KNOWNS)
    evaluate(KNOWNS)
    error = np.abs(jacobian(me, UNKNOWNS, KNOWNS) - expected).max()
    assert error < 1e-9  # of the differences; measured 1.5e-10


def test_the_kept_jacobian_follows_every_setter_and_every_restored_state(me):
    me.initialize()
    me("EnterContinuousTimeMode")
    rates = UNKNOWNS[:6]

    def columns_agree():
        columns = jacobian(me, rates, KNOWNS)  # one known each: columns of the kept Jacobian
        runs = [directional(me, rates, [k, k], [0.25, 0.75]) for k in KNOWNS]  # seeds: run anew
        np.testing.assert_allclose(columns, np.column_stack(runs), rtol=0, atol=1e-13)
        return columns

    first, snapshot = columns_agree(), me.take()
    assert me.set(q=2.0) == OK
    assert not np.array_equal(columns_agree(), first)
    assert me("SetContinuousStates", reals(0.5, 0.1, 0.2, 0.3), 4) == OK
    columns_agree()
    assert me.set(force=0.5) == me("SetTime", 0.7) == OK
    columns_agree()
    assert me("SetFMUstate", snapshot) == OK
    assert np.array_equal(columns_agree(), first)
    assert me("FreeFMUstate", byref(snapshot)) == OK


def test_time_can_be_a_known(me):
    me.initialize()
    me("EnterContinuousTimeMode")
    me("SetTime", 0.4)
    assert directional(me, ["wave"], ["time"], [1.0])[0] == pytest.approx(
        3 * np.cos(1.2), abs=1e-14
    )


def test_in_initialization_calculated_starts_follow_parameters_inputs_and_time(me):
    unknowns = ("w", *UNKNOWNS)
    knowns = {"time": 0.4, "q": 0.8, "force": 0.3, "push": 0.7} | PARAMETERS

    def evaluate(values):
        me("Reset")
        me.set_up(values["time"])
        me("EnterInitializationMode")
        assert me.set(**{name: value for name, value in values.items() if name != "time"}) == OK
        return me.get(*unknowns)

    expected = differences(evaluate, knowns)
    evaluate(knowns)
    error = np.abs(jacobian(me, unknowns, knowns) - expected).max()
    assert error < 1e-9  # of the differences; measured 1.1e-10
    on_w = dict(zip(knowns, expected[0], strict=True))
    assert min(abs(on_w[name]) for name in ("load", "push", "time")) > 0.1  # w does depend on them


def test_seeds_add_up(me):
    me.initialize()
    both = directional(me, UNKNOWNS, ["q", "force", "q"], [1.0, 2.0, 3.0])
    parts = jacobian(me, UNKNOWNS, ["q", "force"]) @ [4.0, 2.0]
    np.testing.assert_allclose(both, parts, rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("unknown", "known"),
    [("force", "q"), ("mass", "q"), ("time", "q"), ("energy", "v_dot"), ("energy", "wave"),
     ("energy", "a")],
)  # fmt: skip
def test_what_is_not_unknown_or_known_is_an_error_that_names_it(me, unknown, known):
    me.initialize()
    room = reals(0)
    status = me("GetDirectionalDerivative", me.refs(unknown), 1, me.refs(known), 1, reals(1), room)
    assert status == ERROR
    assert "is not a" in me.said


def test_missing_seed_and_missing_room_are_errors(me, fmi2):
    for seed, room in ((None, reals(0)), (reals(1), None)):
        fmu = fmi2()
        fmu.initialize()
        refs = fmu.refs("energy"), 1, fmu.refs("q"), 1
        assert fmu("GetDirectionalDerivative", *refs, seed, room) == ERROR


def test_a_derivative_that_is_not_finite_is_discarded(me):
    me.initialize(q=-5.0)  # log(q + 5)
    status = me("GetDirectionalDerivative", me.refs("log"), 1, me.refs("q"), 1, reals(1), reals(0))
    assert status == DISCARD
