"""Every shipped scene on every backend, and the commands that take one."""

import csv
import io
import json
from dataclasses import replace

import numpy as np
import pytest

import cosim
from cosim.backend import FMU_BACKENDS
from cosim.cli.main import main
from cosim.fmi.run.exported import run_file
from cosim.model.solver import Tolerance
from cosim.scene import shipped_scenes
from cosim.verify.crosscheck import crosscheck

NAMES = [path.name for path in shipped_scenes()]
BOOK = [
    "bar_on_frame.toml",
    "bar_on_frame_two_body.toml",
    "bicycle_model_1.toml",
    "bicycle_model_2.toml",
    "bicycle_model_3.toml",
    "crank_shaft.toml",
    "disk_two_bars.toml",
    "double_pendulum_7_2.toml",
    "double_pendulum_7_3.toml",
    "double_pendulum_7_4.toml",
]


# Compiling the bicycle's FMUs takes seconds each
BACKENDS = [
    pytest.param(name, marks=pytest.mark.slow)
    if name.startswith("bicycle") and name != "bicycle_roll_steer.toml"
    else name
    for name in NAMES
]


def shortened(scene, stop_time=0.5, **settings):
    return replace(scene, request=cosim.requested(scene.request, stop_time=stop_time, **settings))


def accurate(scene, stop_time):
    """Return a scene with the default solver at a tight tolerance."""
    times = cosim.Times(0.0, stop_time, scene.request.times.interval)
    return replace(scene, request=replace(scene.request, times=times, solver=Tolerance(1e-10)))


def test_every_example_and_exercise_of_the_book_is_shipped():
    assert set(BOOK) <= set(NAMES)


@pytest.mark.slow
def test_at_least_twelve_scenes_want_some_outputs_only():
    assert sum(bool(cosim.read_scene(name).request.outputs) for name in NAMES) >= 12


@pytest.mark.quick_rows(
    "bar_theta.toml",
    "crank_bearing_a.toml",
    "crank_shaft.toml",
    "crank_torque.toml",
    "pendulum_tip.toml",
)
@pytest.mark.parametrize("name", NAMES)
def test_scene_runs_and_draws_its_figures(name):
    scene = shortened(cosim.read_scene(name))
    run = cosim.run_scene(scene)
    assert run.complete
    assert run.time[-1] == 0.5
    assert scene.title
    assert cosim.draw_figures(scene.figures, run)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_scene_runs_over_its_full_span(name):
    scene = cosim.read_scene(name)
    run = cosim.run_scene(scene)
    assert run.complete
    assert run.time[-1] == scene.request.times.stop


@pytest.mark.slow_rows("disk_two_bars.toml")
@pytest.mark.quick_rows(
    "bicycle_front_contact.toml",
    "bicycle_model_1.toml",
    "bicycle_model_2.toml",
    "bicycle_model_3.toml",
    "bicycle_path.toml",
    "bicycle_steer_kick.toml",
    "bicycle_wheel_loads.toml",
    "crank_shaft.toml",
    "disk_two_bars.toml",
)
@pytest.mark.parametrize("name", BACKENDS)
def test_scene_gives_the_same_on_both_backends(name, tmp_path):
    scene = accurate(cosim.read_scene(name), 1.5)
    run, request = cosim.run_scene(scene), scene.request.reduced()
    path = cosim.export_fmu(request.configured(), tmp_path / "scene.fmu")  # for both interfaces
    for backend in FMU_BACKENDS:
        # measured 7.2e-8 of the nominal value at most, through fmpy's CVODE
        assert cosim.compare(run, run_file(request, path, backend.interface), bound=5e-7).agrees


@pytest.mark.quick_rows(
    "bar_bearings.toml", "crank_torque.toml", "disk_angles.toml", "pendulum_tip.toml"
)
@pytest.mark.parametrize("name", [name for name in NAMES if name not in BOOK])
def test_reduced_scene_gives_what_the_full_model_gives(name):
    scene = accurate(cosim.read_scene(name), 1.0)
    full = replace(scene, request=replace(scene.request, outputs=None))
    small = scene.request.reduced().dae
    assert small.operations(with_outputs=True) < scene.dae.operations(with_outputs=True)
    run, whole = cosim.run_scene(scene), cosim.run_scene(full)
    assert set(run.names) == set(scene.request.outputs)
    assert cosim.compare(run, whole, bound=1e-7).agrees  # measured 1.4e-8 at rtol 1e-10


def test_book_model_2_of_the_bicycle_is_model_1_up_to_its_solver():
    first, second = (cosim.read_scene(f"bicycle_model_{i}.toml") for i in (1, 2))
    run = cosim.run_scene(first, output_interval=0.025)
    again = cosim.run_scene(second)
    assert cosim.compare(run, again, bound=1e-4).agrees  # measured 1.9e-5, of erk at rtol 1e-5


