"""Saved states: bytes that outlive a session, that are damaged, or that a file does not write."""

import copy
import pickle
import struct

import numpy as np
import pytest
from helpers.detours import sample_after_another_begin
from helpers.event_models import ball
from helpers.fmi_cases import VERSIONS
from helpers.foreign_part import foreign_part
from helpers.small_models import decay, growing

import cosim
from cosim.errors import FmuError, UsageError


def test_saved_state_outlives_the_session_and_the_file(tmp_path):
    with cosim.open(decay()) as session:
        session.advance(0.5)
        saved, x = session.save(), session["x"]
    with cosim.open(cosim.export_fmu(decay(), tmp_path / "again.fmu", fmi=3)) as session:
        session.restore(saved)
        assert (session.time, session["x"]) == (0.5, x)


def test_a_state_of_another_tolerance_is_rejected(tmp_path):
    """It would bring its tolerance along."""
    path = cosim.export_fmu(decay(), tmp_path / "decay.fmu")
    for model in (decay(), path):
        with (
            cosim.open(model, relative_tolerance=1e-3) as loose,
            cosim.open(model, relative_tolerance=1e-9) as tight,
        ):
            with pytest.raises(UsageError, match="or with another relative_tolerance"):
                tight.restore(loose.save())
            assert tight.copy()["x"] == tight["x"]


def test_wrong_bytes_are_rejected_and_change_nothing(session):
    session.advance(0.1)
    saved, x = session.save(), session["x"]
    damaged = saved[:100] + bytes([saved[100] ^ 1]) + saved[101:]
    for content, what in ((damaged, "damaged"), (b"", "no saved session"), (saved[:-1], "damaged")):
        with pytest.raises(UsageError, match=what):
            session.restore(content)
    with cosim.open(ball()) as other, pytest.raises(UsageError, match="another model"):
        session.restore(other.save())
    with pytest.raises(UsageError, match="type int"):
        session.restore(3)
    assert (session.time, session["x"]) == (0.1, x)


@VERSIONS
def test_every_damaged_byte_is_found_and_leaves_the_session_as_it_was(fmi, fmus):
    with cosim.open(fmus["driven_ball", fmi]) as session:
        session.advance(0.5)
        saved = session.save()
        for place in range(len(saved)):
            damaged = bytearray(saved)
            damaged[place] ^= 1 << place % 8
            with pytest.raises(UsageError, match="damaged"):
                session.restore(bytes(damaged))
        session.advance(0.1)
        session.restore(saved)
        assert (session.time, session.save()) == (0.5, saved)


@pytest.mark.slow
def test_two_signs_that_change_are_found():
    """A checksum that multiplies by odd numbers alone does not see changes of two highest bits."""
    with cosim.open("bicycle") as bike:
        bike.advance(0.1)
        saved = bike.save()
        places = [saved.index(struct.pack("<d", bike[name])) + 7 for name in ("phi", "phi_dot")]
        damaged = bytearray(saved)
        for place in places:
            damaged[place] ^= 0x80
        with pytest.raises(UsageError, match="damaged"):
            bike.restore(bytes(damaged))


def test_failed_session_takes_a_state_of_another_one():
    """It has never saved, and its own state may not be fit to be saved."""
    with cosim.open(growing()) as other, cosim.open(growing()) as session:
        other.advance(0.1)
        saved, values = other.save(), other.get()
        with pytest.raises(FmuError):
            session.advance(1e9)
        with pytest.raises(UsageError, match="damaged"):
            session.restore(saved[:-8] + bytes(8))
        with pytest.raises(UsageError, match="damaged"):
            session.restore(saved[:-8])
        session.restore(saved)
        np.testing.assert_array_equal(session.get(), values)


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy])
def test_copies_of_python_are_sessions_of_their_own(copied, session):
    session.advance(0.5)
    branch = copied(session)
    x = session["x"]
    session.advance(0.5)
    session.close()
    assert (branch.time, branch["x"]) == (0.5, x)
    branch.close()


def test_sessions_are_not_pickled_but_their_states_are(session):
    session.advance(0.5)
    saved, x = pickle.loads(pickle.dumps(session.save())), session["x"]
    session.reset()
    session.restore(saved)
    assert (session.time, session["x"]) == (0.5, x)
    with cosim.open("crank_shaft", copies=2) as copies:
        for one in (session, copies):
            with pytest.raises(UsageError, match="pickle what save returns"):
                pickle.dumps(one)


@pytest.mark.parametrize("copies", [None, 2])
def test_sessions_are_no_collections_of_names(copies):
    with cosim.open("crank_shaft", copies=copies) as shaft:
        with pytest.raises(TypeError, match="not iterable"):
            list(shaft)
        with pytest.raises(TypeError, match="not iterable"):
            _ = "omega" in shaft
    with pytest.raises(FmuError, match="closed"), shaft:
        pass


def test_file_that_writes_no_bytes_goes_back_in_its_own_session(tmp_path):
    path = foreign_part(tmp_path, "lag", canSerializeFMUstate="false")
    with cosim.open(path, start_values={"u": 1.0}) as session, cosim.open(path) as other:
        saved = session.save()
        session.advance(0.5)
        session.restore(saved)
        assert (session.time, session["y"]) == (0.0, 0.0)
        with pytest.raises(UsageError, match="another session"):
            other.restore(saved)
        with pytest.raises(FmuError, match="cannot be copied"):
            session.copy()
        session.reset()
        with pytest.raises(UsageError, match="freed by a reset"):
            session.restore(saved)


def test_file_without_states_can_only_begin_again(tmp_path):
    abilities = {"canGetAndSetFMUstate": "false", "canSerializeFMUstate": "false"}
    with cosim.open(foreign_part(tmp_path, "lag", **abilities)) as session:
        session.set(u=1.0)
        session.advance(0.5)
        with pytest.raises(FmuError, match="cannot save its state"):
            session.save()
        session.reset()
        assert (session.time, session["y"]) == (0.0, 0.0)


@VERSIONS
def test_state_of_another_begin_brings_no_event_of_this_one(fmi, fmus):
    with cosim.open(fmus["driven_ball", fmi]) as session:
        assert sample_after_another_begin(session) == ("control", 0.05)


def test_violation_belongs_to_the_branch_that_was_saved():
    """x' = u leaves x < 1 at 0.5 s in one branch; in the other, x stays at 0."""
    model = cosim.Model("limited", stop_time=1.0)
    x, u = model.state("x", "1", 0.0, "state"), model.input("u", "1", 0.0, "input")
    model.derivative(x, u)
    model.limit(x < 1, "x is small")
    dae = model.freeze()
    with cosim.open(dae) as session, cosim.open(dae) as other:
        begin = session.save()
        session.advance(to=1.0)
        still = session.save()
        session.restore(begin)
        session.set(u=2.0)
        session.advance(to=1.0)
        assert "x is small" in session.invalid
        left = session.save()
        session.restore(still)
        assert session.invalid is None  # before: that of the other branch
        other.restore(left)
        assert other.invalid == "invalid from 0.5 s: not fulfilled: x is small"  # before: None
