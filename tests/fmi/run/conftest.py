"""FMUs of small models, and runs that leave nothing behind."""

import tempfile
from pathlib import Path

import pytest
from helpers.small_models import decay

import cosim
from casadi_models.dae import Dae, Model


def blow_up() -> Dae:
    """Return x' = x^2 from x = 0.7: infinite at 1.4286 s."""
    model = Model("blow_up", description="no solution for long", source="a test", stop_time=2.0)
    x = model.state("x", "1", 0.7, "what grows")
    model.derivative(x, x**2)
    return model.freeze()


def gap() -> Dae:
    """Return x' = 0 with x(0)^2 = size, which has no solution for a negative size."""
    model = Model("gap", description="start from an equation", source="a test", stop_time=1.0)
    x = model.state("x", "1", 1.0, "root")
    size = model.parameter("size", "1", 4.0, "square of the root")
    model.derivative(x, 0)
    model.start_equation(x, x**2 - size, "closure of the gap")
    return model.freeze()


@pytest.fixture(scope="module")
def fmus(tmp_path_factory):
    """FMUs of small models by name and version."""
    folder = tmp_path_factory.mktemp("small")
    models = {"decay": decay(), "blow_up": blow_up(), "gap": gap()}
    return {
        (name, fmi): cosim.export_fmu(dae, folder / f"{name}_{fmi}.fmu", fmi=fmi)
        for name, dae in models.items()
        for fmi in (2, 3)
    }


@pytest.fixture
def no_trace(tmp_path, monkeypatch):
    """Whatever happens: no temporary folder stays, and nobody changes the current folder."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    before = Path.cwd()
    yield
    assert list(folder.iterdir()) == []
    assert Path.cwd() == before
