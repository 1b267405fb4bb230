"""The toy model, compiled once per session."""

from collections.abc import Callable, Iterator
from pathlib import Path

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
def fmi2(model: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[..., harness.Fmu2]:
    """Make FMI 2 instances of the toy: 0 for model exchange, 1 for co-simulation."""
    library = harness.library(model, 2, tmp_path_factory.mktemp("fmi2"))
    names = [row.name for row in toy.TABLE]
    return lambda interface=0, **options: harness.Fmu2(library, names, interface, **options)


@pytest.fixture
def me(fmi2: Callable[..., harness.Fmu2]) -> Iterator[harness.Fmu2]:
    """A model exchange instance."""
    instance = fmi2()
    yield instance
    instance.lib.fmi2FreeInstance(harness.c_void_p(instance.component))


@pytest.fixture
def cs(fmi2: Callable[..., harness.Fmu2]) -> Iterator[harness.Fmu2]:
    """A co-simulation instance."""
    instance = fmi2(1)
    yield instance
    instance.lib.fmi2FreeInstance(harness.c_void_p(instance.component))
