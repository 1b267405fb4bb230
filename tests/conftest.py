"""Shared by all tests: no screen, and no trace in the user's cache folder."""

import os
from collections.abc import Iterator

import pytest

os.environ["MPLBACKEND"] = "Agg"  # before any test module imports matplotlib


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep compiled code in a folder of this session, shared by its tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("COSIM_CACHE", str(tmp_path_factory.mktemp("cosim_cache")))
        yield
