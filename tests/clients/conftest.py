"""Fixtures of the tests with other importers."""

from riding import pair

__all__ = ["pair"]
