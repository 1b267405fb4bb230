"""Roads: one word each in options, tables and Python, and the words they had before."""

import pytest

from cosim.errors import UnknownName
from cosim.model.catalogue import load
from cosim.scene.roads import Road, run_on_road
from cosim.scene.scene import Scene, Settings
from cosim.study.tradeoff.configuration import Configuration


def test_roads_are_four_words():
    assert list(Road) == ["native", "native-interpreted", "fmu-me", "fmu-cs"]
    assert [road.interface for road in Road] == [None, None, "ModelExchange", "CoSimulation"]


@pytest.mark.parametrize(
    ("former", "road"),
    [
        ("casadi", Road.NATIVE),
        ("compiled", Road.NATIVE),
        ("interpreted", Road.INTERPRETED),
        ("fmpy-me", Road.MODEL_EXCHANGE),
        ("fmpy-cs", Road.CO_SIMULATION),
        ("fmu", Road.CO_SIMULATION),
        *((str(road), road) for road in Road),
    ],
)
def test_former_names_of_roads_are_understood(former, road):
    assert Road.named(former) is road
    assert Configuration("m", False, former, "erk").road is road


@pytest.mark.parametrize("name", ["fmi", "fmu-mee", None, 3, ["native"]])
def test_other_roads_are_refused(name):
    with pytest.raises(UnknownName, match="road"):
        Road.named(name)


def test_interpreted_road_compiles_nothing():
    scene = Scene("crank", load("crank_shaft/driven"), settings=Settings(stop_time=0.02))
    assert run_on_road(scene, "native-interpreted").stats["compiled"] is False
