"""Fixed samples of tables: the default tests run a part, `-m slow` runs the rest."""

from collections.abc import Collection, Iterable

import pytest

# One of each system; two of them are DAEs
FORMULATIONS = (
    "crank_shaft/multipliers",
    "bar_on_frame/reduced",
    "bicycle/multipliers",
    "disk_two_bars/reduced",
    "double_pendulum/quaternion",
)


def sampled(values: Iterable[str], quick: Collection[str] = FORMULATIONS) -> list[object]:
    """Return parameters of a test, those outside the sample marked as slow."""
    return [pytest.param(v, marks=[] if v in quick else pytest.mark.slow) for v in values]
