"""Inputs of FMUs: formulas, functions, samples and files, against integrals in closed form."""

import numpy as np
import pytest

import cosim
from casadi_models.dae import Model
from cosim.cli.main import main
from cosim.errors import UnknownName, UsageError

FREQUENCY = 3.0
LAW = "2*sin(3*t)"
INTERFACES = ["ModelExchange", "CoSimulation"]


@pytest.fixture(scope="module")
def integrator(tmp_path_factory):
    model = Model("integrator", description="x' = u + w", source="a test", stop_time=1.0)
    x = model.state("x", "m", 0.0, "integral")
    u, w = model.input("u", "m/s", 0.0, "rate"), model.input("w", "m/s", 0.0, "another rate")
    model.derivative(x, u + w)
    return cosim.export_fmu(model.freeze(), tmp_path_factory.mktemp("fmu") / "integrator.fmu")


def exact(time):
    return 2 / FREQUENCY * (1 - np.cos(FREQUENCY * time))


STRAIGHT = 1.1e-4  # h^2/12 (f'(1) - f'(0)) of straight lines is 9.95e-5, and measured


@pytest.mark.parametrize("interface", INTERFACES)
@pytest.mark.parametrize(
    ("law", "exactly"),
    [
        (LAW, True),
        (lambda t: 2 * np.sin(FREQUENCY * t), True),
        (2 * np.sin(FREQUENCY * np.linspace(0, 1, 101)), False),
    ],
    ids=["formula", "function", "samples"],
)
def test_law_is_followed_as_accurately_as_the_interface_can(integrator, interface, law, exactly):
    run = cosim.simulate_fmu(
        integrator, interface=interface, inputs={"u": law}, relative_tolerance=1e-8
    )
    follows = exactly and interface == "ModelExchange"
    bound = 1e-6 if follows else STRAIGHT  # measured 2.2e-7 of fmpy's CVODE
    assert np.abs(run["x"] - exact(run.time)).max() < bound


def test_file_and_formula_drive_two_inputs_at_once(integrator, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "ramp.csv").write_text('"time","w"\n0,0\n1,1\n')
    line = ["simulate", str(integrator), "--trust", "--interface-type", "ModelExchange"]
    line += ["--input-file", "ramp.csv", "--input", f"u={LAW}", "-o", "run.csv"]
    assert main([*line, "--relative-tolerance", "1e-8"]) == 0, capsys.readouterr().err
    run = cosim.Trajectory.read_csv("run.csv")
    np.testing.assert_allclose(run["x"], exact(run.time) + run.time**2 / 2, atol=1e-6)


def test_constant_input_of_a_mapping_is_a_constant(integrator):
    run = cosim.simulate_fmu(integrator, inputs={"u": 0.5}, start={"w": 0.25})
    assert run.final["x"] == pytest.approx(0.75, abs=1e-9)


@pytest.mark.parametrize(
    ("inputs", "start", "kind", "told"),
    [
        ({"v": LAW}, {}, UnknownName, "no input 'v'"),
        ({"u": "2*phi"}, {}, UnknownName, "phi"),
        ({"u": LAW}, {"u": 1.0}, UsageError, "u is given a value and a series"),
        (3.0, {}, UsageError, "values by name"),
    ],
)
def test_nonsense_of_inputs_is_told(integrator, inputs, start, kind, told):
    with pytest.raises(kind, match=told):
        cosim.simulate_fmu(integrator, inputs=inputs, start=start)


def test_series_and_formula_of_one_input_are_refused(integrator, tmp_path, capsys):
    (tmp_path / "u.csv").write_text("time,u\n0,0\n1,1\n")
    line = ["simulate", str(integrator), "--input-file", str(tmp_path / "u.csv")]
    assert main([*line, "--input", "u=t"]) == 2
    assert "u has a formula and a column" in capsys.readouterr().err
