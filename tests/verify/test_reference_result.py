"""The reference result inside an FMU: its error, its comparison, and FMPy's own comparison."""

import csv
import io
import json
import math
import zipfile

import fmpy
import numpy as np
import pytest
from fmpy.util import validate_result
from helpers.fmu_files import rewritten
from helpers.samples import sampled
from helpers.small_models import decay

import casadi_models
import cosim
from casadi_models.dae import Model
from cosim.cli.main import main
from cosim.errors import FmuError, SolverError
from cosim.fmi.run import cvode
from cosim.fmi.run.simulate import simulate_fmu
from cosim.fmi.trust import is_made_here
from cosim.verify import reference_result
from cosim.verify.reference_result import (
    MEASURED,
    REFERENCE,
    _reference_run,
    check_file,
    export_with_reference,
    without_noise,
)

EVERY = pytest.mark.parametrize("name", sampled(casadi_models.CATALOG))


def as_fmpy_reads(names, rows) -> np.ndarray:
    return np.array([tuple(row) for row in rows], dtype=[(name, np.float64) for name in names])


@pytest.mark.slow_rows(
    "bicycle/multipliers", "double_pendulum/quaternion", "crank_shaft/multipliers"
)
@EVERY
def test_fmpys_comparison_finds_no_outlier_in_any_result(name, exported):
    """Signals that are constant or zero but for rounding have no range to be compared with."""
    dae = cosim.load(name)
    run, *_ = _reference_run(dae, dae.experiment.reference_tolerance)
    assert len(run) >= 201 or run.time[1] - run.time[0] <= dae.experiment.output_interval
    reference = as_fmpy_reads(("time", *run.names), np.column_stack([run.time, run.values]))
    for fmi in (2, 3):
        path = str(exported(name, fmi))
        for interface in ("ModelExchange", "CoSimulation"):
            result = fmpy.simulate_fmu(path, fmi_type=interface)
            assert validate_result(result, reference.copy(), run.time[-1]) == 0


def test_the_reference_in_the_file_is_of_201_rows_and_passes(tmp_path):
    path = export_with_reference(cosim.load("bar_on_frame/reduced"), tmp_path / "bar.fmu", fmi=3)
    with zipfile.ZipFile(path) as archive:
        table = list(csv.reader(io.StringIO(archive.read(REFERENCE).decode())))
    reference = as_fmpy_reads(table[0], [[float(cell) for cell in row] for row in table[1:]])
    assert len(reference) >= 201
    assert validate_result(fmpy.simulate_fmu(str(path)), reference) == 0


def test_only_rounding_noise_is_removed():
    values = np.array([[1e-17, 5.0, 1.0], [-2e-17, 5.0 + 1e-13, 1.0 + 1e-6]])
    assert without_noise(values, [1.0, 1.0, 1.0]).tolist() == [[0, 5, 1], [0, 5, 1 + 1e-6]]


def facts_of(path):
    with zipfile.ZipFile(path) as fmu:
        return json.loads(fmu.read(MEASURED)), fmu.namelist()


def test_reference_states_its_own_error(tmp_path):
    facts, names = facts_of(export_with_reference(decay("checked"), tmp_path / "a.fmu"))
    assert 0 < facts["estimated error in nominal values"] < 1e-8
    assert facts["estimated by"] == "rosenbrock at 1e-10"  # the reference is a run of erk
    assert facts["solver"] == "erk"
    assert {*facts["largest difference in nominal values"]} == {"fmu-me", "fmu-cs"}
    assert facts["failed"] == {}
    assert REFERENCE in names


@pytest.mark.slow
def test_sides_of_an_event_are_kept_where_a_comparison_takes_a_row_for_one_of_them(tmp_path):
    """Half of what `compare` takes for one instant after the second of 201 rows."""
    model = Model("step", stop_time=1.0, output_interval=0.005)
    x = model.state("x", "m", 1.0, "place")
    model.derivative(x, -1.0)
    model.when(x < 0.995 - 5e-7, {x: x + 2}, name="up")
    facts, _ = facts_of(export_with_reference(model.freeze(), tmp_path / "a.fmu"))
    (event,) = facts["events"]
    assert event["after"]["x"] - event["before"]["x"] == pytest.approx(2)


def test_error_of_a_large_model_s_reference_is_estimated_with_its_own_solver(tmp_path, monkeypatch):
    monkeypatch.setattr(reference_result, "AFFORDABLE", 0)
    facts, _ = facts_of(export_with_reference(decay("large"), tmp_path / "a.fmu"))
    assert facts["estimated by"] == "erk at 1e-09"


