"""How large bodies and arrows are drawn, and where the camera stands."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.scenes import spinning

import cosim
from cosim.drawing.camera import View, scale_of
from cosim.drawing.picture import SIZE, Stage, canvas, draw_pose
from cosim.present.playback.playback import playback


@pytest.fixture(scope="module")
def run():
    return cosim.simulate(spinning(4.0), stop_time=1.0, compiled=False)


def poses_of(start_values, times, **options):
    dae = cosim.load("bicycle")
    runs = [cosim.simulate(dae, start_values=start, **options) for start in start_values]
    return [playback(run, run.drawing, times=times) for run in runs]


def height_in(figure, left, right):
    """Return the height of the drawn triangles between two places of a picture that is 2 high."""
    faces = np.vstack([path.vertices for path in figure.axes[0].collections[-1].get_paths()])
    inside = (faces[:, 0] > left) & (faces[:, 0] < right)
    return float(np.ptp(faces[inside, 1]))


@pytest.mark.slow
def test_path_that_goes_on_after_the_last_pose_does_not_shrink_the_bodies():
    played = poses_of([{}], [0.0, 0.5, 1.0])  # the path is 92 m long
    figure = draw_pose(played, [0, 1, 2], follow="")
    figure.canvas.draw()  # without an overflow of the texts
    assert height_in(figure, -2, 2) > 1.6  # measured 1.68


def test_short_peak_of_a_load_does_not_make_all_other_arrows_small(run):
    played = playback(run, run.drawing)
    pull = played.loads[0]
    vector = np.tile([1.0, 0.0, 0.0], (len(played.time), 1))
    vector[:2] = [[0.0, 0.0, 0.0], [0.0, 100.0, 0.0]]
    peaked = replace(pull, vector=vector)
    scale = scale_of([replace(played, loads=(peaked,))], None)
    lengths = [np.linalg.norm(np.subtract(*scale.arrow(peaked, k))) for k in range(3)]
    longest = 0.5 * scale.pose
    np.testing.assert_allclose(lengths, [0.0, longest, longest / 4], rtol=1e-12)
    rest = replace(pull, vector=0 * vector)
    assert scale_of([replace(played, loads=(rest,))], None).per_unit["N"] == 0.0
    ghost = replace(played, loads=())  # of a run that did not record the loads
    assert scale_of([replace(played, loads=(peaked,)), ghost], None).per_unit == scale.per_unit


def scaled_load(run, sizes):
    """Return a scene with one load of given sizes over time, and its scale."""
    played = playback(run, run.drawing)
    load = replace(played.loads[0], vector=np.outer(sizes(len(played.time)), [1.0, 0.0, 0.0]))
    return load, scale_of([replace(played, loads=(load,))], None)


def test_arrow_of_a_peak_takes_no_more_of_the_picture_than_others(run):
    _, steady = scaled_load(run, np.ones)
    _, peaked = scaled_load(run, lambda n: np.where(np.arange(n) == 2, 1e6, 1.0))
    assert 0.5 * steady.size < peaked.size <= steady.size  # its own length, without a bound: 344 m


def test_arrow_of_a_load_that_fades_fades(run):
    load, scale = scaled_load(run, lambda n: np.logspace(0, -8, n))
    lengths = [np.linalg.norm(np.subtract(*scale.arrow(load, k))) for k in (0, -1)]
    assert lengths[0] == pytest.approx(0.5 * scale.pose, rel=1e-12)
    assert lengths[1] < 1e-6 * scale.pose  # rounding would look like a load


def test_ghosts_move_with_the_first_run_if_the_camera_follows():
    played = poses_of([{"thetaR_dot": -12.0}, {"thetaR_dot": -16.0}], None, stop_time=4.0)
    apart = played[0].followed()[-1] - played[1].followed()[-1]
    assert np.linalg.norm(apart) > 4  # m; measured 7.6
    stage = Stage(played, View.ISO, None, SIZE)
    figure, axis = canvas(SIZE)
    stage.draw(axis, [len(played[0].time) - 1])
    assert height_in(figure, -2, 2) > 1.0


@pytest.mark.slow
def test_loads_outside_the_validity_range_neither_scale_arrows_nor_leave_the_picture():
    [valid] = poses_of([{"phi_dot": 2.5}], None, stop_time=0.4)
    [invalid] = poses_of([{"phi_dot": 2.5}], None, stop_time=1.5)
    assert invalid.invalid_from < 0.45
    expected, found = (scale_of([poses], None) for poses in (valid, invalid))
    assert found.per_unit["N"] == pytest.approx(expected.per_unit["N"], rel=0.01)
    for load in invalid.loads:
        ends = np.array([found.arrow(load, k) for k in range(len(invalid.time))])
        assert np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).max() <= 0.5001 * found.pose
