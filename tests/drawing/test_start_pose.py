"""Frames and signs of the diagram, against differences of the drawing itself."""

import casadi as ca
import numpy as np
import pytest

import casadi_models
import cosim
from casadi_models.dae import Model
from cosim.drawing.pose import start_pose
from cosim.model.catalogue import loaded

SMALL = 1e-6


def drawn(dae, changed=None):
    """Return place and rotation of each body at the start values, some of them changed."""
    run = cosim.simulate(dae, stop_time=0.0)
    known = {name: run[name][0] for name in run.names} | dict(dae.drawing.numbers)
    known |= {v.name: v.start for v in (*dae.parameters, *dae.inputs)} | (changed or {})
    found = {}
    for body in dae.drawing.bodies:
        both = ca.horzcat(body.place, body.rotation)
        symbols = ca.symvar(both)
        values = [known[s.name()] for s in symbols]
        found[body.name] = np.array(ca.Function("f", [ca.vertcat(*symbols)], [both])(values))
    return found, known


@pytest.mark.parametrize("name", ["bicycle", "bar_on_frame", "crank_shaft", "disk_two_bars"])
def test_a_turn_is_positive_about_its_axis_by_the_right_hand(name):
    dae = loaded(name)
    bodies, known = drawn(dae)
    turns = [sign for sign in start_pose(dae).signs if sign.turns]
    assert turns
    for sign in turns:
        for state in sign.names:
            after, _ = drawn(dae, {state: known[state] + SMALL})
            moved = [b for b in bodies if abs(after[b][:, 1:] - bodies[b][:, 1:]).max() > SMALL / 9]
            found = []
            for body in moved:
                turn = (after[body][:, 1:] @ bodies[body][:, 1:].T - np.eye(3)) / SMALL
                found.append(np.array([turn[2, 1], turn[0, 2], turn[1, 0]]))
            assert min(np.abs(axis - sign.direction).max() for axis in found) < 1e-5
            assert min(np.abs(bodies[b][:, 0] - sign.at).max() for b in moved) < 1e-12


def test_a_positive_contact_force_of_the_bicycle_points_down():
    """The book's N3 points down: a supporting force is negative."""
    signs = {s.names: s for s in start_pose(loaded("bicycle")).signs}
    np.testing.assert_array_equal(signs["fz_P",].direction, [0, 0, 1])
    np.testing.assert_array_equal(signs["fx_Q",].direction, [1, 0, 0])
    np.testing.assert_allclose(signs["fz_P",].at, 0, atol=1e-12)  # P starts at the origin
    np.testing.assert_allclose(signs["fz_Q",].at, [1.02, 0, 0], atol=1e-9)  # the wheelbase


@pytest.mark.parametrize("name", casadi_models.CATALOG)
def test_every_model_has_a_pose_and_every_sign_a_variable(name):
    dae = loaded(name)
    pose = start_pose(dae)
    names = {v.name for v in dae.variables}
    assert pose.poses.solids
    assert all(sign.names and set(sign.names) <= names for sign in pose.signs)
    assert not all(sign.turns for sign in pose.signs)  # loads too


def test_only_loads_have_a_positive_direction_beside_angles():
    model = Model("hung", stop_time=1.0)
    z = model.state("z", "m", 0.1, "place")
    k = model.parameter("k", "N/m", 2.0, "stiffness")
    push = model.input("push", "N", 0.0, "on the mass")
    model.derivative(z, -k * z + push)
    model.shape("mass", "sphere", 0.1)
    model.arrow("spring", ca.SX.zeros(3), ca.vertcat(push, 0, -k * z), "on the mass")
    assert [sign.names for sign in start_pose(model.freeze()).signs] == [("push",)]


def test_a_model_without_shapes_has_none():
    model = Model("bare", description="bare", source="a test")
    x = model.state("x", "1", 1.0, "x")
    model.derivative(x, -x)
    assert start_pose(model.freeze()) is None


def test_a_reduced_model_is_still_drawn():
    assert start_pose(cosim.reduce(loaded("bicycle"), outputs=["phi"])).poses.solids
