"""`cached_per_thread`: memoize a function per thread (CasADi integrators are not thread-safe).

`digest_of` identifies what a stored result was computed from.
"""

import hashlib
from collections.abc import Callable, Iterable
from functools import lru_cache, wraps
from threading import local
from typing import ParamSpec, TypeVar, cast

P = ParamSpec("P")
T = TypeVar("T")


def cached_per_thread(most: int) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Return a decorator that caches a function's `most` latest results in each thread."""

    def decorate(function: Callable[P, T]) -> Callable[P, T]:
        of_thread = local()

        @wraps(function)
        def cached(*args: P.args, **kwargs: P.kwargs) -> T:
            try:
                call = of_thread.call
            except AttributeError:
                call = of_thread.call = lru_cache(most)(function)
            return cast(T, call(*args, **kwargs))

        return cached

    return decorate


def digest_of(parts: Iterable[bytes]) -> str:
    """Return a hash of some bytes."""
    return hashlib.sha256(b"\0".join(parts)).hexdigest()
