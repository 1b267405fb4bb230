"""FMI 2.0 model exchange: values, what may be set when, refusals that name the cause."""

from math import isclose, sqrt

import numpy as np
import pytest
from helpers.harness import (
    DISCARD,
    ERROR,
    INF,
    NAN,
    OK,
    WARNING,
    EventInfo,
    byref,
    c_int,
    reals,
    references,
)
from helpers.toy import TABLE


def continuous(fmu):
    assert fmu("EnterContinuousTimeMode") == OK
    return fmu


def test_the_calculated_start_solves_its_equation(me):
    (w,) = me.initialize().get("w")
    assert abs(w + w**2 - 2) < 1e-12  # load 2; measured 0


def test_the_calculated_start_follows_a_parameter_set_in_initialization_mode(me):
    me.set_up()
    me("EnterInitializationMode")
    assert me.get("w")[0] == pytest.approx(1.0, abs=1e-12)
    assert me.set(load=6.0) == OK
    assert me.get("w")[0] == pytest.approx(2.0, abs=1e-12)  # 2 + 4 = 6


def test_the_calculated_start_follows_an_input_and_the_start_time(me):
    me.set_up(0.5)
    me("EnterInitializationMode")
    assert me.get("w")[0] == pytest.approx(1.0, abs=1e-12)
    assert me.set(push=8.0) == OK
    assert me.get("w")[0] == pytest.approx(2.0, abs=1e-12)  # 2 + 4 = 2 + 8 / 2
    assert me("Reset") == OK
    continuous(me.initialize({"start": 0.5}, push=8.0))
    (w,) = me.get("w")
    assert me.set(push=0.0) == me("SetTime", 0.7) == OK
    assert me.get("w") == [w]


def test_a_calculated_start_has_the_same_bits_whatever_was_solved_before(me, fmi2):
    me.set_up()
    me("EnterInitializationMode")
    for load in range(1, 20):
        assert me.set(load=load / 7) == OK
        fresh = fmi2()
        fresh.initialize(load=load / 7)
        assert me.get("w") == fresh.get("w")


def test_algebraics_derivatives_and_outputs_satisfy_the_equations(me):
    me.initialize(q=0.7, v=-0.3)
    q, v, w, a, r, v_dot, w_dot, energy, log = me.get(
        "q", "v", "w", "a", "r", "v_dot", "w_dot", "energy", "log"
    )
    assert abs(2 * a + 0.5 * v + 8 * q - 0.1 * r) < 1e-14
    assert abs(r - 2 * a - w) < 1e-14
    assert v_dot == a
    assert isclose(w_dot, -w * sqrt(q + 10), rel_tol=1e-15)
    assert isclose(energy, v**2 + 4 * q**2, rel_tol=1e-15)
    assert isclose(log, np.log(q + 5), rel_tol=1e-15)


@pytest.mark.parametrize("kind", ["time", "states", "state by reference", "input"])
def test_every_setter_makes_results_stale(me, kind):
    continuous(me.initialize())
    before = me.get("wave", "v_dot")
    if kind == "time":
        assert me("SetTime", 0.5) == OK
        assert me.get("wave")[0] == pytest.approx(np.sin(1.5), abs=1e-15)
    elif kind == "states":
        assert me("SetContinuousStates", reals(2.0, 0.0, 0.0, 0.0), 4) == OK
    elif kind == "state by reference":
        assert me.set(q=2.0) == OK
    else:
        assert me.set(force=1.0, push=1.0) == OK
    assert me.get("wave", "v_dot") != before


def test_derivatives_come_in_the_order_of_the_states(me):
    continuous(me.initialize())
    assert me.states("GetDerivatives") == me.get("q_dot", "v_dot", "w_dot", "s_dot")
    assert me.states() == me.get("q", "v", "w", "s")
    assert me.states("GetNominalsOfContinuousStates") == [0.5, 2.0, 1.0, 1.0]


def test_there_are_no_events(me):
    me.initialize()
    info = EventInfo(1, 1, 1, 1, 1, 1.0)
    assert me("NewDiscreteStates", byref(info)) == OK
    assert [getattr(info, name) for name, _ in EventInfo._fields_] == [0, 0, 0, 0, 0, 0.0]
    continuous(me)
    enter, stop = c_int(1), c_int(1)
    assert me("CompletedIntegratorStep", 1, byref(enter), byref(stop)) == OK
    assert (enter.value, stop.value) == (0, 0)
    margin = reals(0.0)
    assert me("GetEventIndicators", margin, 1) == OK
    assert margin[0] == 2 - me.get("q")[0]  # of the limit


def test_reset_makes_a_run_repeatable_to_the_bit(me):
    def values():
        continuous(me.initialize(load=3.0, q=0.4))
        me("SetTime", 1.25)
        return me.get(*me.reference)

    first = values()
    assert me("Terminate") == OK
    assert me("Reset") == OK
    assert values() == first


