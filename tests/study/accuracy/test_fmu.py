"""An FMU of a requested accuracy: its solver and tolerance, checked on both interfaces."""

import pytest
from helpers.known_errors import error
from helpers.oscillators import K, oscillator

import cosim
from cosim.api import run_scene
from cosim.cli.main import main
from cosim.errors import ParameterError, UsageError
from cosim.model.solver import Goal
from cosim.scene.variants import variant
from cosim.study.accuracy.candidates import TOLERANCES
from cosim.study.accuracy.fmu import export_accurate


def test_accuracy_of_an_fmu_run_is_rejected(exported, capsys):
    path = str(exported("crank_shaft"))
    assert main(["simulate", path, "--accuracy", "1e-6"]) == 2
    assert "--accuracy is for models" in capsys.readouterr().err
    scene = cosim.Scene("crank", cosim.requested("crank_shaft", accuracy=1e-6))
    with pytest.raises(UsageError, match="cosim export --accuracy"):
        run_scene(scene, "fmu-cs")
    for name in ("fmu-cs", "erk"):
        assert not isinstance(variant(scene.request, name)[0].solver, Goal)


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
    assert fmu.tolerance in TOLERANCES


def test_looser_tolerance_is_insufficient_for_both_interfaces(tmp_path):
    dae = oscillator().dae
    fmu = export_accurate(dae, tmp_path / "o.fmu", 1e-6)
    looser = TOLERANCES[TOLERANCES.index(fmu.tolerance) - 1]
    run = cosim.simulate_fmu(fmu.path, interface="ModelExchange", relative_tolerance=looser)
    best = cosim.reference(dae).run
    assert cosim.compare(best, run).worst.scaled > 1e-6 / 3  # the margin


def test_unreachable_accuracy_of_an_fmu_is_rejected_and_nothing_written(tmp_path):
    with pytest.raises(ParameterError, match="the FMU's own solver reaches"):
        export_accurate(oscillator().dae, tmp_path / "o.fmu", 1e-16)
    assert not list(tmp_path.iterdir())


def test_export_on_the_command_line_reports_tolerance_and_errors(tmp_path, capsys):
    target = tmp_path / "crank.fmu"
    assert main(["export", "crank_shaft", "--accuracy", "1e-6", "-o", str(target)]) == 0
    printed = capsys.readouterr().err
    assert "accuracy 1e-06: tolerance " in printed
    assert "CoSimulation" in printed
    tolerance = printed.partition("tolerance ")[2].partition(",")[0]
    from fmpy import read_model_description

    experiment = read_model_description(str(target)).defaultExperiment
    assert float(experiment.tolerance) == float(tolerance)
