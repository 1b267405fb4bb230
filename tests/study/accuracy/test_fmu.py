"""An FMU of a promised accuracy: solver and tolerance inside, checked on both roads."""

from dataclasses import replace

import pytest
from helpers.oscillators import K, oscillator
from helpers.promises import error

import cosim
from cosim.api import run_scene
from cosim.cli.arguments import named_scene
from cosim.cli.main import main
from cosim.errors import ParameterError, UsageError
from cosim.scene.scene import Settings
from cosim.scene.variants import variant
from cosim.study.accuracy.fmu import export_accurate
from cosim.study.accuracy.front import FRONT_TOLERANCES


def test_promise_is_for_integrators_not_for_an_fmu(exported, capsys):
    path = str(exported("crank_shaft"))
    assert main(["simulate", path, "--accuracy", "1e-6"]) == 2
    assert "--accuracy is for models" in capsys.readouterr().err
    scene = replace(named_scene("crank_shaft"), settings=Settings(accuracy=1e-6))
    with pytest.raises(UsageError, match="cosim export --accuracy"):
        run_scene(scene, "fmu-cs")
    for name in ("fmu-cs", "erk"):
        assert variant(scene, name)[0].settings.accuracy is None


@pytest.mark.parametrize("accuracy", [1e-4, 1e-8])
def test_exported_fmu_has_the_accuracy_by_default_on_both_interfaces(tmp_path, accuracy):
    dae = oscillator().dae
    fmu = export_accurate(dae, tmp_path / "o.fmu", accuracy)
    for interface in ("CoSimulation", "ModelExchange"):
        run = cosim.simulate_fmu(fmu.path, interface=interface)
        true = error(run, {"k": K, "x": 1.0, "v": 0.5})
        assert true <= accuracy
        # of all outputs, the largest; measured 1 to 3 times that of x
        assert fmu.errors[interface].scaled >= 0.99 * true - 1e-13
        assert fmu.errors[interface].scaled <= accuracy
    assert fmu.tolerance in FRONT_TOLERANCES


def test_looser_tolerance_would_not_have_done_for_both(tmp_path):
    dae = oscillator().dae
    fmu = export_accurate(dae, tmp_path / "o.fmu", 1e-6)
    looser = FRONT_TOLERANCES[FRONT_TOLERANCES.index(fmu.tolerance) - 1]
    run = cosim.simulate_fmu(fmu.path, interface="ModelExchange", relative_tolerance=looser)
    best = cosim.reference(dae).run
    assert cosim.compare(best, run).worst.scaled > 1e-6 / 3  # the margin


def test_accuracy_out_of_an_fmus_reach_is_refused_and_nothing_written(tmp_path):
    with pytest.raises(ParameterError, match="the FMU's own solver reaches"):
        export_accurate(oscillator().dae, tmp_path / "o.fmu", 1e-16)
    assert not list(tmp_path.iterdir())


def test_export_on_the_command_line_tells_tolerance_and_errors(tmp_path, capsys):
    target = tmp_path / "crank.fmu"
    assert main(["export", "crank_shaft", "--accuracy", "1e-6", "-o", str(target)]) == 0
    told = capsys.readouterr().err
    assert "accuracy 1e-06: tolerance " in told
    assert "CoSimulation" in told
    tolerance = told.partition("tolerance ")[2].partition(",")[0]
    from fmpy import read_model_description

    experiment = read_model_description(str(target)).defaultExperiment
    assert float(experiment.tolerance) == float(tolerance)
