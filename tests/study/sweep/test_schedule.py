"""Which runs are computed when, and what follows the death of a process."""

from itertools import pairwise

from cosim.study.sweep.engines.schedule import Schedule, aligned, gaps


def test_chunks_are_powers_of_two_at_multiples_of_themselves():
    chunks = list(aligned(5, 100, 32))
    assert chunks[0] == (5, 1)
    for (first, count), (after, _) in pairwise(chunks):
        assert after == first + count
        assert first % count == 0
        assert count & (count - 1) == 0
    assert sum(count for _, count in chunks) == 95


def test_what_is_missing_between_finished_chunks_is_found():
    assert gaps(10, [(0, 2), (4, 4)]) == [(2, 4), (8, 10)]
    assert gaps(4, [(0, 4)]) == []


def drained(schedule):
    found = []
    while (chunk := schedule.take(wait=False)) is not None:
        found.append(chunk)
        schedule.done(chunk, 10, 1e-9)
    return found


def test_every_run_is_given_out_once_in_growing_chunks():
    chunks = drained(Schedule([(0, 1000)], 2, None, 1))
    runs = [i for first, count in chunks for i in range(first, first + count)]
    assert runs == list(range(1000))
    assert max(count for _, count in chunks) > 32


def test_a_run_that_crashes_is_alone_after_one_death_and_given_up_after_the_second():
    schedule = Schedule([(0, 8)], 1, 8, 1)
    assert schedule.take() == (0, 8)
    assert schedule.died((0, 8), 5) is None
    while (chunk := schedule.take(wait=False)) != (5, 1):
        schedule.done(chunk, 1, 1.0)
    assert schedule.died((5, 1), 5) == 5


def test_a_run_whose_process_was_killed_is_given_up_after_two_deaths_alone():
    schedule = Schedule([(0, 8)], 1, 8, 1)
    assert schedule.take() == (0, 8)
    assert schedule.died((0, 8), 5, killed=True) is None
    again = []
    while (chunk := schedule.take(wait=False)) is not None:
        again.append(chunk)
    assert sorted(again) == [(0, 4), (4, 1), (5, 1), (6, 2)]
    assert schedule.died((5, 1), 5, killed=True) is None
    assert schedule.take() == (5, 1)
    assert schedule.died((5, 1), 5, killed=True) == 5


def test_without_a_hint_a_chunk_that_dies_twice_is_halved_until_the_run_is_found():
    schedule, deaths = Schedule([(0, 16)], 1, 16, 1), 0
    done, given_up = [], None
    while (chunk := schedule.take(wait=False)) is not None:
        first, count = chunk
        if first <= 11 < first + count:
            deaths += 1
            given_up = schedule.died(chunk, None)
        else:
            done.append(chunk)
            schedule.done(chunk, 1, 1.0)
    assert given_up == 11
    assert sum(count for _, count in done) == 15
    assert deaths <= 7
