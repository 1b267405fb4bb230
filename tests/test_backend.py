"""Backends: one word each in options, tables and Python."""

import math

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


def test_an_fmu_for_co_simulation_gets_the_solver_of_the_request():
    model = cosim.Model("decay", stop_time=1.0)
    x = model.state("x", "m", 1.0, "x")
    model.derivative(x, -x)
    request = cosim.requested(model.freeze(), solver="rk4", output_interval=0.5)
    native, inside, outside = (execute(request, Backend(n)) for n in ("native", "fmu-cs", "fmu-me"))
    two_steps = (1 - 0.5 + 0.5**2 / 2 - 0.5**3 / 6 + 0.5**4 / 24) ** 2  # exp(-1) + 3.5e-4
    assert native["x"][-1] == pytest.approx(two_steps, rel=1e-15)
    assert inside["x"][-1] == pytest.approx(two_steps, rel=1e-14)
    assert inside.stats.get("note") is None
    assert outside["x"][-1] == pytest.approx(math.exp(-1), rel=1e-6)
    assert "rk4 is for native simulation" in outside.stats["note"]
