"""The toy model, compiled once per session."""

from collections.abc import Callable, Iterator
from ctypes import CDLL
from pathlib import Path
from typing import Any

import harness
import pytest
import toy


@pytest.fixture(scope="session")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the toy's model.h and model.c."""
    if harness.compiler() is None:
        pytest.skip("needs a C compiler")
    folder = tmp_path_factory.mktemp("toy")
    toy.write(folder, toy.toy(), toy.TABLE)
    return folder


@pytest.fixture(scope="session")
def library(model: Path, tmp_path_factory: pytest.TempPathFactory) -> CDLL:
    """The toy as FMI 2 library."""
    return harness.library(model, 2, tmp_path_factory.mktemp("fmi2"))


@pytest.fixture
def fmi2(library: CDLL) -> Iterator[Callable[..., harness.Fmu2]]:
    """Make FMI 2 instances of the toy: 0 for model exchange, 1 for co-simulation."""
    names = [row.name for row in toy.TABLE]
    made: list[harness.Fmu2] = []

    def make(interface: int = 0, **options: Any) -> harness.Fmu2:
        made.append(harness.Fmu2(library, names, interface, **options))
        return made[-1]

    yield make
    for instance in made:
        instance.free()


@pytest.fixture
def me(fmi2: Callable[..., harness.Fmu2]) -> harness.Fmu2:
    """A model exchange instance."""
    return fmi2()


@pytest.fixture
def cs(fmi2: Callable[..., harness.Fmu2]) -> harness.Fmu2:
    """A co-simulation instance."""
    return fmi2(1)
