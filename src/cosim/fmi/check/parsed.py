"""`modelDescription.xml` of FMI 2.0 and 3.0, read into one form for the checks.

Variables are known by their position in the file. Texts stay texts: whether they are numbers is
for the checks to say.
"""

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from typing import NamedTuple
from xml.etree import ElementTree as ET

from cosim.fmi.archive import entry_content
from cosim.fmi.run.typed_values import REALS

BUILD = "sources/buildDescription.xml"
_SECTIONS = {  # paths of their entries in the model structure of FMI 2.0 and 3.0
    "Outputs": ("Outputs/Unknown", "Output"),
    "Derivatives": ("Derivatives/Unknown", "ContinuousStateDerivative"),
    "InitialUnknowns": ("InitialUnknowns/Unknown", "InitialUnknown"),
}


class Described(NamedTuple):  # made faster than a dataclass: files have up to 400000 variables
    """A variable as the file describes it; what is missing is None.

    Attributes:
        name, kind, causality, variability, initial: As in FMI; `kind` is the type of its values.
        reference: The value reference.
        derivative_of: Position of the state; -1 where there is no such variable.
        texts: The attributes min, max, nominal, start, unit, displayUnit, also of its type.
        shape: Sizes of an array, None where the file does not tell one; () for a single value.
    """

    name: str
    kind: str
    causality: str
    variability: str
    initial: str | None
    reference: str
    derivative_of: int | None
    texts: Mapping[str, str]
    shape: tuple[int | None, ...]

    @property
    def nominal(self) -> float:
        """Nominal value, above 0; 1 where there is none."""
        return abs(float(self.texts.get("nominal", "1"))) or 1.0


@dataclass(frozen=True)
class Unknown:
    """An entry of the model structure: positions of the unknown and of what it depends on.

    -1 stands for what the file does not describe; `needs` is None where nothing is declared.
    `kinds` are the kinds of the dependencies, where they are declared.
    """

    position: int
    needs: tuple[int, ...] | None
    kinds: tuple[str, ...] = ()


@dataclass(frozen=True)
class Description:
    """A model description.

    Attributes:
        version: "2" or "3".
        root: The whole file.
        interfaces: Attributes of ModelExchange and CoSimulation, as far as offered.
        token: GUID or instantiation token.
        units: Their definitions by name.
        variables: In the order of the file.
        sections: Outputs, Derivatives, InitialUnknowns.
    """

    version: str
    root: ET.Element
    interfaces: Mapping[str, Mapping[str, str]]
    token: str
    units: Mapping[str | None, ET.Element]
    variables: tuple[Described, ...]
    sections: Mapping[str, tuple[Unknown, ...]]


def fmi_version(content: bytes) -> str:
    """Return what a model description names as its version; "" where it cannot be read."""
    try:  # the rest is not read
        return str(next(ET.iterparse(BytesIO(content), ["start"]))[1].get("fmiVersion", "?"))
    except ET.ParseError:
        return ""


def listed_sources(archive: zipfile.ZipFile, described: Description) -> list[str]:
    """Return the source files that an FMU lists."""
    if described.version == "2":
        interfaces = (i for i in described.root if i.tag in described.interfaces)
        files = (file for i in interfaces for file in i.iterfind("SourceFiles/File"))
    elif BUILD in archive.namelist():
        files = ET.fromstring(entry_content(archive, BUILD)).iter("SourceFile")
    else:
        return []
    return [file.get("name", "") for file in files]


def parse(content: bytes) -> Description:
    """Read a model description of FMI 2.0 or 3.0.

    Raises:
        ValueError: It is not well-formed or of another version.
    """
    try:
        root = ET.fromstring(content)
    except ET.ParseError as error:
        raise ValueError(f"not well-formed: {error}") from error
    version = root.get("fmiVersion", "")
    if version != "2.0" and not version.startswith("3.0"):
        raise ValueError(f"fmiVersion is '{version}'; 2.0 and 3.0 can be read")
    major = version[0]
    found = {name: root.find(name) for name in ("ModelExchange", "CoSimulation")}
    listed = root.findall("ModelVariables/*")
    types = {
        t.get("name"): (t if major == "3" else next(iter(t), t)).attrib
        for t in root.findall("TypeDefinitions/*")
    }
    by_reference = {element.get("valueReference"): i for i, element in enumerate(listed)}
    starts = {element.get("valueReference"): element.get("start") for element in listed}

    def position(text: str | None) -> int:
        """Find a variable by index (FMI 2) or value reference (FMI 3)."""
        if major == "3":
            return by_reference.get(text, -1)
        index = int(text) if text and text.isascii() and text.isdigit() else 0
        return index - 1 if index <= len(listed) else -1

    def unknown(element: ET.Element) -> Unknown:
        needs = element.get("dependencies")
        places = None if needs is None else tuple(position(word) for word in needs.split())
        place = position(element.get("index" if major == "2" else "valueReference"))
        return Unknown(place, places, tuple(element.get("dependenciesKind", "").split()))

    def described(element: ET.Element) -> Described:
        facts = element if major == "3" else next(iter(element), ET.Element("nothing"))
        kind, state = facts.tag, facts.get("derivative")
        causality = element.get("causality", "local")
        fixed = major == "3" and causality.endswith("arameter")
        usual = "fixed" if fixed else "continuous" if kind in REALS else "discrete"
        variability = element.get("variability", usual)
        own = facts.attrib
        texts = {**types[t], **own} if (t := own.get("declaredType")) in types else own
        if (start := facts.find("Start")) is not None:  # texts and binary values in FMI 3
            texts = {**texts, "start": start.get("value", "")}
        sizes = element.iterfind("Dimension") if major == "3" else ()
        counts = (d.get("start") or starts.get(d.get("valueReference")) or "" for d in sizes)
        return Described(
            element.get("name", ""),
            kind,
            causality,
            variability,
            element.get("initial") or _usual_initial(causality, variability),
            element.get("valueReference", ""),
            None if state is None else position(state),
            texts,
            tuple(int(text) if text.isdecimal() else None for text in counts),
        )

    tables = {
        name: tuple(map(unknown, root.findall(f"ModelStructure/{paths[int(major) - 2]}")))
        for name, paths in _SECTIONS.items()
    }
    return Description(
        major,
        root,
        {name: element.attrib for name, element in found.items() if element is not None},
        root.get("guid" if major == "2" else "instantiationToken", ""),
        {unit.get("name"): unit for unit in root.iterfind("UnitDefinitions/Unit")},
        tuple(described(element) for element in listed),
        tables,
    )


def _usual_initial(causality: str, variability: str) -> str | None:
    """Return what holds where a file does not say: FMI 2.0.4, 2.2.7; FMI 3.0.2, 2.4.7.5."""
    if causality in ("input", "independent"):
        return None
    exact = causality in ("parameter", "structuralParameter") or variability == "constant"
    return "exact" if exact else "calculated"
