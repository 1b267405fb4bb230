"""Pictures show the run: known poses, and loads that equal outputs, in every formulation."""

import numpy as np
import pytest

import casadi_models
import cosim
from cosim.drawing.meshes import mesh_of
from cosim.model.catalogue import loaded
from cosim.present.playback.playback import playback


def shown(name, **options):
    run = cosim.simulate(loaded(name), compiled=False, **options)
    return run, playback(run, run.drawing, times=run.time)


def place(played, body, frame):
    return played.places[frame, played.bodies.index(body)]


def turn(played, body):
    return played.rotations[:, played.bodies.index(body)]


def load(played, name):
    return next(load for load in played.loads if load.name == name)


def formulations(model):
    return [name for name in casadi_models.CATALOG if name.startswith(f"{model}/")]


@pytest.mark.slow_rows("bicycle/book")
@pytest.mark.parametrize("name", formulations("bicycle"))
def test_bicycle_stands_upright_with_its_wheels_on_the_ground_and_n3_down(name):
    run, played = shown(name, stop_time=0.5)
    assert played.world.up == (0.0, 0.0, -1.0)
    np.testing.assert_allclose(turn(played, "rear frame")[0], np.eye(3), atol=1e-9)
    rear, front = (place(played, f"{which} wheel", 0) for which in ("rear", "front"))
    np.testing.assert_allclose(rear, (0, 0, -0.3), atol=1e-12)  # rR above P, where N3 is down
    np.testing.assert_allclose(front, (1.02, 0, -0.35), atol=1e-9)  # w ahead, rF above
    np.testing.assert_allclose(load(played, "force at Q").at[0], (1.02, 0, 0), atol=1e-9)
    at_P, at_Q = load(played, "force at P").at, load(played, "force at Q").at
    np.testing.assert_allclose(at_P[:, 2], 0, atol=1e-12)
    np.testing.assert_allclose(at_Q[:, 2], run["loop_closure"], atol=1e-9)  # on the ground


@pytest.mark.slow_rows("bicycle/book")
@pytest.mark.parametrize("name", formulations("bicycle"))
def test_bicycle_leans_to_the_right_for_positive_roll(name):
    run, played = shown(name, start_values={"phi": 0.3, "phi_dot": 0.0}, stop_time=0.01)
    head = next(solid for solid in played.solids if solid.name == "head of the rider")
    at = place(played, "rear frame", 0) + turn(played, "rear frame")[0] @ head.at
    height = -at[2]
    assert run["phi"][0] == 0.3
    assert at[1] == pytest.approx(height * np.tan(0.3), rel=1e-9)  # N2 is to the right
    assert at[1] > 0.4


def test_bicycle_steers_to_the_right_for_positive_steer():
    _, played = shown("bicycle", start_values={"delta": 0.3, "phi_dot": 0.0}, stop_time=0.01)
    axle = turn(played, "front wheel")[0][:, 1]  # to the right of the wheel
    heading = np.cross(axle, played.world.up)
    assert heading @ np.array([0, 1, 0]) * np.sign(heading[0]) > 0.2


@pytest.mark.parametrize("steer", [0.0, 0.3, -1.5])
def test_arms_of_the_rider_reach_the_turned_bar(steer):
    values = {"delta": steer, "phi_dot": 0.0}
    _, played = shown("bicycle/multipliers", start_values=values, stop_time=0.01)
    bar = next(solid for solid in played.solids if solid.name == "handlebar")
    middle = place(played, "fork", 0) + turn(played, "fork")[0] @ bar.at
    along = turn(played, "fork")[0] @ (bar.along / np.linalg.norm(bar.along))
    for side, right in (("left", -1), ("right", 1)):
        hand = place(played, f"fork/{side} arm", 0)
        np.testing.assert_allclose(hand, middle + 0.2 * right * along, atol=1e-12)
        shoulder = place(played, f"rear frame/{side} arm", 0)
        distance = np.linalg.norm(hand - shoulder)
        rods = [solid for solid in played.solids if solid.name == f"{side} arm of the rider"]
        ends = [
            played.places[0, rod.body] + played.rotations[0, rod.body] @ (2 * rod.at)
            for rod in rods
        ]
        for rod, begin, end in zip(rods, (shoulder, hand), ends, strict=True):
            assert rod.size[1] == pytest.approx(np.linalg.norm(end - begin))
            assert rod.size[1] < distance  # no rod reaches beyond the other's end
        assert sum(rod.size[1] for rod in rods) > distance  # and there is no gap
        np.testing.assert_allclose(
            np.cross(hand - shoulder, ends[0] - shoulder), 0, atol=1e-12
        )  # straight


