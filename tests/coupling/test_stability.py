"""Given macro steps at which a method is unstable, and growth that is not the method's."""

import numpy as np
import pytest
from helpers.foreign_part import foreign_part
from helpers.samples import sampled

import cosim
from cosim.cli.main import main
from cosim.coupling.co_simulation import CoSimulation
from cosim.coupling.files import read_system
from cosim.errors import SolverError

STEPS = 100
METHODS = sampled(["gauss_seidel", "extrapolated"], quick=["jacobi", "iterated"])


def body(mass=1.0, stiffness=0.0):
    """A body under a force that begins with 1 m/s."""
    model = cosim.Model("body", stop_time=1.0)
    force = model.input("F", "N", 0.0, "force")
    v, x = model.state("v", "m/s", 1.0, "speed"), model.state("x", "m", 0.0, "place")
    model.derivative(x, v)
    model.derivative(v, (force - stiffness * x) / mass)
    return model.freeze()


def link(damping, stiffness=0.0):
    """A spring and a damper between a body and the ground."""
    model = cosim.Model("link", stop_time=1.0)
    v, x = model.input("v", "m/s", 0.0, "speed"), model.input("x", "m", 0.0, "place")
    model.output("F", "N", -damping * v - stiffness * x, "force")
    return model.freeze()


def held(damping, stiffness=0.0, abilities=None):
    """A body that its link holds."""
    wires = {"body.F": "link.F", "link.v": "body.v", "link.x": "body.x"}
    parts = {"body": body(), "link": link(damping, stiffness)}
    return cosim.couple(parts, wires, abilities=abilities or {})


def alone(name, start, rate, **inputs):
    """A part with one state, whose rate of change is a function of it and of its inputs."""
    model = cosim.Model(name, stop_time=1.0)
    x = model.state("x", "1", start, "state")
    model.derivative(x, rate(x, *(model.input(n, "1", v, "input") for n, v in inputs.items())))
    return model.freeze()


def driven(rate, start=1.0):
    """A part that an amplifier of its own state drives: x' = rate(x, u), u = x."""
    model = cosim.Model("amplifier", stop_time=1.0)
    model.output("y", "1", 1.0 * model.input("u", "1", 0.0, "input"), "output")
    parts = {"plant": alone("plant", start, rate, u=0.0), "amplifier": model.freeze()}
    return cosim.couple(parts, {"plant.u": "amplifier.y", "amplifier.u": "plant.x"})


@pytest.fixture
def runs(monkeypatch):
    """The macro steps of the runs that are made."""
    made, once = [], CoSimulation._once

    def counted(self, task, *settings):
        made.append(task.settings.macro_step)
        return once(self, task, *settings)

    monkeypatch.setattr(CoSimulation, "_once", counted)
    return made


@pytest.mark.parametrize("ratio", [0.5, 1.9, 1.99])
def test_below_its_limit_jacobi_gives_what_its_theory_says(ratio, runs):
    """The force is constant in a step: v_n = (1 - d h / m)^n, which is stable below h = 2 m / d."""
    run = held(20.0).simulate(method="jacobi", macro_step=ratio / 20.0, stop_time=ratio * 5)
    steps = np.round(run.time / (ratio / 20.0))
    at_points = np.isclose(steps * ratio / 20.0, run.time, atol=1e-9)
    expected = (1 - ratio) ** steps[at_points]
    assert np.abs(run["body.v"][at_points] - expected).max() < 1e-6
    assert run.complete
    assert len(runs) == 1 or ratio > 1  # nothing to check


# 4 + sqrt(8): as unstable with half the step, so that both runs have the same size
@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("ratio", [2.1, 3.0, 4 + 8**0.5, 20.0, 1000.0])
def test_above_its_limit_jacobi_ends_with_an_error(ratio):
    step = ratio / 20.0
    with pytest.raises(SolverError) as caught:
        held(20.0).simulate(
            method="jacobi", macro_step=step, stop_time=STEPS * step, output_interval=step
        )
    message = str(caught.value)
    assert "is too long for jacobi" in message or "failed" in message
    assert "accuracy" in message
    assert not caught.value.partial.complete


def test_the_error_names_signal_step_and_remedy():
    with pytest.raises(SolverError) as caught:
        held(30.0).simulate(method="jacobi", macro_step=0.1, stop_time=5.0)
    assert str(caught.value) == (
        "system: the macro step 0.1 s is too long for jacobi: the input body.F moves by "
        "5.1e+16, and with 0.05 s by 45; give at most 0.05 s, or accuracy with the method iterated"
    )
    partial = caught.value.partial
    assert partial.time[-1] == 5.0
    assert np.abs(partial["body.v"]).max() > 1e14


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize(
    ("method", "damping", "stiffness", "step", "abilities"),
    [
        ("gauss_seidel", 1e4, 0.0, 0.1, ""),
        ("extrapolated", 1e4, 0.0, 0.1, "no rollback"),
        ("iterated", 1e4, 0.0, 0.1, "no rollback"),
        ("jacobi", 0.0, 1e6, 1e-3, ""),  # |1 + i w h|, at every step
        ("extrapolated", 0.0, 1e6, 1e-2, ""),
        ("iterated", 0.0, 1e6, 1e-2, ""),
    ],
)
def test_no_method_ends_complete_with_what_its_instability_made(
    method, damping, stiffness, step, abilities
):
    """Complete with 1e59 and a note before."""
    system = held(damping, stiffness, {n: abilities for n in ("body", "link") if abilities})
    with pytest.raises(SolverError, match=f"is too long for {method}"):
        system.simulate(method=method, macro_step=step, stop_time=1.0)


