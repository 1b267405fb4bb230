"""Tests that hold of both versions of FMI, or of both interfaces."""

import pytest

VERSIONS = pytest.mark.parametrize("fmi", [2, 3])
INTERFACES = pytest.mark.parametrize("interface", ["ModelExchange", "CoSimulation"])
