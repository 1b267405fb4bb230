"""Pareto front: the configurations that no other one beats in both cost and error."""

from collections.abc import Callable, Iterable
from typing import TypeVar

Item = TypeVar("Item")


def pareto_front(
    items: Iterable[Item],
    cost: Callable[[Item], float | None],
    error: Callable[[Item], float | None],
    negligible_error: float = 0.0,
) -> tuple[Item, ...]:
    """Return the items that no other one beats in cost and in error, the cheapest first.

    Args:
        items: The items to compare, such as measured configurations.
        cost, error: Functions of an item; they return None if the value is not known.
        negligible_error: Smaller errors count as this error.
    """
    priced = [
        (c, max(e, negligible_error), item)
        for item in items
        if (c := cost(item)) is not None and (e := error(item)) is not None
    ]
    found: list[Item] = []
    best = float("inf")
    for _, size, item in sorted(priced, key=lambda entry: entry[:2]):
        if size < best:
            found.append(item)
            best = size
    return tuple(found)
