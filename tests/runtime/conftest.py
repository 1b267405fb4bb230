"""The toy model, compiled once per session."""

from collections.abc import Callable, Iterator
from ctypes import CDLL
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from helpers import harness, toy


@pytest.fixture(scope="session", params=["step"])
def solver(request: pytest.FixtureRequest) -> str:
    """The solver of co-simulation, see `toy.write`; some modules take both."""
    return str(request.param)


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Any]:
    """Return the toy's folder for a solver, or with a version of FMI its library, built once.

    It takes the solver as argument, as pytest may keep a fixture of one solver for the other.
    """

    @cache
    def folder(solver: str) -> Path:
        if harness.compiler() is None:
            pytest.skip("needs a C compiler")
        made = tmp_path_factory.mktemp("toy")
        toy.write(made, toy.toy(), toy.TABLE, solver)
        return made

    @cache
    def build(solver: str, version: int | None = None) -> Any:
        if version is None:
            return folder(solver)
        return harness.library(folder(solver), version, tmp_path_factory.mktemp(f"fmi{version}"))

    return build


@pytest.fixture
def model(solver: str, built: Callable[..., Any]) -> Path:
    """Folder with the toy's generated files."""
    made: Path = built(solver)
    return made


@pytest.fixture
def library(solver: str, built: Callable[..., Any]) -> CDLL:
    """The toy as FMI 2 library."""
    return built(solver, 2)


@pytest.fixture
def library3(solver: str, built: Callable[..., Any]) -> CDLL:
    """The toy as FMI 3 library."""
    return built(solver, 3)


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
