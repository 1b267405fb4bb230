"""Random sequences of what a session can do, against one that goes straight on."""

from contextlib import ExitStack, suppress

import numpy as np
import pytest

import cosim

SHARES = {
    "advance": 12,
    "again": 1,
    "save": 3,
    "restore": 3,
    "copy": 1,
    "reset": 0.5,
    "wrong": 2,
    "linear": 1,
}
WRONG = [
    lambda s: s.advance(-1.0),
    lambda s: s.advance(to=-1.0),
    lambda s: s.set(nothing=1.0),
    lambda s: s.get(["none"]),
    lambda s: s.restore(b"none"),
]


def straight(session, push, times):
    """Return the outputs, events and times of a session that only sets inputs and advances.

    Args:
        push: Values of all inputs within each step.
        times: That it reaches, s.
    """
    found = [(session.time, session.get(), ())]
    for value, time in zip(push, times, strict=True):
        if session.inputs:
            session.set([value] * len(session.inputs))
        events = session.advance(to=time)
        found.append((session.time, session.get(), events))
    return found


def detour(session, push, expected, choose, *, step=None, moves=150, copies=True, outlives=True):
    """Do random things with a session; what it returns must have the bits of the straight run.

    Args:
        expected: What `straight` returned for other sessions of the same model.
        choose: Of `random`.
        step: Length of the steps, s; by times when None.
        copies: Whether it can be copied.
        outlives: Whether saved states outlive a reset.
    """
    place, saved = 0, []
    with ExitStack() as opened:
        opened.callback(session.close)
        for _ in range(moves):
            (what,) = choose.choices([*SHARES], [*SHARES.values()])
            if what == "advance" and place + 1 < len(expected):
                if session.inputs:
                    session.set([push[place]] * len(session.inputs))
                place += 1
                time, _, events = expected[place]
                found = session.advance(step) if step else session.advance(to=time)
                assert [(e.time, e.name) for e in found] == [(e.time, e.name) for e in events]
            elif what == "again":
                assert session.advance(0) == session.advance(to=session.time) == ()
            elif what == "save":
                saved.append((place, session.save()))
            elif what == "restore" and saved:
                place, content = choose.choice(saved)
                session.restore(content)
            elif what == "copy" and copies:
                session = session.copy()
                opened.callback(session.close)
            elif what == "reset":
                session.reset()
                place, saved = 0, saved if outlives else []
            elif what == "wrong":
                with pytest.raises(cosim.CosimError):
                    choose.choice(WRONG)(session)
            elif what == "linear":
                with suppress(cosim.CosimError):  # rejected at corners and with samples
                    session.linearize()
            time, values, _ = expected[place]
            assert session.time == time
            if choose.random() < 0.7:
                np.testing.assert_array_equal(session.get(), values)


def sample_after_another_begin(session):
    """Return the sample at 0.05 s of a driven ball that begins there, as it is restored.

    Samples are at 0.05, 0.18, ...; one that began before has none left in its step to 0.06 s.
    """
    assert [len(session.advance(to=time)) for time in (0.03, 0.05)] == [0, 1]
    saved = session.save()
    session.reset(start_time=0.05)
    begin = session.save()
    session.restore(saved)
    assert session.advance(to=0.06) == ()  # before: the sample of the other begin
    session.reset()
    session.restore(begin)
    (sample,) = session.advance(to=0.06)  # before: none
    return sample.name, sample.time
