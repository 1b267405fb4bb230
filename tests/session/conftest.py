"""What the tests of sessions share: exported models, parts of systems, and an open session."""

import pytest
from helpers.exchange_only import WITHOUT_STATE, exchange_only
from helpers.foreign_part import foreign_part
from helpers.session_models import MODELS, driven_ball
from helpers.session_systems import STEP
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


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("parts")
    ball = cosim.export_fmu(driven_ball(), folder / "ball.fmu", fmi=3)
    exchange = cosim.export_fmu(driven_ball(), folder / "exchange.fmu", fmi=3)
    return {
        "ball": ball,
        "exchange": exchange_only(exchange),
        "kept": exchange_only(exchange, canSerializeFMUState="false"),
        "stateless": exchange_only(exchange, **WITHOUT_STATE),
        "lag": foreign_part(folder, "lag"),
        "keeper": foreign_part(folder, "lag", canSerializeFMUstate="false"),
        "forward": foreign_part(
            folder, "lag", canGetAndSetFMUstate="false", canSerializeFMUstate="false"
        ),
        "fixed": foreign_part(
            folder, "lag", canHandleVariableCommunicationStepSize="false", step_size=STEP
        ),
        "rounds": foreign_part(folder, "lag", grid=1e-5),
    }


@pytest.fixture
def session():
    with cosim.open(decay()) as opened:
        yield opened
