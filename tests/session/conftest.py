"""What the tests of sessions share: exported models, and an open session."""

import pytest
from helpers.session_models import MODELS
from helpers.small_models import decay

import cosim


@pytest.fixture(scope="module")
def fmus(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sessions")
    return {
        (name, fmi): cosim.export_fmu(build(), folder / f"{name}_{fmi}.fmu", fmi=fmi)
        for name, build in MODELS.items()
        for fmi in (2, 3)
    }


@pytest.fixture
def session():
    with cosim.open(decay()) as opened:
        yield opened