@pytest.mark.slow_rows("0.05")
@pytest.mark.parametrize("step", [0.05, 0.005])
def test_an_instability_that_turns_of_a_hinge_saturate_is_found(step):
    """Forces of about 1e5 N with every step, instead of 40 N; 1e5 of their sizes before."""
    system = read_system("examples/coupled/cut_pendulum.toml")
    method = "jacobi" if step == 0.05 else "gauss_seidel"
    with pytest.raises(SolverError, match=f"is too long for {method}"):
        system.simulate(method=method, macro_step=step, output_interval=0.05)


def test_the_command_line_ends_with_the_code_of_failed_runs(capsys):
    call = "simulate examples/coupled/cut_pendulum.toml --method jacobi --macro-step 20ms"
    assert main(call.split()) == SolverError.exit_code == 1
    assert "the macro step 0.02 s is too long for jacobi" in capsys.readouterr().err


GROWING = {
    "inverted pendulum": (lambda x, u: 4 * u, lambda t: np.exp(4 * t)),
    "ramp": (lambda x, u: 5.0 + 0 * u, lambda t: 1 + 5 * t),
    "charge": (lambda x, u: 10 - u, lambda t: 10 - 9 * np.exp(-t)),
    "ignition": (lambda x, u: 3 * u * (1 - x / 1e3), lambda t: 1e3 / (1 + 999 * np.exp(-3 * t))),
}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", GROWING)
def test_growth_of_the_parts_is_none_of_the_method(name, method, runs):
    rate, exact = GROWING[name]
    run = driven(rate).simulate(method=method, macro_step=0.005, stop_time=4.0)
    assert run.complete
    first_order = method in ("jacobi", "gauss_seidel")
    error = np.abs(run["plant.x"] - exact(run.time)).max() / run["plant.x"].max()
    assert error < (0.2 if first_order else 1e-6)
    assert len(runs) <= 3
    if name in ("ramp", "charge"):
        assert len(runs) == 1


@pytest.mark.slow_rows("jacobi-0.01")
@pytest.mark.parametrize("step", [0.01, 0.02])
@pytest.mark.parametrize("method", ["jacobi", "gauss_seidel"])
def test_a_source_that_begins_shortly_before_the_end_is_no_instability(method, step):
    """The lag feels it a macro step late or early, of the few that are left: 57.6 at the end."""
    source = cosim.Model("source", stop_time=1.0)
    z, y = source.state("z", "1", 0.0, "state"), source.input("y", "1", 0.0, "input")
    source.derivative(z, 1e4 * (source.t > 0.95) + 0 * y)
    parts = {"source": source.freeze(), "lag": alone("lag", 0.0, lambda x, z: 5 * (z - x), z=0.0)}
    system = cosim.couple(parts, {"source.y": "lag.x", "lag.z": "source.z"})
    run = system.simulate(method=method, macro_step=step, stop_time=1.0)
    assert run.complete
    late = 500.0 * 5 * step  # at most, of the largest value of z
    assert abs(run["lag.x"][-1] - 57.6) < late


def test_the_check_changes_no_number_and_no_time(monkeypatch):
    settings = {"method": "jacobi", "macro_step": 0.005, "stop_time": 4.0}
    system = driven(GROWING["inverted pendulum"][0])
    checked = system.simulate(**settings)
    monkeypatch.setattr("cosim.coupling.co_simulation.reject_instability", lambda *given: None)
    plain = system.simulate(**settings)
    assert (checked.values == plain.values).all()
    assert checked.stats.keys() == plain.stats.keys()


@pytest.mark.parametrize(("gain", "fails"), [(3.0, False), (-90.0, False), (-150.0, True)])
def test_a_part_with_steps_of_one_length_is_run_with_twice_its_step(tmp_path, gain, fails):
    """x' = gain x + 1 - x: x grows by the factor e^-h + gain (1 - e^-h) in a step of jacobi."""
    fault = "if (fabs(size - 0.02) > 1e-9) return 3;"
    facts = {"step_size": 0.02, "canHandleVariableCommunicationStepSize": "false", "fault": fault}
    model = cosim.Model("amplifier", stop_time=1.0)
    model.output("y", "1", gain * model.input("u", "1", 0.0, "input") + 1, "output")
    parts = {"lag": str(foreign_part(tmp_path, "lag", **facts)), "amplifier": model.freeze()}
    system = cosim.couple(parts, {"lag.u": "amplifier.y", "amplifier.u": "lag.y"})
    settings = {"method": "jacobi", "macro_step": 0.02, "stop_time": 4.0, "output_interval": 0.02}
    if fails:
        with pytest.raises(SolverError, match=r"and with 0\.04 s .*; .* if the parts allow it"):
            system.simulate(**settings)
    else:
        factor = np.exp(-0.02) + gain * (1 - np.exp(-0.02))
        expected = (1 - factor ** np.arange(201)) / (1 - gain)
        assert system.simulate(**settings)["lag.y"] == pytest.approx(expected, rel=1e-4)
