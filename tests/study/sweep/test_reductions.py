"""Numbers of runs against closed forms."""

import numpy as np
import pytest

from cosim.errors import UnknownName, UsageError
from cosim.study.sweep.reductions import Keep, Reduction, keep_from

TIME = np.linspace(0, 2 * np.pi, 2001)
WAVES = np.array([[1.0], [2.0]]) * np.sin(TIME)


def test_numbers_of_a_sine_are_those_of_the_textbook():
    def of(kind, level=None):
        return Reduction(kind, "x", level).of(TIME, WAVES)

    np.testing.assert_allclose(of("max"), [1, 2], rtol=1e-6)
    np.testing.assert_allclose(of("min"), [-1, -2], rtol=1e-6)
    np.testing.assert_allclose(of("rms"), np.array([1, 2]) / np.sqrt(2), rtol=1e-12)
    np.testing.assert_allclose(of("mean"), 0, atol=1e-14)
    np.testing.assert_allclose(of("final"), 0, atol=1e-14)
    np.testing.assert_allclose(of("first", 0.5), np.arcsin([0.5, 0.25]), rtol=1e-5)
    first = of("first", 1.5)
    assert np.isnan(first[0])  # never
    assert first[1] == pytest.approx(np.arcsin(0.75), rel=1e-5)
    np.testing.assert_array_equal(of("first", 0.0), [0, 0])


def test_words_name_the_results_to_store():
    kept = keep_from(["final", "max(b)", "first(a, 0.5)", "statistics"], ["a", "b"])
    assert [r.name for r in kept.reductions] == ["a_final", "b_final", "b_max", "a_first_0.5"]
    assert kept.statistics
    assert not kept.trajectories
    assert keep_from(kept.words(), ["a", "b"]) == kept
    assert keep_from([], ["a"]) == Keep(False, False, ())


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (["maxx"], UnknownName),
        (["max(c)"], UnknownName),
        (["first(a)"], UsageError),
        (["max(a, 1)"], UsageError),
        ("final", UsageError),
        (["a+b"], UnknownName),
    ],
)
def test_other_words_are_rejected(words, error):
    with pytest.raises(error):
        keep_from(words, ["a", "b"])
