"""Faulty FMUs for tests: copies of a correct one with rewritten entries."""

import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from xml.etree import ElementTree as ET

from helpers.small_models import decay

from cosim.fmi.archive import DESCRIPTION
from cosim.fmi.export.build import binaries
from cosim.fmi.export.options import FmuOptions
from cosim.fmi.export.package import source_files, zipped
from cosim.fmi.platforms import targets

Edit = Callable[[ET.Element], object]
BEFORE_A_STEP = "    const State before"


def misbehaving(target: Path, behavior: str) -> Path:
    """Write an FMU that does something else, C statements, before each step of co-simulation."""
    files = source_files(decay(), FmuOptions(identifier=target.stem))
    code = files["sources/stepping.h"].decode()
    assert code.count(BEFORE_A_STEP) == 1
    code = code.replace(BEFORE_A_STEP, f"{behavior}{BEFORE_A_STEP}")
    files["sources/stepping.h"] = f"#include <stdio.h>\n#include <stdlib.h>\n{code}".encode()
    sources = {Path(name).name: c for name, c in files.items() if name.startswith("sources/")}
    content = files | binaries(sources, target.stem, targets(["native"], 2))
    target.write_bytes(zipped(content))
    return target


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


def library(path: Path) -> tuple[str, bytes]:
    """Return name and content of the first binary of an FMU."""
    with zipfile.ZipFile(path) as archive:
        names = (name for name in archive.namelist() if name.startswith("binaries/"))
        inside = next(name for name in names if "." in name)
        return inside, archive.read(inside)


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
