"""The oscillator as an ODE and as a DAE."""

import pytest
from helpers.oscillators import oscillator


@pytest.fixture(params=[False, True], ids=["ode", "dae"])
def dae(request):
    return oscillator(algebraic=request.param).dae
