"""The bytes of a saved session: state of the FMU, notes, format, owner, clock, and checksum."""

import json
import struct
import zlib
from collections.abc import Sequence
from typing import Any

from cosim.errors import UsageError
from cosim.text import Violation

# format, owner, clock, length of the notes
_HEAD = struct.Struct("<8s16s3d2q")
_SUM = 4  # bytes of the checksum
_FORMAT = b"session6"

ClockFacts = tuple[float, float, float, int]


def notes_of(instances: Sequence[Any]) -> bytes:
    """Return the violations, and the events that no step has returned yet; empty if none."""
    found = [
        (list(one.logged.events), [(v.time, v.what) for v in one.logged.violations.counted])
        for one in instances
    ]
    return json.dumps(found).encode() if any(map(any, found)) else b""


def take_notes(instances: Sequence[Any], notes: bytes) -> None:
    """Set what `notes_of` returned for instances of the same files."""
    found = json.loads(notes) if notes else [((), ())] * len(instances)
    for instance, (events, violations) in zip(instances, found, strict=True):
        instance.logged.events[:] = map(tuple, events)
        instance.logged.violations[:] = [Violation(*one) for one in violations]


def packed(owner: bytes, clock: ClockFacts, notes: bytes, state: bytes, *, has_sum: bool) -> bytes:
    """Return the bytes of a session.

    Args:
        owner: Of the state: a model or a session.
        clock: Facts of the clock.
        notes: See `notes_of`.
        state: See `StateCalls`.
        has_sum: Whether the state has a checksum of its own, which the FMU verifies.
    """
    head = notes + _HEAD.pack(_FORMAT, owner, *clock, len(notes))
    checked = head if has_sum else state + head
    return state + (head + zlib.crc32(checked).to_bytes(_SUM, "little"))


def unpacked(session: str, saved: bytes, *, has_sum: bool) -> tuple[bytes, ClockFacts, bytes, int]:
    """Return owner, clock, notes, and the length of the state, which comes first.

    Raises:
        UsageError: The bytes are no saved session, or damaged.
    """
    if type(saved) is not bytes:
        UsageError.reject(f"{session}: restore", saved, bytes, "what save has returned")
    end = len(saved) - _SUM
    place = end - _HEAD.size
    if place < 0:
        raise damaged(session)
    form, owner, now, first, length, count, size = _HEAD.unpack_from(saved, place)
    begin = place - size
    if form != _FORMAT or not 0 <= begin <= place:
        raise damaged(session)
    checked = saved[begin if has_sum else 0 : end]
    if saved[end:] != zlib.crc32(checked).to_bytes(_SUM, "little"):
        raise damaged(session)
    return owner, (now, first, length, count), saved[begin:place], begin


def damaged(session: str) -> UsageError:
    """Return the error of bytes that are no saved session."""
    return UsageError(f"{session}: these bytes are no saved session, or damaged")


def unpicklable(owner: str) -> UsageError:
    """Return the error of pickling a session or copies."""
    return UsageError(
        f"{owner}: a session is a running model and cannot be pickled; pickle what save returns, "
        "and restore it in another session"
    )
