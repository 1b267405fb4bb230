"""The house as a whole: no circle of imports, few doors on a floor, a test folder for each room."""

from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest
from helpers.import_graph import FOLDERS, MODULES, ROOT, needs

TESTS = ROOT / "tests"
MOST_ON_THE_GROUND_FLOOR = 12
MOST_IN_A_ROOM = 12
# Rooms of files that are alike, one for each thing of its kind
ALIKE = {"cosim.cli.verbs": "a file for each verb"}

# What is tested where: a room and its folder under tests/, lowest first
HOMES = {
    "casadi_models.dae": "dae",
    "casadi_models.mechanics": "mechanics",
    "casadi_models.bar_on_frame": "physics",
    "casadi_models.bicycle": "physics",
    "casadi_models.crank_shaft": "physics",
    "casadi_models.disk_two_bars": "physics",
    "casadi_models.double_pendulum": "physics",
    "cosim._fmu": "runtime",
    "cosim.host": "faults",
    **{
        f"cosim.{room}": room
        for room in (
            *("text", "series", "model", "codegen", "integrate", "fmi", "scene", "verify"),
            *("study", "present", "cli"),
        )
    },
}
# Folders of tests that are no room's
CROSSING = {
    "clients": "what other programs make of our files",
    "cross": "roads against each other",
    "examples": "programs of the documentation",
    "helpers": "what tests share",
}


def rooms() -> dict[str, list[str]]:
    """Return the modules of every folder of the product, by its import name."""
    found: dict[str, list[str]] = {}
    for name in MODULES:
        room = name if is_package(name) else name.rpartition(".")[0]
        found.setdefault(room, []).extend([] if is_package(name) else [name])
    return found


def is_package(name: str) -> bool:
    return name == "cosim._fmu" or any(other.startswith(f"{name}.") for other in MODULES)


def crowded(found: dict[str, list[str]]) -> dict[str, int]:
    """Return the rooms with more files than they may have."""
    counts = {room: len(members) for room, members in found.items() if room not in ALIKE}
    return {room: n for room, n in counts.items() if n > MOST_IN_A_ROOM}


def circle(graph: dict[str, set[str]]) -> list[str]:
    """Return modules that load each other, in their order; none where there is no circle."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        found: list[str] = error.args[1]
        return found
    return []


def test_no_module_loads_one_that_loads_it():
    assert circle(needs(MODULES)) == []


@pytest.mark.parametrize(
    "source",
    ["import b", "from b import x", "def f():\n    import b", "import importlib\n"
     "importlib.import_module('b')"],
)  # fmt: skip
def test_guard_sees_a_circle(source, monkeypatch):
    assert circle(needs({"a": source, "b": "import c", "c": "import a"})) != []


def test_guard_lets_types_pass():
    a = "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import b"
    assert circle(needs({"a": a, "b": "import a"})) == []


def test_ground_floor_has_few_modules():
    floor = [path.name for path in FOLDERS["cosim"].glob("*.py")]
    assert len(floor) <= MOST_ON_THE_GROUND_FLOOR, floor


def test_rooms_are_not_crowded():
    assert crowded(rooms()) == {}


def test_guard_sees_a_crowded_room():
    members = [f"cosim.new.m{i}" for i in range(MOST_IN_A_ROOM + 1)]
    assert crowded({"cosim.new": members}) == {"cosim.new": MOST_IN_A_ROOM + 1}


def test_every_room_that_is_alike_is_needed():
    assert [room for room in ALIKE if len(rooms()[room]) <= MOST_IN_A_ROOM] == []


def test_every_room_has_its_folder_of_tests():
    top = {room for room in rooms() if room.count(".") == 1}
    assert top == set(HOMES)
    assert [folder for folder in HOMES.values() if not (TESTS / folder).is_dir()] == []


def test_every_folder_of_tests_has_its_room():
    assert folders_of(TESTS) == {*HOMES.values(), *CROSSING}


def folders_of(place: Path) -> set[str]:
    return {p.name for p in place.iterdir() if p.is_dir() and not p.name.startswith(("_", "."))}


def test_folders_within_folders_of_tests_are_rooms_within_rooms():
    inner = [f for top in HOMES.values() for f in (TESTS / top).rglob("*") if f.is_dir()]
    named = {f".{'.'.join(f.relative_to(TESTS).parts)}" for f in inner if f.name[0] not in "_."}
    assert named <= {room.removeprefix("cosim") for room in rooms()}
