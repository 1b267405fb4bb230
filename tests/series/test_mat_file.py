"""MATLAB files: what scipy reads back, and names that MATLAB accepts."""

import numpy as np
import pytest
from scipy.io import loadmat

from cosim.cli.main import main
from cosim.series.mat_file import matlab_names
from cosim.trajectory import Column, Trajectory

COLUMNS = (Column("phi", "rad", "deg"), Column("rig.F[1]", "N"), Column("time_", "s"))


@pytest.fixture
def run():
    return Trajectory("m", [0, 0.5, 1], COLUMNS, [[0, 1, 0], [np.pi, 2, 1], [1, np.nan, 2]])


def test_file_holds_every_variable_as_a_column_with_its_unit(run, tmp_path):
    run.to_mat(tmp_path / "a.mat")
    found = loadmat(tmp_path / "a.mat")
    np.testing.assert_array_equal(found["time"], run.time[:, None])
    np.testing.assert_array_equal(found["phi"], run["phi"][:, None])
    np.testing.assert_array_equal(found["rig_F_1_"], run["rig.F[1]"][:, None])
    plain = loadmat(tmp_path / "a.mat", simplify_cells=True)
    assert plain["units"] == {"time": "s", "phi": "rad", "rig_F_1_": "N", "time_": "s"}
    assert plain["names"]["rig_F_1_"] == "rig.F[1]"


def test_same_run_gives_the_same_bytes(run, tmp_path):
    for name in ("a.mat", "b.mat"):
        run.to_mat(tmp_path / name)
    assert (tmp_path / "a.mat").read_bytes() == (tmp_path / "b.mat").read_bytes()


def test_names_are_valid_and_distinct():
    names = ["der(x)", "der_x_", "_a", "1b", "end", "units", "\u00e4", "v" * 80, "v" * 81]
    found = matlab_names(names)
    assert found[:7] == ["der_x_", "der_x__2", "x__a", "x_1b", "x_end", "units_2", "x__"]
    assert [len(name) for name in found[7:]] == [63, 60]
    assert len({*found}) == len(names)


def test_command_writes_a_matlab_file(tmp_path, capsys):
    target = str(tmp_path / "a.mat")
    line = ["simulate", "crank_shaft", "--stop-time", "20ms", "--backend", "native-interpreted"]
    assert main([*line, "--outputs", "phi", "-o", target]) == 0
    assert loadmat(target)["phi"].shape == (3, 1)
    assert main([*line, "--units", "book", "-o", target]) == 2
    assert "a MATLAB file is in SI units" in capsys.readouterr().err
