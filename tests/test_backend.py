"""Backends: one word each in options, tables and Python."""

import pytest

import cosim
from cosim.api import execute
from cosim.backend import Backend
from cosim.errors import UnknownName, UsageError
from cosim.model.request import choice


def test_backends_are_four_words():
    assert list(Backend) == ["native", "native-interpreted", "fmu-me", "fmu-cs"]
    assert [backend.interface for backend in Backend] == [
        None,
        None,
        "ModelExchange",
        "CoSimulation",
    ]


@pytest.mark.parametrize("name", ["fmi", "fmu-mee", None, 3, ["native"], "casadi"])
def test_other_backends_are_rejected(name):
    with pytest.raises(UnknownName, match="backend"):
        choice(Backend, "backend", name)


def test_interpreted_backend_compiles_nothing():
    request = cosim.requested("crank_shaft/driven", stop_time=0.02)
    assert execute(request, Backend.INTERPRETED).stats["compiled"] is False
    assert execute(request).stats["compiled"]


@pytest.mark.parametrize("option", [{"accuracy": 1e-6}, {"stop_when": "phi > 1"},
                                    {"output_times": [0.0, 1.0]}])  # fmt: skip
def test_features_of_native_simulation_are_rejected_for_an_fmu(option):
    scene = cosim.Scene("crank", cosim.requested("crank_shaft"))
    with pytest.raises(UsageError, match="for native simulation"):
        cosim.run_scene(scene, "fmu-cs", **option)