@pytest.mark.slow
def test_book_model_3_of_the_bicycle_is_model_2_but_for_the_path():
    second, third = (cosim.run_scene(cosim.read_scene(f"bicycle_model_{i}.toml")) for i in (2, 3))
    # the same method and steps for the same motion: rounding only, measured 1.3e-11
    assert cosim.compare(second, third, bound=1e-9, without=("xP", "yP")).agrees
    path = max(np.abs(second[name] - third[name]).max() for name in ("xP", "yP"))
    assert 1e-4 < path < 5e-4  # the book's path misses the true one by up to 4e-4 m


@pytest.mark.slow
def test_exercises_7_3_and_7_4_are_7_2_by_other_steps_and_other_equations():
    second, third, fourth = (
        cosim.run_scene(cosim.read_scene(f"double_pendulum_7_{i}.toml")) for i in (2, 3, 4)
    )
    assert cosim.compare(second, fourth, bound=5e-6).agrees  # measured 3.5e-7 at rtol 1e-8
    assert cosim.compare(second, third, bound=5e-6).agrees  # measured 2.3e-7


@pytest.mark.nightly
def test_kick_moves_the_bicycle_alike_in_every_formulation():
    checks = list(crosscheck([accurate(cosim.read_scene("bicycle_steer_kick.toml"), 2.0)]))
    assert {check.model for check in checks} == {
        "bicycle/independent",
        "bicycle/book",
        "bicycle/multipliers",
    }
    for check in checks:
        assert check.comparison.agrees  # measured 1.7e-9 at rtol 1e-10


@pytest.mark.slow
def test_crosscheck_of_a_scene_skips_formulations_that_lack_an_output():
    scene = shortened(cosim.read_scene("double_pendulum_7_2.toml"), 0.2)
    request = replace(scene.request, outputs=("singularity_1",))
    only = cosim.Scene("only", request)
    models = {check.model for check in crosscheck([only])}
    assert models == {"double_pendulum/euler_313", "double_pendulum/euler_313_axial"}


# -- command line ---------------------------------------------------------------------------------


def test_list_shows_models_first_and_then_scenes(capsys):
    assert main(["list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("model")
    assert [line.split()[0] for line in lines if ".toml" in line] == NAMES
    assert main(["list", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert [scene["scene"] for scene in facts["scenes"]] == NAMES


def test_simulate_takes_a_scene_and_options_override_it(capsys):
    options = ["--stop-time", "0.2", "--output-interval", "0.1", "-p", "theta=10deg"]
    assert main(["simulate", "bar_theta.toml", *options]) == 0
    rows = list(csv.reader(io.StringIO(capsys.readouterr().out)))
    assert rows[0] == ["time", "theta"]
    assert [float(row[0]) for row in rows[1:]] == [0, 0.1, 0.2]
    assert float(rows[1][1]) == pytest.approx(np.radians(10), abs=1e-15)


def test_outputs_of_simulate_reduce_a_plain_model(capsys):
    options = ["--outputs", "theta", "--stop-time", "0.1", "-v"]
    assert main(["simulate", "bar_on_frame", *options]) == 0
    assert "states: 4 -> 3; phi" in capsys.readouterr().err


@pytest.mark.slow
def test_constant_on_the_command_line_replaces_a_series(capsys):
    options = ["--stop-time", "2", "-p", "steer_torque=0"]
    assert main(["simulate", "bicycle_steer_kick.toml", *options]) == 0
    rows = list(csv.reader(io.StringIO(capsys.readouterr().out)))
    assert abs(float(rows[-1][1])) < 1e-12  # nothing kicks: no roll


@pytest.mark.slow
def test_export_takes_a_scene(tmp_path, capsys):
    target = tmp_path / "lean.fmu"
    assert main(["export", "bicycle_roll_steer.toml", "-o", str(target)]) == 0
    again = cosim.simulate_fmu(target, stop_time=0.5, output_interval=0.01)
    run = cosim.run_scene(shortened(cosim.read_scene("bicycle_roll_steer.toml")))
    assert again.model == "bicycle_roll_steer"
    assert cosim.compare(run, again, bound=1e-5).agrees


@pytest.mark.slow
def test_export_says_which_series_the_importer_has_to_supply(tmp_path, capsys):
    target = tmp_path / "kick.fmu"
    assert main(["export", "bicycle_steer_kick.toml", "-o", str(target)]) == 0
    assert "steer_torque: inputs of the FMU" in capsys.readouterr().err


@pytest.mark.slow
def test_crosscheck_takes_a_scene(capsys):
    assert main(["crosscheck", "crank_torque.toml", "--stop-time", "0.2", "-q", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert {row["worst"] for row in rows} == {"T"}


def test_output_that_another_formulation_has_is_exit_code_3(capsys):
    assert main(["simulate", "bar_on_frame", "--outputs", "frame_v1"]) == 3
    assert "bar_on_frame/two_body does" in capsys.readouterr().err


def test_unknown_scene_is_exit_code_3(capsys):
    assert main(["simulate", "bicycle_model_9.toml"]) == 3
    assert "did you mean bicycle_model_" in capsys.readouterr().err
