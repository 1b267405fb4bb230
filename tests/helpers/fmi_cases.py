"""Parameters for tests of both FMI versions or both interfaces."""

import pytest

VERSIONS = pytest.mark.parametrize("fmi", [2, 3])
INTERFACES = pytest.mark.parametrize("interface", ["ModelExchange", "CoSimulation"])
