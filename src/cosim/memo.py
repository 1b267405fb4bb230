"""What depends on a model and settings alone is built once, for runs of thousands of variants."""

from collections.abc import Callable
from functools import lru_cache, wraps
from threading import local
from typing import ParamSpec, TypeVar, cast

P = ParamSpec("P")
T = TypeVar("T")


def kept_per_thread(most: int) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Keep a function's latest results, each thread its own: CasADi's integrators are not shared.

    Args:
        most: Number of results that are kept, the least recently used goes first.
    """

    def decorate(function: Callable[P, T]) -> Callable[P, T]:
        own = local()

        @wraps(function)
        def keeping(*args: P.args, **kwargs: P.kwargs) -> T:
            try:
                call = own.call
            except AttributeError:
                call = own.call = lru_cache(most)(function)
            return cast(T, call(*args, **kwargs))

        return keeping

    return decorate
