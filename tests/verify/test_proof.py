"""The proof inside an FMU: its reference states its error, and no FMU is withheld for it."""

import json
import math
import zipfile

import pytest
from helpers.small_models import decay

from casadi_models.dae import Model
from cosim.cli.main import main
from cosim.errors import FmuError, SolverError
from cosim.fmi.run import patient
from cosim.fmi.run.simulate import simulate_fmu
from cosim.verify import reference_result
from cosim.verify.reference_result import MEASURED, REFERENCE, check_file, export_with_proof


def facts_of(path):
    with zipfile.ZipFile(path) as fmu:
        return json.loads(fmu.read(MEASURED)), fmu.namelist()


def test_reference_states_its_own_error(tmp_path):
    facts, names = facts_of(export_with_proof(decay("proven"), tmp_path / "a.fmu"))
    assert 0 < facts["estimated error in nominal values"] < 1e-8
    assert facts["estimated by"] == "rosenbrock at 1e-10"  # the reference is a run of erk
    assert facts["solver"] == "erk"
    assert {*facts["largest difference in nominal values"]} == {"fmu-me", "fmu-cs"}
    assert facts["failed"] == {}
    assert REFERENCE in names


def test_error_of_a_large_model_s_reference_is_told_by_its_own_solver(tmp_path, monkeypatch):
    monkeypatch.setattr(reference_result, "AFFORDABLE", 0)
    facts, _ = facts_of(export_with_proof(decay("large"), tmp_path / "a.fmu"))
    assert facts["estimated by"] == "erk at 1e-09"


def test_fmu_without_a_reference_is_written_and_says_why(tmp_path, monkeypatch):
    def fails(*_, **__):
        raise SolverError("no solver comes through")

    monkeypatch.setattr(reference_result, "simulate", fails)
    with pytest.warns(UserWarning, match="no reference: no solver comes through"):
        path = export_with_proof(decay("unproven"), tmp_path / "a.fmu")
    assert simulate_fmu(path)["x"][-1] == pytest.approx(0.6065, abs=1e-4)
    facts, names = facts_of(path)
    assert facts["no reference"] == "no solver comes through"
    assert REFERENCE not in names
    with pytest.raises(FmuError, match="carries no reference result: no solver comes through"):
        next(check_file(path))


def test_second_solver_gives_the_reference_where_the_first_fails(tmp_path, monkeypatch):
    original = reference_result.simulate

    def simulate(dae, **options):
        if options["solver"] == "erk":
            raise SolverError("too many steps")
        return original(dae, **options)

    monkeypatch.setattr(reference_result, "simulate", simulate)
    facts, _ = facts_of(export_with_proof(decay("second"), tmp_path / "a.fmu"))
    assert facts["solver"] == "dop853"


def test_proof_that_misses_its_bound_is_told_with_what_to_try(tmp_path, monkeypatch):
    monkeypatch.setattr(reference_result, "BOUND", 1e-15)
    with pytest.warns(UserWarning, match="try a tighter reference_tolerance"):
        path = export_with_proof(decay("missed"), tmp_path / "a.fmu")
    assert path.exists()


def test_model_exchange_takes_as_many_steps_as_it_needs(tmp_path, monkeypatch):
    model = Model("fast", stop_time=2.0, output_interval=2.0)
    x = model.state("x", "m", 1.0, "place")
    v = model.state("v", "m/s", 0.0, "speed")
    model.derivative(x, v)
    model.derivative(v, -(300.0**2) * x)
    path = reference_result.export_fmu(model.freeze(), tmp_path / "fast.fmu")
    options = {"interface": "ModelExchange", "relative_tolerance": 1e-9, "stop_time": 2.0}
    run = simulate_fmu(path, output_interval=2.0, **options)
    assert run.time.tolist() == [0.0, 2.0]
    assert run["x"][-1] == pytest.approx(math.cos(600.0), abs=1e-4)
    assert "more than 500 steps between two outputs" in run.stats["note"]
    finer = simulate_fmu(path, output_interval=0.02, **options)
    assert "note" not in finer.stats
    assert run["x"][-1] == pytest.approx(finer["x"][-1], abs=1e-5)  # measured 7e-7
    monkeypatch.setattr(patient, "PATIENT_STEPS", 500)
    with pytest.raises(FmuError, match=r"mxstep.*looser relative tolerance, or co-simulation"):
        simulate_fmu(path, output_interval=2.0, **options)


def test_command_takes_a_tolerance_and_leaves_the_reference_out(tmp_path):
    path = tmp_path / "crank.fmu"
    words = ["export", "crank_shaft/driven", "-o", str(path), "-q"]
    assert main([*words, "--reference", "none", "--tolerance", "1e-6"]) == 0
    with zipfile.ZipFile(path) as fmu:
        assert b'tolerance="1e-06"' in fmu.read("modelDescription.xml")
        assert MEASURED not in fmu.namelist()
    assert main([*words, "--reference", "nonne"]) == 3
    assert main([*words, "--reference", "none", "--accuracy", "1e-6"]) == 2