def test_wheel_of_the_bicycle_rolls_on_the_ground():
    run, played = shown("bicycle", stop_time=1.0)
    steps = np.diff(load(played, "force at P").at, axis=0)
    turned = -(run["thetaR"] + run["theta"])  # forward is negative
    length = np.linalg.norm(steps, axis=1).sum()
    assert length == pytest.approx(0.3 * (turned[-1] - turned[0]), rel=1e-3)  # chords of 0.01 s
    assert steps[0] @ played.world.forward > 0


@pytest.mark.parametrize("name", formulations("crank_shaft"))
def test_arrow_at_bearing_b_is_the_output(name):
    run, played = shown(name, stop_time=1.0)
    for bearing in "AB":
        arrow = load(played, f"force at {bearing}")
        c, s = np.cos(run["phi"]), np.sin(run["phi"])
        x, y = run[f"fx_{bearing}"], run[f"fy_{bearing}"]
        world = np.column_stack([c * x - s * y, s * x + c * y, 0 * x])
        np.testing.assert_allclose(arrow.vector, world, rtol=0, atol=1e-9)
    reach = load(played, "force at B").at - load(played, "force at A").at
    np.testing.assert_allclose(reach, np.tile((0, 0, 4 * 6 * 0.0254), (len(run), 1)))


@pytest.mark.parametrize("name", formulations("double_pendulum"))
def test_tip_of_the_pendulum_is_where_the_run_says(name):
    run, played = shown(name, stop_time=2.0)
    for joint, body in (("A", "link 1"), ("tip", "link 2")):
        i = played.bodies.index(body)
        drawn = played.places[:, i] + turn(played, body) @ np.array([0, 0, -0.5])
        wanted = np.column_stack([run[f"{axis}_{joint}"] for axis in "xyz"])
        np.testing.assert_allclose(drawn, wanted, rtol=0, atol=1e-6)  # measured up to 4e-9
    path = next(path for path in played.paths if path.name == "path of the tip")
    np.testing.assert_allclose(path.points, wanted, rtol=0, atol=1e-6)
    rod = next(solid for solid in played.solids if (solid.name, solid.body) == ("rod", 2))
    assert mesh_of(rod).vertices[:, 2].min() == pytest.approx(-0.5)


@pytest.mark.parametrize("name", formulations("disk_two_bars"))
def test_bars_swing_outward_and_hang_at_first(name):
    run, played = shown(name, stop_time=1.0)
    path = played.paths[0].points
    np.testing.assert_allclose(path[0], (0, 0.1524, -(0.2 + 4) * 0.3048), atol=1e-12)
    outward = np.column_stack([-np.sin(run["phi"]), np.cos(run["phi"]), 0 * run["phi"]])
    reach = 0.1524 + 0.6096 * (np.sin(run["theta1"]) + np.sin(run["theta2"]))
    np.testing.assert_allclose((path * outward).sum(axis=1), reach, atol=1e-9)
    assert reach[-1] > reach[0]


@pytest.mark.parametrize("name", formulations("bar_on_frame"))
def test_long_axis_of_the_bar_has_the_books_direction(name):
    run, played = shown(name, stop_time=1.0)
    long_axis = turn(played, "bar")[:, :, 0]  # e1 = C n1 - S k
    c, s = np.cos(run["theta"]), np.sin(run["theta"])
    n1 = np.column_stack([np.cos(run["phi"]), np.sin(run["phi"]), 0 * run["phi"]])
    np.testing.assert_allclose(long_axis, c[:, None] * n1 - np.outer(s, (0, 0, 1)), atol=1e-9)
    pin = load(played, "pin force").vector
    np.testing.assert_allclose((pin * n1).sum(axis=1), run["f1_G_F"], atol=1e-9)


def test_shapes_follow_parameters():
    run, played = shown("double_pendulum", start_values={"length": 0.8}, stop_time=0.1)
    wanted = np.column_stack([run[f"{axis}_tip"] for axis in "xyz"])
    np.testing.assert_allclose(played.paths[1].points, wanted, atol=1e-9)
    assert {solid.size[1] for solid in played.solids if solid.name == "rod"} == {0.8}
