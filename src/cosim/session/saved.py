"""The bytes of a saved session: checksum, format, owner, clock, and the state of the FMU."""

import struct
import zlib

from cosim.errors import UsageError

_SUM = struct.Struct("<Q")
_HEAD = struct.Struct("<8s16s3d2q")  # format, owner, clock, number of a state in this process
_BEGIN = _SUM.size + _HEAD.size  # of the state, at a multiple of 8
_FORMAT = b"session2"

ClockFacts = tuple[float, float, float, int]


def packed(owner: bytes, clock: ClockFacts, number: int, state: bytes, *, has_sum: bool) -> bytes:
    """Return the bytes of a session.

    Args:
        owner: Of the state: a model or a session.
        clock: Facts of the clock.
        number: Of a state that the process holds.
        state: Written by the FMU.
        has_sum: Whether the state has a checksum of its own, which the FMU verifies.
    """
    head = _HEAD.pack(_FORMAT, owner, *clock, number)
    return _SUM.pack(zlib.crc32(head if has_sum else head + state)) + head + state


def unpacked(session: str, saved: bytes, *, has_sum: bool) -> tuple[bytes, ClockFacts, int, bytes]:
    """Return owner, clock, number and state.

    Raises:
        UsageError: The bytes are no saved session, or damaged.
    """
    if type(saved) is not bytes:
        UsageError.reject(f"{session}: restore", saved, bytes, "what save has returned")
    head, state = saved[_SUM.size : _BEGIN], saved[_BEGIN:]
    if len(head) < _HEAD.size:
        raise damaged(session)
    form, owner, now, first, length, count, number = _HEAD.unpack(head)
    same_sum = _SUM.unpack_from(saved)[0] == zlib.crc32(head if has_sum else head + state)
    if form != _FORMAT or not same_sum:
        raise damaged(session)
    return owner, (now, first, length, count), number, state


def damaged(session: str) -> UsageError:
    """Return the error of bytes that are no saved session."""
    return UsageError(f"{session}: these bytes are no saved session, or damaged")


def unpicklable(owner: str) -> UsageError:
    """Return the error of pickling a session or copies."""
    return UsageError(
        f"{owner}: a session is a running model and cannot be pickled; pickle what save returns, "
        "and restore it in another session"
    )
