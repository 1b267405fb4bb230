"""Diagram and icon: in their places, the same bytes, drawn once."""

import io

import numpy as np
import pytest
from PIL import Image

from cosim.drawing.diagram import diagram, icon
from cosim.drawing.pose import start_pose
from cosim.fmi.export import documentation as module
from cosim.fmi.export.documentation import pictures
from cosim.model.catalogue import load, loaded

BAR = "bar_on_frame/reduced"


def opened(content):
    return Image.open(io.BytesIO(content)).convert("RGB")


@pytest.mark.parametrize(("fmi", "place"), [(2, "model.png"), (3, "terminalsAndIcons/icon.png")])
def test_each_version_has_its_place_for_a_square_icon(fmi, place):
    files = pictures(loaded(BAR), fmi)
    assert set(files) == {"documentation/diagram.png", place}
    assert opened(files[place]).size == (128, 128)
    assert opened(files["documentation/diagram.png"]).size == (640, 480)


def test_the_shapes_are_seen_in_their_colors():
    dae = loaded(BAR)
    pixels = np.asarray(opened(icon(start_pose(dae)))).reshape(-1, 3).astype(int)
    for color in ("#0072B2", "#56B4E9"):  # frame and bar
        wanted = [int(color[i : i + 2], 16) for i in (1, 3, 5)]
        assert (np.abs(pixels - wanted).max(axis=1) < 12).sum() > 50
    assert (pixels.min(axis=1) > 245).mean() > 0.5  # on white


def test_the_diagram_turns_with_the_model():
    dae = loaded(BAR)
    pose = start_pose(dae)
    assert diagram(pose) == diagram(start_pose(dae))
    assert diagram(pose) != diagram(start_pose(loaded("crank_shaft")))


def test_a_picture_of_a_model_is_drawn_once(monkeypatch):
    dae, drawn = load(BAR), []

    def counted(draw):
        def counting(*arguments):
            drawn.append(draw.__name__)
            return draw(*arguments)

        counting.__name__ = draw.__name__
        return counting

    for draw in (diagram, icon):
        monkeypatch.setattr(module, draw.__name__, counted(draw))
    first = pictures(dae, 2)
    assert drawn == ["diagram", "icon"]
    assert pictures(dae, 2) == first
    assert drawn == ["diagram", "icon"]
