"""What is told which run begins."""

from collections.abc import Callable

Watch = Callable[[int], None]
