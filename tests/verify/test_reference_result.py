"""The reference result inside an FMU, and FMPy's own comparison with it."""

import csv
import io
import zipfile

import fmpy
import numpy as np
import pytest
from fmpy.util import validate_result

import casadi_models
import cosim
from cosim.verify.reference_result import (
    REFERENCE,
    _reference_run,
    export_with_proof,
    without_noise,
)

EVERY = pytest.mark.parametrize("name", casadi_models.CATALOG)


def as_fmpy_reads(names, rows) -> np.ndarray:
    return np.array([tuple(row) for row in rows], dtype=[(name, np.float64) for name in names])


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
    path = export_with_proof(cosim.load("bar_on_frame/reduced"), tmp_path / "bar.fmu", fmi=3)
    with zipfile.ZipFile(path) as archive:
        table = list(csv.reader(io.StringIO(archive.read(REFERENCE).decode())))
    reference = as_fmpy_reads(table[0], [[float(cell) for cell in row] for row in table[1:]])
    assert len(reference) >= 201
    assert validate_result(fmpy.simulate_fmu(str(path)), reference) == 0


def test_noise_alone_is_taken_out():
    values = np.array([[1e-17, 5.0, 1.0], [-2e-17, 5.0 + 1e-13, 1.0 + 1e-6]])
    assert without_noise(values, [1.0, 1.0, 1.0]).tolist() == [[0, 5, 1], [0, 5, 1 + 1e-6]]
