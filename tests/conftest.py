"""Fixtures and selection of all tests; they need no screen and leave the user's cache alone."""

import gc
import os
import shlex
import shutil
import signal
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import pytest
from helpers.quick_compiler import quick_command

import cosim

os.environ["MPLBACKEND"] = "Agg"  # before any test module imports matplotlib
# before numpy is imported: threads that wait for each other cost more than small matrices
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # commands that tests run start in half the time
sys.dont_write_bytecode = False


TIME_LIMIT = 600  # s; the slowest test takes about 100 s on two busy cores
NIGHTLY_LIMIT = 5 * 3600  # s; of tests that are marked nightly, less than the night's workflow has
SLOW_SHARE = 0.2  # of the slow rows of every table; the others are nightly
GOLDEN = 0.6180339887498949  # its multiples fall in step with no period of a table
COUNTS = Counter[str]()  # of the rows of each table, as they are collected


def pytest_configure() -> None:
    """Receive signals that a shell has ignored for a command in the background (`nohup ... &`).

    What the collection of tests makes stays: to look for garbage in it takes a tenth of its time.
    """
    gc.disable()
    usual = {"SIGINT": signal.default_int_handler, "SIGHUP": signal.SIG_DFL}
    for name, handler in usual.items():
        kind = getattr(signal, name, None)
        if kind is not None and signal.getsignal(kind) is signal.SIG_IGN:
            signal.signal(kind, handler)


def is_in_sample(rows: str, share: float) -> bool:
    """Return whether the next of these rows is in a fixed sample of them; the first one is."""
    COUNTS[rows] += 1
    return (COUNTS[rows] - 1) * GOLDEN % 1 < share


def pytest_itemcollected(item: pytest.Item) -> None:
    """Mark slow and nightly rows of tables; give every test a time limit.

    A thread ends the session at the limit: signals belong to the tests, and would not end C code.
    """
    table, _, row = item.nodeid.removesuffix("]").partition("[")
    marks = {mark.name: mark.args for mark in reversed([*item.iter_markers()])}  # the closest
    is_slow = (
        "slow" in marks
        or row in marks.get("slow_rows", ())
        or ("quick_rows" in marks and row not in marks["quick_rows"])
    )
    if "quick_share" in marks and not is_in_sample(table, *marks["quick_share"]):
        is_slow = True
    if is_slow and "slow" not in marks:
        item.add_marker("slow")
    if item.config.pluginmanager.has_plugin("timeout"):
        limit = NIGHTLY_LIMIT if "nightly" in marks else TIME_LIMIT
        item.add_marker(pytest.mark.timeout(limit, method="thread"), append=False)
    if row and is_slow and not is_in_sample(f"slow {table}", SLOW_SHARE):
        item.add_marker("nightly")


@pytest.hookimpl(trylast=True)  # after -m and -k
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Deselect nightly tests unless -m names them, and samples of tests that run completely."""
    selected = {item.name for item in items}

    def is_left_out(item: pytest.Item) -> bool:
        if item.get_closest_marker("nightly"):
            return "nightly" not in config.option.markexpr
        sample = item.get_closest_marker("sample_of")
        return (
            sample is not None and item.name.replace(item.originalname, sample.args[0]) in selected
        )

    left_out = [item for item in items if is_left_out(item)]
    config.hook.pytest_deselected(items=left_out)
    items[:] = [item for item in items if item not in left_out]


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> object:
    """Give each worker of -n neighboring tests of a file, which share fixtures and caches."""
    from xdist.scheduler import WorkStealingScheduling

    return WorkStealingScheduling(config, log) if config.option.dist == "load" else None


def pytest_collection_finish() -> None:
    """Look for garbage in what comes from now on."""
    gc.freeze()
    gc.enable()


def shared_folder(factory: pytest.TempPathFactory, name: str) -> Path:
    """Return a folder of this session that all workers of -n share."""
    folder = factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent
    return folder / name


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Cache compiled code in a folder of this session, shared by its tests."""
    with pytest.MonkeyPatch.context() as patch:
        permanent = os.environ.get("COSIM_TEST_CACHE")  # shared by sessions while tests are written
        patch.setenv("COSIM_CACHE", permanent or str(shared_folder(tmp_path_factory, "cache")))
        yield


@pytest.fixture(scope="session", autouse=True)
def _quick_compiler() -> Iterator[None]:
    """Compile without optimization, which takes a fraction of the time and computes the same bits.

    $COSIM_TEST_LEVEL is another level; empty for those of the package.
    """
    level = os.environ.get("COSIM_TEST_LEVEL", "-O0")
    found = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
    with pytest.MonkeyPatch.context() as patch:
        if level and found and sys.platform != "win32" and "CC" not in os.environ:
            patch.setenv("CC", shlex.join(quick_command([found, level])))
        yield


@pytest.fixture
def optimized(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compile with the options of the package, as users do."""
    monkeypatch.delenv("CC", raising=False)


@pytest.fixture(scope="session")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Return a function that exports a model of the catalogue as an FMU, once per session."""
    folder = shared_folder(tmp_path_factory, "fmus")
    folder.mkdir(exist_ok=True)

    @cache
    def export(name: str, fmi: int = 2) -> Path:
        target = folder / f"{name.replace('/', '_')}_{fmi}.fmu"
        if not target.exists():  # export_fmu writes atomically
            cosim.export_fmu(cosim.load(name), target, fmi=fmi)
        return target

    return export
