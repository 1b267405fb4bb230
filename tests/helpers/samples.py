"""Fixed samples of tables: the default tests run a part, `-m slow` more, `-m nightly` the rest."""

from collections.abc import Collection, Iterable
from typing import Any

import pytest

# One of each system; two of them are DAEs
FORMULATIONS = (
    "crank_shaft/multipliers",
    "bar_on_frame/reduced",
    "bicycle/multipliers",
    "disk_two_bars/reduced",
    "double_pendulum/quaternion",
)


def sampled(
    values: Iterable[Any],
    quick: Collection[Any] = FORMULATIONS,
    slow: Collection[Any] | None = None,
) -> list[object]:
    """Return parameters of a test, those outside the quick sample marked as slow.

    Args:
        values: All parameters.
        quick: Those of the default tests.
        slow: Those of the slow tests; the rest is nightly. All if None.
    """

    def mark(value: Any) -> pytest.MarkDecorator:
        return pytest.mark.slow if slow is None or value in slow else pytest.mark.nightly

    return [pytest.param(v, marks=[] if v in quick else mark(v)) for v in values]
