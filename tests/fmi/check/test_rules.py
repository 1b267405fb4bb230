"""Every rule is seen to fire on a copy of a sound file with that fault, and not on the file."""

import re
import struct
import zipfile
from xml.etree import ElementTree as ET

import pytest
from helpers.fmu_files import (
    library,
    remove,
    repeat_child,
    rewritten,
    set_attributes,
    with_description,
)

from cosim.fmi.archive import DESCRIPTION
from cosim.fmi.check.check import examine
from cosim.fmi.check.finding import OWN, RULES

NAME = "bar_on_frame/reduced"
VARIABLE = "ModelVariables/ScalarVariable[@name='{}']"
REAL = f"{VARIABLE}/Real"
EVERY = {key.replace("-", "_").upper(): rule for key, rule in RULES.items()}


def without_interfaces(root: ET.Element) -> None:
    for tag in ("ModelExchange", "CoSimulation"):
        root.remove(root.find(tag))


def twice_named(root: ET.Element) -> None:
    root.find(VARIABLE.format("b")).set("name", "m")


def discrete(root: ET.Element) -> None:
    variable = root.find(VARIABLE.format("energy"))
    variable.remove(variable.find("Real"))
    ET.SubElement(variable, "Integer")
    variable.set("variability", "continuous")


DESCRIBED = {
    "SCHEMA": set_attributes(VARIABLE.format("m"), causality="parametre"),
    "VERSION": set_attributes(".", fmiVersion="1.0"),
    "TOKEN": set_attributes(".", guid=""),
    "INTERFACE": without_interfaces,
    "IDENTIFIER": set_attributes("CoSimulation", modelIdentifier="../bar"),
    "EXPERIMENT": set_attributes("DefaultExperiment", stopTime="0"),
    "UNIT": remove("UnitDefinitions", "Unit[@name='kg']"),
    "UNIT_BASE": set_attributes("UnitDefinitions/Unit[@name='rad/s']/BaseUnit", factor="57"),
    "UNIT_OF_RATE": set_attributes(REAL.format("der(theta)"), unit="rad"),
    "NAME": twice_named,
    "CAUSALITY": set_attributes(VARIABLE.format("m"), variability="continuous"),
    "VARIABILITY": discrete,
    "START": set_attributes(REAL.format("theta"), start=None),
    "NUMBER": set_attributes(REAL.format("theta"), start="NaN"),
    "BOUNDS": set_attributes(REAL.format("m"), min="5"),
    "NOMINAL": set_attributes(REAL.format("m"), nominal="0"),
    "DERIVATIVE": set_attributes(REAL.format("der(theta)"), derivative="999"),
    "LISTED": repeat_child("ModelStructure/Outputs"),
    "LISTED_LIGHTLY": remove("ModelStructure/InitialUnknowns", "Unknown"),
    "REFERS": set_attributes("ModelStructure/Outputs/Unknown", dependencies="4711"),
    "SOURCES": set_attributes("CoSimulation/SourceFiles/File", name="gone.c"),
    "TOKEN_ELSEWHERE": set_attributes(".", guid="{another}"),
    "EXECUTION_TOOL": set_attributes("CoSimulation", needsExecutionTool="true"),
}


def load_command(kind: int, body: bytes) -> bytes:
    return struct.pack("<2I", kind, 8 + len(body)) + body


def named(kind: int, name: bytes, before: int = 0) -> bytes:
    """Return a load command with a name that stands after `before` more bytes."""
    return load_command(kind, struct.pack("<I", 12 + before) + bytes(before) + name + b"\0")


def mach(*commands: bytes) -> bytes:
    header = struct.pack(
        "<8I", 0xFEEDFACF, 0x01000007, 3, 6, len(commands), sum(map(len, commands)), 0, 0
    )
    return header + b"".join(commands)


NEW_MACOS = mach(load_command(0x32, struct.pack("<4I", 1, 14 << 16 | 5 << 8, 14 << 16, 0)))
FOREIGN = mach(
    named(0x0C, b"/opt/local/lib/libq.dylib", 12), named(0x0C, b"/usr/lib/libc.dylib", 12)
)
LED_ASTRAY = mach(named(0x8000001C, b"/Users/me/lib"), named(0x8000001C, b"@loader_path"))
IN_DARWIN = "binaries/darwin64/bar_on_frame_reduced.dylib"


