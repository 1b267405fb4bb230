"""What shows a result and lies above it: named by the package, loaded when it is called.

`cosim/__init__` comes before every other module of the package, so that the names are there.
"""

from __future__ import annotations

from importlib import import_module

TYPE_CHECKING = False  # see `cosim/__init__`
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

_PRESENTERS: dict[str, str] = {}


def present_by(**places: str) -> None:
    """Name the functions that methods of results stand for, as `MODULE:FUNCTION`."""
    _PRESENTERS.update(places)


def presenter(method: str) -> Callable[..., Any]:
    """Return the function that a method of a result stands for."""
    module, _, function = _PRESENTERS[method].partition(":")
    from cosim.extensions import deferred_signals

    with deferred_signals():
        found: Callable[..., Any] = getattr(import_module(module), function)
    return found
