"""An accuracy is for native simulation; an FMU has a tolerance."""

import pytest

import cosim
from cosim.api import run_scene
from cosim.cli.main import main
from cosim.errors import UsageError
from cosim.model.solver import Goal
from cosim.scene.variants import variant


def test_accuracy_of_an_fmu_run_is_rejected(exported, capsys):
    path = str(exported("crank_shaft"))
    assert main(["simulate", path, "--accuracy", "1e-6"]) == 2
    assert "--accuracy is for models" in capsys.readouterr().err
    scene = cosim.Scene("crank", cosim.requested("crank_shaft", accuracy=1e-6))
    with pytest.raises(UsageError, match="choose a relative tolerance"):
        run_scene(scene, "fmu-cs")
    for name in ("fmu-cs", "erk"):
        assert not isinstance(variant(scene.request, name)[0].solver, Goal)
