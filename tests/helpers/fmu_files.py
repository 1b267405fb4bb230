"""Faulty FMUs for tests: copies of a correct one with rewritten entries."""

import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from xml.etree import ElementTree as ET

from cosim.fmi.archive import DESCRIPTION

Edit = Callable[[ET.Element], object]


def rewritten(
    source: Path, target: Path, entries: Mapping[str, bytes | None], *, added: bool = False
) -> Path:
    """Copy an FMU with some entries replaced (None: left out); `added` lets a name occur twice."""
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            if name not in entries or added:
                new.writestr(name, old.read(name))
        for name, content in entries.items():
            if content is not None:
                new.writestr(name, content)
    return target


def with_description(source: Path, target: Path, edit: Edit) -> Path:
    """Copy an FMU with its model description edited."""
    with zipfile.ZipFile(source) as archive:
        root = ET.fromstring(archive.read(DESCRIPTION))
    edit(root)
    return rewritten(source, target, {DESCRIPTION: ET.tostring(root)})


def set_attributes(path: str, **attributes: str | None) -> Edit:
    """Return an edit of the first element at a path; None removes an attribute."""

    def edit(root: ET.Element) -> None:
        element = root if path == "." else root.find(path)
        assert element is not None, path
        for name, value in attributes.items():
            if value is None:
                del element.attrib[name]
            else:
                element.set(name, value)

    return edit


def remove(parent: str, child: str) -> Edit:
    """Return an edit that removes the first child of an element."""

    def edit(root: ET.Element) -> None:
        holder = root.find(parent)
        holder.remove(holder.find(child))

    return edit


def swap_children(parent: str) -> Edit:
    """Return an edit that puts the second child of an element first."""

    def edit(root: ET.Element) -> None:
        holder = root.find(parent)
        second = holder[1]
        holder.remove(second)
        holder.insert(0, second)

    return edit


def repeat_child(parent: str) -> Edit:
    """Return an edit that lists the first child of an element twice."""
    return lambda root: root.find(parent).insert(0, root.find(parent)[0])