def faulty(rule: str, exported, folder):
    """Return a file that breaks one rule."""
    source, target = exported(NAME), folder / "faulty.fmu"
    if rule in DESCRIBED:
        return with_description(source, target, DESCRIBED[rule])
    inside, content = library(source)
    if rule == "SHARED_REFERENCE":
        second = set_attributes("ModelVariables/Float64[2]", valueReference="2")
        return with_description(exported(NAME, 3), target, second)
    if rule == "ENTRY_NAME":
        return rewritten(source, target, {"resources/größe.txt": b""})
    if rule == "COMPRESSION":
        rewritten(source, target, {})
        with zipfile.ZipFile(target, "a") as archive:
            archive.writestr("resources/a", b"text" * 99, compress_type=zipfile.ZIP_BZIP2)
        return target
    if rule == "ARCHIVE":
        rewritten(source, target, {"resources/note.txt": b"exactly this text"})
        target.write_bytes(target.read_bytes().replace(b"exactly this", b"exactly that"))
        return target
    if rule == "NOTHING_TO_RUN":
        with zipfile.ZipFile(source) as archive:
            gone = [n for n in archive.namelist() if n.startswith(("binaries/", "sources/"))]
        return rewritten(source, target, dict.fromkeys(gone))
    newest = max(re.findall(rb"GLIBC_2\.\d\d\0", content))
    changes = {
        "XML": {"terminalsAndIcons/terminalsAndIcons.xml": b"<fmiTerminals"},
        "BINARY": {inside: None, f"{inside}.old": content},
        "FUNCTIONS": {inside: content.replace(b"fmi2DoStep\0", b"fmi2NoStep\0")},
        "PLATFORM": {inside: None, IN_DARWIN: content},
        "FOLDER": {inside.replace("linux64", "x86_64-linux"): content},
        "IMPORTS": {IN_DARWIN: FOREIGN},
        "UNDEFINED": {inside: undefined(content)},
        "GLIBC": {inside: content.replace(newest, b"GLIBC_2.99\0")},
        "MACOS": {IN_DARWIN: NEW_MACOS},
        "RUN_PATH": {IN_DARWIN: LED_ASTRAY},
    }
    return rewritten(source, target, changes[rule])


def undefined(content: bytes) -> bytes:
    """Take the version from every symbol of an ELF library."""
    (headers,) = struct.unpack_from("<Q", content, 0x28)
    size, count = struct.unpack_from("<HH", content, 0x3A)
    changed = bytearray(content)
    for i in range(count):
        section = struct.unpack_from("<IIQQQQIIQQ", content, headers + size * i)
        if section[1] == 0x6FFFFFFF:
            changed[section[4] : section[4] + section[5]] = b"\1\0" * (section[5] // 2)
    return bytes(changed)


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("rule", [name for name, r in EVERY.items() if r.level != OWN])
def test_rule_fires_on_its_fault_and_not_without_it(rule, exported, tmp_path):
    wanted = EVERY[rule]
    found = [
        f for f in examine(faulty(rule, exported, tmp_path))
        if (f.level, f.rule, f.remedy) == (wanted.level, wanted.name, wanted.remedy)
    ]  # fmt: skip
    assert found
    assert all(f.place and f.found and f.importers and f.remedy for f in found)
    assert examine(exported(NAME)) == ()
    assert examine(exported(NAME, 3)) == ()


def enumeration(*items):
    """Return an edit that adds a type with items, by name and value."""

    def edit(root: ET.Element) -> None:
        types = ET.Element("TypeDefinitions")
        kind = ET.SubElement(ET.SubElement(types, "SimpleType", name="gear"), "Enumeration")
        for name, value in items:
            ET.SubElement(kind, "Item", name=name, value=value)
        root.insert([child.tag for child in root].index("UnitDefinitions") + 1, types)

    return edit


def second_time(root: ET.Element) -> None:
    variable = ET.SubElement(root.find("ModelVariables"), "ScalarVariable", name="t_2")
    facts = {"valueReference": "999", "causality": "independent", "variability": "continuous"}
    variable.attrib |= facts
    ET.SubElement(variable, "Real")


@pytest.mark.parametrize(
    ("edit", "place", "found"),
    [
        (enumeration(("a", "1"), ("a", "2")), "items of type 'gear'", "2 have the name 'a'"),
        (enumeration(("a", "1"), ("b", "1")), "items of type 'gear'", "2 have the value '1'"),
        (second_time, "ModelVariables", "2 variables are independent"),
        (
            set_attributes(REAL.format("m"), nominal="-2.5"),
            "variable 'm'",
            "nominal is -2.5",
        ),
    ],
    ids=["names", "values", "times", "nominal"],
)
def test_fault_of_the_description_is_told_with_its_place(edit, place, found, exported, tmp_path):
    path = with_description(exported(NAME), tmp_path / "faulty.fmu", edit)
    assert (place, found) in [(f.place, f.found) for f in examine(path) if f.level == "wrong"]


def test_what_the_libraries_need_is_told_by_name(exported, tmp_path):
    told = {}
    for rule in ("IMPORTS", "MACOS", "RUN_PATH"):
        path = faulty(rule, exported, tmp_path)
        told[rule] = {f.found for f in examine(path) if f.rule == EVERY[rule].name}
    assert told == {
        "IMPORTS": {"it loads /opt/local/lib/libq.dylib, not in the FMU"},
        "MACOS": {"it needs macOS 14.5 or newer"},
        "RUN_PATH": {"it looks for libraries in /Users/me/lib"},
    }


def test_fault_against_the_schema_is_told_with_its_line(exported, tmp_path):
    path = faulty("SCHEMA", exported, tmp_path)
    (finding,) = (f for f in examine(path) if f.rule == "schema")
    assert finding.place.startswith(f"{DESCRIPTION} line ")
    assert "parametre" in finding.found
