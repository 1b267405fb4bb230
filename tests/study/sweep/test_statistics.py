"""Merged moments against numpy, and their bits against the order in which blocks arrive."""

from functools import reduce

import numpy as np
import pytest

from cosim.study.sweep.block import COMPLETE, NOT_COMPUTED, Block
from cosim.study.sweep.reductions import Keep, Statistics, merged, moments_of
from cosim.study.sweep.samples import Samples
from cosim.study.sweep.store import Layout, Store
from cosim.trajectory import Column

RANDOM = np.random.default_rng(7)
VALUES = RANDOM.normal(3, 2, (157, 5, 2)) * np.array([1.0, 1e-6])
COMPLETE_RUNS = RANDOM.random(157) > 0.1
COLUMNS = (Column("a", "m", "place"), Column("b", "m", "place"))


@pytest.mark.parametrize("size", [1, 16, 64, 4096])
def test_merged_moments_are_those_of_all_runs(size):
    parts = [slice(first, first + size) for first in range(0, len(VALUES), size)]
    found = reduce(merged, (moments_of(VALUES[part], COMPLETE_RUNS[part]) for part in parts))
    chosen = VALUES[COMPLETE_RUNS]
    np.testing.assert_array_equal(found.count, np.full((5, 2), len(chosen)))
    np.testing.assert_allclose(found.mean, chosen.mean(axis=0), rtol=1e-14)
    np.testing.assert_allclose(found.squares, ((chosen - chosen.mean(0)) ** 2).sum(0), rtol=1e-13)
    np.testing.assert_array_equal(found.low, chosen.min(axis=0))
    np.testing.assert_array_equal(found.high, chosen.max(axis=0))


def test_runs_that_an_event_ended_count_as_far_as_they_came():
    values = VALUES[:4].copy()
    values[1, 2:] = np.nan
    values[:3, 4:] = np.nan
    every = np.ones(4, dtype=bool)
    found = merged(moments_of(values[:2], every[:2]), moments_of(values[2:], every[2:]))
    np.testing.assert_allclose(found.mean, np.nanmean(values, axis=0), rtol=1e-14)
    np.testing.assert_array_equal(found.low, np.nanmin(values, axis=0))
    statistics = Statistics(("a", "b"), moments_of(values[:3], every[:3]))
    assert statistics.count == 3
    for kind in ("mean", "variance", "minimum", "maximum"):
        assert np.isfinite(getattr(statistics, kind)("a")).tolist() == [True] * 4 + [False]


def statistics_in(order, folder=None):
    layout = Layout(
        {"model": "m"}, Samples({"p": np.arange(157.0)}), COLUMNS, np.arange(5.0),
        Keep(False, True, ()), 16,
    )  # fmt: skip
    store = Store(layout) if folder is None else Store.created(layout, folder)
    blocks = [*layout.blocks()]
    for i in order:
        first, count = blocks[i]
        part, zeros = slice(first, first + count), np.zeros(count, dtype=np.int64)
        states = np.where(COMPLETE_RUNS[part], COMPLETE, NOT_COMPUTED + 1).astype(np.int8)
        moments = moments_of(VALUES[part], COMPLETE_RUNS[part])
        store.write(Block(first, states, zeros, zeros, {}, {}, None, moments))
    return Store.reopened(layout, folder) if folder else store


@pytest.mark.slow_rows("True")
@pytest.mark.parametrize("stored", [False, True])
def test_statistics_have_the_same_bits_in_whatever_order_blocks_arrive(stored, tmp_path):
    if stored:
        pytest.importorskip("zarr")
    expected = statistics_in(range(10)).statistics()
    other = statistics_in(RANDOM.permutation(10), tmp_path / "store" if stored else None)
    for kind in ("mean", "variance", "minimum", "maximum"):
        for name in ("a", "b"):
            np.testing.assert_array_equal(
                getattr(other.statistics(), kind)(name), getattr(expected, kind)(name)
            )


def test_statistics_of_some_blocks_cover_their_runs():
    found = statistics_in([7, 2]).statistics()
    runs = np.r_[32:48, 112:128]
    chosen = VALUES[runs][COMPLETE_RUNS[runs]]
    np.testing.assert_array_equal(found.count, np.full((5, 2), len(chosen)))
    np.testing.assert_allclose(found.mean("a"), chosen[:, :, 0].mean(axis=0), rtol=1e-14)
