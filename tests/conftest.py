"""Shared by all tests: no screen, and no trace in the user's cache folder."""

import os
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import pytest

import cosim

os.environ["MPLBACKEND"] = "Agg"  # before any test module imports matplotlib


@pytest.hookimpl(trylast=True)  # after -m and -k
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what takes hours, unless asked for by name, and samples of what runs whole."""
    whole = {item.name for item in items}

    def is_left_out(item: pytest.Item) -> bool:
        if item.get_closest_marker("nightly"):
            return "nightly" not in config.option.markexpr
        sample = item.get_closest_marker("sample_of")
        return sample is not None and item.name.replace(item.originalname, sample.args[0]) in whole

    left_out = [item for item in items if is_left_out(item)]
    config.hook.pytest_deselected(items=left_out)
    items[:] = [item for item in items if item not in left_out]


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> object:
    """Give a worker of -n neighbours in a file, which share fixtures and memories, where it can."""
    from xdist.scheduler import WorkStealingScheduling

    return WorkStealingScheduling(config, log) if config.option.dist == "load" else None


def of_all_workers(factory: pytest.TempPathFactory, name: str) -> Path:
    """Return a folder of this session that the workers of -n share."""
    folder = factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent
    return folder / name


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep compiled code in a folder of this session, shared by its tests."""
    with pytest.MonkeyPatch.context() as patch:
        kept = os.environ.get("COSIM_TEST_CACHE")  # of many sessions, while one works on the tests
        patch.setenv("COSIM_CACHE", kept or str(of_all_workers(tmp_path_factory, "cache")))
        yield


@pytest.fixture(scope="session")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Return a function that exports a model of the catalogue as an FMU, once per session."""
    folder = of_all_workers(tmp_path_factory, "fmus")
    folder.mkdir(exist_ok=True)

    @cache
    def export(name: str, fmi: int = 2) -> Path:
        target = folder / f"{name.replace('/', '_')}_{fmi}.fmu"
        if not target.exists():  # a file is there as a whole or not at all
            cosim.export_fmu(cosim.load(name), target, fmi=fmi)
        return target

    return export
