"""Fixtures of the tests with other importers."""

from helpers.riding import pair

__all__ = ["pair"]
