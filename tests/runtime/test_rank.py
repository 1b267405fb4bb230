"""Constraints that lose rank: seen by a model exchange that is told of its steps, and in steps.

The toy's lose rank where q = 0; its derivatives are its own, so that positions are told here.
"""

from ctypes import byref, c_bool, c_double, c_int

import pytest
from helpers import harness, toy
from helpers.harness import DISCARD, ERROR, OK, reals

VERSIONS = {2: harness.Fmu2, 3: harness.Fmu3}
SOLVERS = ("step", "dop853")
DERIVATIVES = {"fmi2": "GetDerivatives", "fmi3": "GetContinuousStateDerivatives"}


@pytest.fixture(scope="module", params=[(v, s) for v in VERSIONS for s in SOLVERS], ids=str)
def watched(request, tmp_path_factory):
    """Make instances of the toy with a watch, in both versions of FMI, with both solvers."""
    if harness.compiler() is None:
        pytest.skip("needs a C compiler")
    version, solver = request.param
    model = tmp_path_factory.mktemp("watched")
    toy.write(model, toy.toy(), toy.TABLE, solver, rank=True)
    library = harness.library(model, version, tmp_path_factory.mktemp("library"))
    names = [row.name for row in toy.TABLE]
    made = []

    def make(interface):
        made.append(VERSIONS[version](library, names, interface))
        made[-1].solver = solver
        return made[-1]

    yield make
    for instance in made:
        instance.free()


@pytest.fixture
def me(watched):
    """An instance in continuous-time mode at t = 0, q = 1."""
    fmu = watched(0)
    fmu.initialize()
    assert fmu("EnterContinuousTimeMode") == OK
    return fmu


def at(fmu, t, q, v):
    """Bring an instance to a time and a state, as an importer's solver does."""
    assert fmu("SetTime", c_double(t)) == OK
    assert fmu("SetContinuousStates", reals(q, v, 1.0, 1.0), 4) == OK


def completed(fmu, t, q, v):
    at(fmu, t, q, v)
    kind = c_int if fmu.prefix == "fmi2" else c_bool
    enter, stop = kind(1), kind(1)
    status = fmu("CompletedIntegratorStep", 1, byref(enter), byref(stop))
    assert (enter.value, stop.value) == (0, 0)
    return status


@pytest.mark.slow
def test_a_loss_within_a_step_is_an_error_that_says_where(me):
    """q falls from 0.1 to -0.1 in a straight line: through 0 in the middle."""
    assert completed(me, 1.0, 0.1, -1.0) == OK
    assert completed(me, 1.2, -0.1, -1.0) == ERROR
    assert "the constraints lose rank at time 1.1 (constraint_condition" in me.said
    assert ("use co-simulation" in me.said) is (me.solver == "dop853")


@pytest.mark.slow_rows("(2, 'step')", "(3, 'step')")
def test_a_step_that_turns_before_a_loss_is_fine(me):
    assert completed(me, 1.0, 0.1, -1.0) == OK
    assert completed(me, 1.1, 0.1, 1.0) == OK  # the least q between is 0.075


def test_a_state_at_a_loss_is_an_error(me):
    assert completed(me, 1.0, 5e-4, -1.0) == ERROR
    assert "at time 1 " in me.said


def test_a_branch_that_turns_where_rank_is_lost_is_an_error(me):
    """A straight way through 0 at t = 1.1, of which the end says nothing: q is back at 0.1."""
    assert completed(me, 0.9, 0.2, -1.0) == OK
    assert completed(me, 1.0, 0.1, -1.0) == OK
    assert completed(me, 1.2, 0.1, 1.0) == ERROR
    assert "lose rank at time 1.1 " in me.said


def test_an_evaluation_at_a_loss_within_a_step_is_an_error(me):
    """Short steps of a solver within the one that it tells of."""
    assert completed(me, 1.0, 0.1, 0.0) == OK
    at(me, 1.05, 1e-6, 0.0)
    me.states(DERIVATIVES[me.prefix])
    assert "near time 1.05 the constraints lose rank" in me.said
    assert completed(me, 1.1, 0.1, 0.0) == ERROR
    assert "lose rank at time 1.05 " in me.said


def test_an_evaluation_ahead_counts_once_time_has_passed_it(me):
    at(me, 1.5, 1e-6, 0.0)
    me.states(DERIVATIVES[me.prefix])
    assert completed(me, 1.0, 0.1, 0.0) == OK
    assert completed(me, 1.6, 0.1, 0.0) == ERROR


def test_time_that_goes_back_begins_the_watch_anew(me):
    assert completed(me, 1.0, 0.1, -1.0) == OK
    assert completed(me, 0.5, -0.1, -1.0) == OK


def test_a_snapshot_holds_what_was_seen(me):
    assert completed(me, 1.0, 0.1, -1.0) == OK
    snapshot = me.take()
    assert completed(me, 1.05, 0.1, 1.0) == OK
    assert me(f"Set{me.state}", snapshot) == OK
    assert completed(me, 1.2, -0.1, -1.0) == ERROR
    assert me(f"Free{me.state}", byref(snapshot)) == OK


def stepped(fmu, length):
    """Step until a step fails or t = 2; return its status and the last good time."""
    t = 0.0
    while t < 2:
        flags = [byref(c_bool()), byref(c_bool()), byref(c_bool()), byref(c_double())]
        more = flags if fmu.prefix == "fmi3" else []
        status = fmu("DoStep", c_double(t), c_double(length), 1, *more)
        if status != OK:
            return status, t
        t += length
    return OK, t


@pytest.mark.parametrize("length", [0.05, 0.5])
def test_steps_of_dop853_pass_a_loss_and_others_are_discarded(watched, length):
    """q = cos-like, through 0 near 0.8: no singularity of this toy, whose steps go on beyond."""
    fmu = watched(1)
    fmu.initialize()
    status, reached = stepped(fmu, length)
    if fmu.solver == "dop853":
        assert (status, reached) == (OK, pytest.approx(2.0))
    else:
        assert status == DISCARD
        assert reached == pytest.approx(0.8, abs=length)
        assert any("the constraints lose rank at time 0." in text for *_, text in fmu.messages)


def test_a_step_to_where_derivatives_have_no_value_leaves_a_state_that_can_be_restored(me):
    assert completed(me, 0.1, -20.0, 0.0) == OK  # the root of q + 10 has none
    snapshot = me.take()
    assert me(f"Set{me.state}", snapshot) == OK, me.said
    assert completed(me, 0.2, 1.0, 0.0) == OK
