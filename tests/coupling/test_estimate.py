"""The error estimate of two co-simulation runs with different tolerances, in closed form."""

import numpy as np
import pytest

import cosim
from cosim.coupling.estimate import estimated_error
from cosim.errors import SolverError


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


def sampler(name, gain, start):
    model = cosim.Model(name, stop_time=3.0)
    u, q = model.input("u", "1", 0.0, "input"), model.discrete("q", "1", start, "held")
    model.every(0.1, {q: gain * u}, offset=0.1)
    model.output("y", "1", q + 0, "output")
    return model.freeze()


@pytest.mark.parametrize(("gain", "accuracy"), [(3.0, 1.0), (10.0, 1e-3)])
def test_rounding_of_what_grows_counts(gain, accuracy):
    """Two samplers in a loop: gain^30; 'at most about 1.6e-06' before, with an error of 1.4e14."""
    parts = {"a": sampler("a", gain, 1.0), "b": sampler("b", gain, 0.5)}
    system = cosim.couple(parts, {"a.u": "b.y", "b.u": "a.y"})
    if gain > 3:
        with pytest.raises(SolverError, match=r"double precision carries a\.q to 2e\+14 nominal"):
            system.simulate(accuracy=accuracy)
        return
    run = system.simulate(accuracy=accuracy)
    assert run.final["a.q"] == gain**30
    assert run.stats["error_estimate"] > np.spacing(gain**30)
