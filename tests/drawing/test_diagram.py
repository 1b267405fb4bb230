"""Texts in diagrams: none on another, none outside, one set of axes per place."""

from itertools import combinations

import casadi as ca
import numpy as np
import pytest

import casadi_models
import cosim
from cosim.drawing import diagram as drawn
from cosim.drawing.diagram import Labels
from cosim.drawing.pose import start_pose
from cosim.model.catalogue import loaded


def overlap(one, other):
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


def test_texts_of_neighbors_stand_apart_and_beside_their_points():
    labels = Labels((200, 200), gap=4)
    places = [labels.place((100 + i, 100), 30, 10) for i in range(5)]
    assert not any(overlap(*pair) for pair in combinations(places, 2))
    corner = labels.place((199, 1), 30, 10)
    assert corner[2] <= 200
    assert corner[1] >= 0


def test_text_leaves_the_line_that_its_point_lies_on():
    labels = Labels((200, 200), gap=4)
    labels.line((0, 100), (200, 100))
    _, top, _, bottom = labels.place((100, 100), 30, 10)
    assert bottom <= 100 or top >= 100


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("name", casadi_models.CATALOG)
def test_diagram_has_no_text_on_another(name, monkeypatch):
    sheets = []
    png = drawn._Sheet.png
    monkeypatch.setattr(drawn._Sheet, "png", lambda s, size: sheets.append(s) or png(s, size))
    dae = loaded(name)
    drawn.diagram(start_pose(dae))
    (sheet,) = sheets
    boxes = sheet.labels.boxes
    assert len(boxes) > 8
    assert not any(overlap(*pair) for pair in combinations(boxes, 2))
    assert all(
        b[0] >= 0 and b[1] >= 0 and (b[2:] <= sheet.size).all() for b in map(np.array, boxes)
    )


def test_variables_removed_by_reduction_have_no_arrow():
    pose = start_pose(cosim.reduce(loaded("crank_shaft"), ["T"]))
    assert [sign.names for sign in pose.signs] == [("T",)]


@pytest.mark.parametrize("length", [1e-7, 1.0, 1e7])
def test_frames_and_angles_of_bodies_of_any_size_are_told_apart(length):
    model = cosim.Model("arms", stop_time=1.0)
    size = model.parameter("length", "m", length, "of each arm")
    at = ca.SX.zeros(3, 1)
    for name in ("a", "b"):
        angle = model.state(name, "rad", 0.3, "angle")
        model.derivative(angle, 1)
        c, s = ca.cos(angle), ca.sin(angle)
        rotation = ca.vertcat(ca.horzcat(c, -s, 0), ca.horzcat(s, c, 0), ca.horzcat(0, 0, 1))
        body = model.body(f"arm {name}", at, rotation)
        model.shape("bar", "box", ca.vertcat(size, size / 10, size / 10), body=body)
        at = at + size * ca.vertcat(c, s, 0)
    pose = start_pose(model.freeze())
    assert [name for name, _, _ in drawn.distinct_frames(pose)] == ["arm a", "arm b"]
    assert [sign.names for sign in pose.signs] == [("a",), ("b",)]


def test_frames_that_coincide_are_one():
    pose = start_pose(loaded("bicycle"))
    names = [name for name, _, _ in drawn.distinct_frames(pose)]
    assert names == ["rear wheel, rear frame", "fork", "front wheel"]
