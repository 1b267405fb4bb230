"""Saved and serialized FMU states: equal bits after a restore, and nothing foreign is restored."""

from ctypes import byref, c_char, c_size_t, c_void_p

import pytest
from helpers.harness import ERROR, OK

pytestmark = pytest.mark.parametrize("solver", ["step", "dop853"], scope="session")


@pytest.fixture
def run(cs):
    cs.initialize()
    for k in range(5):
        assert cs("DoStep", k * 0.1, 0.1, 1) == OK
    return cs


def bytes_of(data):
    return (c_char * len(data)).from_buffer_copy(data)


def test_a_serialized_state_continues_in_another_instance_with_the_same_bits(run, fmi2):
    blob = run.serialize(run.take())
    twin, snapshot = fmi2(1), c_void_p()
    assert twin("DeSerializeFMUstate", blob, len(blob), byref(snapshot)) == OK
    assert twin("SetFMUstate", snapshot) == OK
    for fmu in (run, twin):
        assert fmu("DoStep", 0.5, 0.3, 1) == OK
    assert twin.get(*twin.reference) == run.get(*run.reference)


def test_a_state_is_a_copy_and_its_room_is_reused(run):
    snapshot = run.take()
    before = run.serialize(snapshot).raw
    address = snapshot.value
    assert run("DoStep", 0.5, 0.1, 1) == OK
    assert run.serialize(snapshot).raw == before
    assert run("GetFMUstate", byref(snapshot)) == OK
    assert snapshot.value == address
    assert run.serialize(snapshot).raw != before
    assert run("FreeFMUstate", byref(snapshot)) == OK
    assert snapshot.value is None
    assert run("FreeFMUstate", byref(snapshot)) == OK  # again: nothing to free
    assert run("FreeFMUstate", None) == OK


def refused(fmu, blob):
    """Try to restore; the instance must go on as if nothing had happened."""
    before, snapshot = fmu.serialize(fmu.take()).raw, c_void_p(0)
    status = fmu("DeSerializeFMUstate", bytes_of(blob), len(blob), byref(snapshot))
    assert status == ERROR
    assert snapshot.value is None
    assert fmu.serialize(fmu.take()).raw == before
    return fmu.said


def test_any_flipped_bit_is_found(run):
    blob = run.serialize(run.take()).raw
    for position in range(len(blob)):
        damaged = bytearray(blob)
        damaged[position] ^= 1 << position % 8
        refused(run, bytes(damaged))
    assert run("DoStep", 0.5, 0.1, 1) == OK


def test_other_lengths_and_garbage_of_the_right_length_are_refused(run):
    blob = run.serialize(run.take()).raw
    for length in (0, 1, 39, len(blob) - 1):
        assert "another length" in refused(run, blob[:length])
    assert "another length" in refused(run, blob + b"\0")
    assert "not an FMU state" in refused(run, bytes(len(blob)))
    assert "another model" in refused(run, blob[:24] + b"otherone" + blob[32:])
    assert "another version" in refused(run, blob[:8] + b"\xff" + blob[9:])
    assert "damaged" in refused(run, blob[:-8] + b"garbage!")


def test_a_state_of_the_other_interface_is_refused(run, me):
    me.set_up()
    assert "does not fit" in refused(me, run.serialize(run.take()).raw)


def test_missing_arguments_are_errors_that_leave_the_instance_alone(run):
    snapshot = run.take()
    blob = run.serialize(snapshot)
    assert run("GetFMUstate", None) == ERROR
    assert run("SetFMUstate", None) == ERROR
    assert run("SerializedFMUstateSize", None, byref(c_size_t())) == ERROR
    assert run("SerializedFMUstateSize", snapshot, None) == ERROR
    assert run("SerializeFMUstate", snapshot, None, len(blob)) == ERROR
    assert run("SerializeFMUstate", snapshot, blob, len(blob) - 1) == ERROR
    assert run("DeSerializeFMUstate", None, len(blob), byref(c_void_p())) == ERROR
    assert run("DeSerializeFMUstate", blob, len(blob), None) == ERROR
    assert run("DoStep", 0.5, 0.1, 1) == OK


def test_after_an_error_a_saved_state_leads_on(run):
    snapshot = run.take()
    assert run("DoStep", 0.5, -1.0, 1) == ERROR
    assert run("DoStep", 0.5, 0.1, 1) == ERROR
    assert run("SetFMUstate", snapshot) == OK
    assert run("DoStep", 0.5, 0.1, 1) == OK
