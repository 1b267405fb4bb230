"""The toy model, compiled once per session."""

from collections.abc import Callable, Iterator
from ctypes import CDLL
from pathlib import Path
from typing import Any

import pytest
from helpers import harness, toy


@pytest.fixture(scope="session", params=["step"])
def solver(request: pytest.FixtureRequest) -> str:
    """The solver of co-simulation, see `toy.write`; some modules take both."""
    return str(request.param)


@pytest.fixture(scope="session")
def model(solver: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the toy's model.h and model.c."""
    if harness.compiler() is None:
        pytest.skip("needs a C compiler")
    folder = tmp_path_factory.mktemp("toy")
    toy.write(folder, toy.toy(), toy.TABLE, solver)
    return folder


@pytest.fixture(scope="session")
def library(model: Path, tmp_path_factory: pytest.TempPathFactory) -> CDLL:
    """The toy as FMI 2 library."""
    return harness.library(model, 2, tmp_path_factory.mktemp("fmi2"))


@pytest.fixture(scope="session")
def library3(model: Path, tmp_path_factory: pytest.TempPathFactory) -> CDLL:
    """The toy as FMI 3 library."""
    return harness.library(model, 3, tmp_path_factory.mktemp("fmi3"))


def _factory(kind: type[harness.Fmu], library: CDLL) -> Iterator[Callable[..., harness.Fmu]]:
    names = [row.name for row in toy.TABLE]
    made: list[harness.Fmu] = []

    def make(interface: int = 0, **options: Any) -> harness.Fmu:
        made.append(kind(library, names, interface, **options))
        return made[-1]

    yield make
    for instance in made:
        instance.free()


@pytest.fixture
def fmi2(library: CDLL) -> Iterator[Callable[..., harness.Fmu]]:
    """Make FMI 2 instances of the toy: 0 for model exchange, 1 for co-simulation."""
    yield from _factory(harness.Fmu2, library)


@pytest.fixture
def fmi3(library3: CDLL) -> Iterator[Callable[..., harness.Fmu]]:
    """Make FMI 3 instances of the toy."""
    yield from _factory(harness.Fmu3, library3)


@pytest.fixture
def me(fmi2: Callable[..., harness.Fmu]) -> harness.Fmu:
    """A model exchange instance."""
    return fmi2()


@pytest.fixture
def cs(fmi2: Callable[..., harness.Fmu]) -> harness.Fmu:
    """A co-simulation instance."""
    return fmi2(1)
