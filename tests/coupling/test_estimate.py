"""The error estimate of two co-simulation runs with different tolerances, in closed form."""

import pytest

from cosim.coupling.estimate import estimated_error


@pytest.mark.parametrize(
    ("change", "before", "ordered", "right"),
    [
        (7e-4, 0.0, True, 1e-4),  # order 4: a sixteenth of the tolerance leaves an eighth
        (7e-4, 0.0, False, 7e-4),
        (2e-3, 0.0, True, 2e-3),  # above the accuracy, no order has been observed yet
        (2e-3, 8e-3, True, 2e-3 / 3),
        (2e-3, 2e-3, True, 2e-3),
        (0.0, 0.0, True, 0.0),
    ],
)
def test_order_counts_where_it_is_observed(change, before, ordered, right):
    found = estimated_error(change, before, 1 / 16, 1e-3, 0.0, ordered=ordered)
    assert found == pytest.approx(right, rel=1e-12)


def test_agreement_of_runs_shows_nothing_below_the_tolerance_of_the_parts():
    assert estimated_error(0.0, 0.0, 1 / 16, 1e-3, 1e-7, ordered=True) == 1e-6