# -- what is refused ------------------------------------------------------------------------------

NOT_SETTABLE = {
    "instantiated": ["time", "v_dot", "energy"],
    "initialization": ["time", "w", "a", "v_dot", "energy"],
    "event": ["time", "q", "w", "a", "v_dot", "mass", "energy"],
    "continuous": ["time", "a", "v_dot", "mass", "energy"],
}
SETTABLE = {
    "instantiated": ["q", "v", "w", "a", "force", "mass"],
    "initialization": ["q", "v", "force", "mass"],
    "event": ["force", "damping"],
    "continuous": ["q", "w", "force", "damping"],
}


def bring(fmu, mode):
    for step in ["instantiated", "initialization", "event", "continuous"]:
        if step == "initialization":
            fmu.set_up()
            fmu("EnterInitializationMode")
        elif step == "event":
            fmu("ExitInitializationMode")
        elif step == "continuous":
            fmu("EnterContinuousTimeMode")
        if step == mode:
            return fmu
    raise AssertionError(mode)


@pytest.mark.parametrize(("mode", "name"), [(m, n) for m in SETTABLE for n in SETTABLE[m]])
def test_a_variable_can_be_set_where_the_standard_allows_it(me, mode, name):
    assert bring(me, mode).set(**{name: 0.25}) == OK


def test_a_value_given_to_a_calculated_start_is_where_its_solution_begins(me, fmi2):
    """w + w^2 = 2 has the roots 1 and -2; after a reset the model's own guess counts again."""
    me.set(w=-3.0)
    assert me.initialize().get("w") == [pytest.approx(-2.0, abs=1e-12)]
    assert me("Reset") == OK
    assert me.initialize().get("w") == fmi2().initialize().get("w")


def test_a_limit_of_the_model_is_told_once(me, fmi2):
    """The toy holds while q < 2 m."""
    continuous(me.initialize())
    told = []
    for time, q in ((0.1, 1.9), (0.2, 2.1), (0.3, 2.2), (0.4, 1.8), (0.5, 2.5)):
        me("SetTime", time)
        me.set(q=q)
        me.get("energy")
        told.append(len(me.messages))
    assert told == [0, 1, 1, 1, 1]
    status, category, text = me.messages[-1]
    assert (status, category) == (WARNING, "logStatusWarning")
    assert text == "fmi2GetReal: invalid from 0.2 s: not fulfilled: q < 2 m"
    margin = reals(0.0)
    assert me("GetEventIndicators", margin, 1) == OK
    assert margin[0] == -1  # it is not watched any more
    snapshot, again = me.take(), continuous(fmi2().initialize())
    assert again("SetFMUstate", snapshot) == OK
    again.get("energy")
    assert again.messages == []  # the crossing belongs to the FMU state


def test_a_tunable_parameter_counts_from_when_it_is_set(me):
    """mass v' + damping v + stiffness q = force + 0.1 r, r = 2 a + w."""
    continuous(me.initialize(v=1.0))
    before = me.get("v_dot")[0]
    assert me.set(damping=0.9) == OK
    mass = me.get("mass")[0]
    assert me.get("v_dot")[0] - before == pytest.approx(-0.4 / (mass - 0.2), rel=1e-12)
    assert me.set(damping=-1.0) == DISCARD
    assert me.said == "fmi2SetReal: damping = -1 is not within 0 ... inf"


@pytest.mark.parametrize(("mode", "name"), [(m, n) for m in NOT_SETTABLE for n in NOT_SETTABLE[m]])
def test_a_variable_cannot_be_set_elsewhere_and_the_message_names_it(me, mode, name):
    assert bring(me, mode).set(force=1.0, **{name: 0.25}) == ERROR
    assert me.said.startswith(f"fmi2SetReal: {name}, a ")
    if mode != "instantiated":
        assert me.get("force") == [0.0]  # all or nothing


@pytest.mark.parametrize("value", [NAN, INF, -INF])
@pytest.mark.parametrize("name", ["q", "mass", "force"])
def test_a_value_that_is_not_finite_is_discarded(me, name, value):
    assert me.set(**{name: value}) == DISCARD
    assert me.said.startswith(f"fmi2SetReal: {name} = ")
    assert np.isfinite(me.initialize().get(name)).all()


def test_a_parameter_outside_its_bounds_is_discarded_with_name_value_and_range(me):
    assert me.set(mass=-1.0) == DISCARD
    assert me.said == "fmi2SetReal: mass = -1 is not within 0.001 ... 1000"
    assert me.set(mass=1001.0) == DISCARD
    assert me.initialize().get("mass") == [2.0]


def test_states_that_are_not_finite_are_discarded_and_the_old_ones_stay(me):
    continuous(me.initialize())
    before = me.states()
    assert me("SetContinuousStates", reals(0.0, NAN, 0.0, 0.0), 4) == DISCARD
    assert me.said == "fmi2SetContinuousStates: v = nan is not finite"
    assert me.states() == before


