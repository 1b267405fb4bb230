"""Shared by all tests: no screen, and no trace in the user's cache folder."""

import os
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import pytest

import cosim

os.environ["MPLBACKEND"] = "Agg"  # before any test module imports matplotlib


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what takes hours, unless it is asked for by name."""
    if "nightly" not in config.option.markexpr:
        left = [item for item in items if item.get_closest_marker("nightly")]
        config.hook.pytest_deselected(items=left)
        items[:] = [item for item in items if item not in left]


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep compiled code in a folder of this session, shared by its tests."""
    with pytest.MonkeyPatch.context() as patch:
        kept = os.environ.get("COSIM_TEST_CACHE")  # of many sessions, while one works on the tests
        patch.setenv("COSIM_CACHE", kept or str(tmp_path_factory.mktemp("cosim_cache")))
        yield


@pytest.fixture(scope="session")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Return a function that exports a model of the catalogue as an FMU, once per session."""
    folder = tmp_path_factory.mktemp("fmus")

    @cache
    def export(name: str, fmi: int = 2) -> Path:
        target = folder / f"{name.replace('/', '_')}_{fmi}.fmu"
        return cosim.export_fmu(cosim.load(name), target, fmi=fmi)

    return export
