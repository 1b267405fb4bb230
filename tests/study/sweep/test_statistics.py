"""Merged statistics against numpy, and their bits against other groupings of the runs."""

import numpy as np
import pytest

from cosim.study.sweep.engines.schedule import aligned
from cosim.study.sweep.statistics import Sketch, added, merged, node_of, quantile, sketch_of

RANDOM = np.random.default_rng(7)
VALUES = RANDOM.normal(3, 2, (157, 5, 2)) * np.array([1.0, 1e-6])
GOOD = RANDOM.random(157) > 0.1


def pieces(most):
    nodes, sketch = [], Sketch(np.empty(0, np.int64), np.empty(0, np.int64))
    for first, count in aligned(0, len(VALUES), most):
        part = slice(first, first + count)
        nodes.append(node_of(first, VALUES[part], GOOD[part]))
        sketch = added(sketch, sketch_of(VALUES[part], GOOD[part]))
    return merged(nodes), sketch


def test_merged_statistics_are_those_of_all_runs():
    node, sketch = pieces(16)
    chosen = VALUES[GOOD]
    assert (node.count == len(chosen)).all()
    np.testing.assert_allclose(node.mean, chosen.mean(axis=0), rtol=1e-14)
    np.testing.assert_allclose(node.squares, ((chosen - chosen.mean(0)) ** 2).sum(0), rtol=1e-13)
    np.testing.assert_array_equal(node.low, chosen.min(axis=0))
    np.testing.assert_array_equal(node.high, chosen.max(axis=0))
    for q in (0.0, 0.05, 0.5, 0.95, 1.0):
        exact = np.quantile(chosen, q, axis=0, method="inverted_cdf")
        np.testing.assert_allclose(quantile(sketch, node, q), exact, rtol=1 / 256)


@pytest.mark.parametrize("most", [1, 2, 32, 64, 128, 4096])
def test_statistics_have_the_same_bits_however_the_runs_are_grouped(most):
    node, sketch = pieces(16)
    other, other_sketch = pieces(most)
    for name in ("count", "mean", "squares", "low", "high"):
        np.testing.assert_array_equal(getattr(other, name), getattr(node, name))
    np.testing.assert_array_equal(other_sketch.codes, sketch.codes)
    np.testing.assert_array_equal(other_sketch.counts, sketch.counts)


def test_quantiles_keep_sign_and_zero():
    values = np.array([-5.0, -1e-200, 0.0, 1e-200, 5.0])[:, None, None]
    good = np.ones(5, dtype=bool)
    node, sketch = node_of(0, values, good), sketch_of(values, good)
    found = [quantile(sketch, node, q)[0, 0] for q in (0.2, 0.4, 0.6, 0.8, 1.0)]
    np.testing.assert_allclose(found, values.ravel(), rtol=1 / 256)


@pytest.mark.parametrize("most", [1, 2, 16])
def test_a_run_that_is_missing_leaves_no_trace_in_the_grouping(most):
    def without_first(most):
        parts = [(first, VALUES[first : first + n]) for first, n in aligned(1, 100, most)]
        return merged(node_of(first, part, np.ones(len(part), bool)) for first, part in parts)

    node, other = without_first(64), without_first(most)
    np.testing.assert_array_equal(other.mean, node.mean)
    np.testing.assert_array_equal(other.squares, node.squares)