def test_a_state_outside_the_domain_discards_the_derivatives_and_nothing_else(me):
    continuous(me.initialize())
    assert me("SetContinuousStates", reals(-11.0, 0.0, 1.0, 0.0), 4) == OK
    assert me("GetDerivatives", reals(0, 0, 0, 0), 4) == DISCARD  # sqrt(q + 10)
    assert "w_dot is" in me.said
    assert me.states() == [-11.0, 0.0, 1.0, 0.0]
    assert me("SetContinuousStates", reals(1.0, 0.0, 1.0, 0.0), 4) == OK
    assert me.states("GetDerivatives")[2] == pytest.approx(-sqrt(11), abs=1e-15)


def test_an_output_outside_its_domain_does_not_hide_the_others(me):
    continuous(me.initialize())
    me.set(q=-6.0)
    assert me("GetReal", me.refs("log"), 1, reals(0)) == DISCARD
    assert "log is" in me.said
    assert me.get("energy") == [144.0]


def test_start_values_without_a_solution_are_an_error_that_names_the_states(me):
    me.set_up()
    assert me.set(load=-1.0) == OK  # w + w^2 = -1 has no real root
    assert me("EnterInitializationMode") == OK
    assert me("GetReal", me.refs("w"), 1, reals(0)) == DISCARD
    assert me.said.startswith("fmi2GetReal: the start values of w cannot be calculated (defect ")
    assert me.set(load=2.0) == OK
    assert me.get("w")[0] == pytest.approx(1.0, abs=1e-12)
    assert me.set(load=-1.0) == OK
    assert me("ExitInitializationMode") == ERROR
    assert "start values of w cannot be calculated" in me.messages[-2][2]


def test_algebraic_equations_without_a_solution_are_an_error(me):
    me.set_up()
    assert me.set(mass=0.2) == OK  # (mass - 0.2) a = ...
    assert me("EnterInitializationMode") == OK
    assert me("ExitInitializationMode") == ERROR
    assert "the algebraic equations have no solution at time 0" in me.messages[-2][2]


@pytest.mark.parametrize("reference", [len(TABLE), 2**31, 2**32 - 1])
def test_unknown_value_references_are_an_error(me, reference):
    me.initialize()
    value = reals(7.0)
    assert me("GetReal", references(reference), 1, value) == ERROR
    assert list(value) == [7.0]
    assert f"value reference {reference} is unknown" in me.said


@pytest.mark.parametrize("function", ["GetReal", "SetReal", "GetInteger", "SetString"])
def test_no_references_and_null_arrays_are_fine(me, function):
    me.initialize()
    assert me(function, None, 0, None) == OK


@pytest.mark.parametrize("function", ["GetReal", "SetReal", "GetInteger", "SetBoolean"])
def test_null_arrays_with_a_length_are_an_error(me, function):
    me.initialize()
    assert me(function, None, 1, None) == ERROR


@pytest.mark.parametrize("function", ["GetReal", "SetReal"])
def test_references_without_values_are_an_error(me, function):
    me.initialize()
    assert me(function, me.refs("force"), 1, None) == ERROR


@pytest.mark.parametrize("count", [0, 3, 5, 2**63])
@pytest.mark.parametrize(
    "function",
    ["GetContinuousStates", "SetContinuousStates", "GetDerivatives",
     "GetNominalsOfContinuousStates"],
)  # fmt: skip
def test_another_number_of_states_is_an_error_and_nothing_is_written(me, function, count):
    continuous(me.initialize())
    values = reals(7, 7, 7, 7, 7)
    assert me(function, values, count) == ERROR
    assert list(values) == [7.0] * 5
    assert "the model has 4 states" in me.said


def test_time_must_be_finite(me):
    continuous(me.initialize())
    assert me("SetTime", NAN) == ERROR
    assert me.said == "fmi2SetTime: time nan is not finite"


@pytest.mark.parametrize(
    "experiment",
    [
        {"start": NAN}, {"start": INF}, {"start": 1.0, "stop": 0.5}, {"stop": NAN},
        {"tolerance": -1e-6}, {"tolerance": NAN}, {"tolerance": INF},
    ],
)  # fmt: skip
def test_a_senseless_experiment_is_an_error(me, experiment):
    assert me.set_up(**experiment) == ERROR


def test_a_tolerance_out_of_reach_is_replaced_with_a_warning(me):
    assert me.set_up(tolerance=1e-20) == WARNING
    assert me.messages[-1][1] == "logStatusWarning"


def test_initialization_needs_an_experiment(me):
    assert me("EnterInitializationMode") == ERROR
    assert me.said == "fmi2EnterInitializationMode: call fmi2SetupExperiment first"