def test_fmu_without_a_reference_is_written_and_says_why(tmp_path, monkeypatch):
    def fails(*_, **__):
        raise SolverError("no solver comes through")

    monkeypatch.setattr(reference_result, "execute", fails)
    with pytest.warns(UserWarning, match="no reference: no solver comes through"):
        path = export_with_reference(decay("unchecked"), tmp_path / "a.fmu")
    assert simulate_fmu(path)["x"][-1] == pytest.approx(0.6065, abs=1e-4)
    facts, names = facts_of(path)
    assert facts["no reference"] == "no solver comes through"
    assert REFERENCE not in names
    with pytest.raises(FmuError, match="carries no reference result: no solver comes through"):
        next(check_file(path))


@pytest.mark.slow
def test_second_solver_computes_the_reference_if_the_first_fails(tmp_path, monkeypatch):
    original = reference_result.execute

    def execute(request):
        if request.solver.name == "erk":
            raise SolverError("too many steps")
        return original(request)

    monkeypatch.setattr(reference_result, "execute", execute)
    facts, _ = facts_of(export_with_reference(decay("second"), tmp_path / "a.fmu"))
    assert facts["solver"] == "dop853"


def test_reference_result_that_misses_its_bound_is_reported_with_a_remedy(tmp_path, monkeypatch):
    monkeypatch.setattr(reference_result, "BOUND", 1e-15)
    with pytest.warns(UserWarning, match="try a tighter reference_tolerance") as notes:
        path = export_with_reference(decay("missed"), tmp_path / "a.fmu")
    assert path.exists()
    assert {str(note.message).count("DIFFER") for note in notes} == {1}


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
    monkeypatch.setattr(cvode, "MOST_STEPS", 500)
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


def test_second_export_by_command_has_the_same_bytes_and_output(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    seen = []
    for _ in range(2):
        assert main(["export", "crank_shaft", "--reference", "none", "--json"]) == 0
        path = tmp_path / "crank_shaft.fmu"
        assert is_made_here(path)
        seen.append((path.read_bytes(), capfd.readouterr()))
        path.unlink()
    assert seen[0] == seen[1]


def test_second_export_with_a_reference_result_has_the_same_bytes(tmp_path):
    paths = [export_with_reference(decay(), tmp_path / f"{name}.fmu") for name in ("a", "b")]
    assert all(is_made_here(path) for path in paths)
    assert paths[0].read_bytes() == paths[1].read_bytes()


@pytest.fixture(scope="module")
def decaying(tmp_path_factory):
    return export_with_reference(decay("damaged"), tmp_path_factory.mktemp("fmu") / "a.fmu")


@pytest.mark.parametrize(
    ("rows", "wrong"),
    [
        (2, {}),  # one time
        (None, {"nominal": -1.0}),  # no difference would be above the bound
        (None, {"nominal": 0.0}),
        (None, {"nominal": "one"}),
        (None, {"bound": math.nan}),
        (None, {"events": [{"time": "0", "name": "e", "before": {"y": 1.0}, "after": {}}]}),
    ],
)
def test_what_cannot_be_a_reference_is_told(decaying, tmp_path, rows, wrong):
    with zipfile.ZipFile(decaying) as fmu:
        lines, facts = fmu.read(REFERENCE).splitlines(keepends=True), json.loads(fmu.read(MEASURED))
    if "nominal" in wrong:
        wrong = {"nominal": dict.fromkeys(facts["nominal"], wrong["nominal"])}
    damaged = {REFERENCE: b"".join(lines[:rows]), MEASURED: json.dumps(facts | wrong).encode()}
    path = rewritten(decaying, tmp_path / "b.fmu", damaged)
    with pytest.raises(FmuError, match="carries no reference result; export it"):
        next(check_file(path))


def test_a_small_state_is_compared_with_its_own_size_in_the_file_too(tmp_path):
    model = Model("small", stop_time=1.0)
    x = model.state("x", "m", 1e-3, "a state without a nominal value")
    model.derivative(x, -x)
    path = export_with_reference(model.freeze(), tmp_path / "a.fmu")
    written = facts_of(path)[0]["largest difference in nominal values"]
    for check in check_file(path):
        worst = check.comparison.worst
        assert worst.size == pytest.approx(1e-3)
        assert worst.scaled == pytest.approx(written[check.backend]["difference"])


@pytest.mark.slow
def test_reference_of_a_small_motion_is_no_noise(tmp_path):
    model = Model("small", stop_time=2.0, output_interval=0.1)
    x, v = model.state("x", "m", 5e-11, "place"), model.state("v", "m/s", 0.0, "speed")
    model.derivative(x, v)
    model.derivative(v, -x)
    path = export_with_reference(model.freeze(), tmp_path / "small.fmu")
    assert [check.verdict for check in check_file(path)] == ["ok", "ok"]
