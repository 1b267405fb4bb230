"""The model description of an unpacked FMU, and which of its interfaces runs on this machine."""

import re
from collections import Counter
from collections.abc import Mapping
from enum import StrEnum
from functools import lru_cache
from math import inf
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from cosim.errors import FmuError, SecurityError, UnknownName
from cosim.fmi.archive import DESCRIPTION, flat_names
from cosim.host.temporary import loads_no_library
from cosim.text import described, sentence


class Interface(StrEnum):
    """An interface of the FMI: who integrates."""

    MODEL_EXCHANGE = "ModelExchange"  # the importer
    CO_SIMULATION = "CoSimulation"  # the solver in the FMU


INTERFACES = tuple(Interface)
_MOST_LETTERS = 200  # of a library's name; file systems take 255
_FILE_NAME = re.compile(r"\w[\w.-]*", re.ASCII)  # more than a C name: dashes are common


def is_second(description: Any) -> bool:
    """Tell whether a file is of FMI 2."""
    return str(description.fmiVersion).startswith("2")


def abilities_of(description: Any, kind: str) -> Any:
    """Return fmpy's description of an interface; None if the file does not have it."""
    exchange = kind == Interface.MODEL_EXCHANGE
    return description.modelExchange if exchange else description.coSimulation


def asks_for_inputs(description: Any) -> bool:
    """Tell whether an FMU asks for cubic inputs within its communication steps (FMI 3.0)."""
    return getattr(description.coSimulation, "recommendedIntermediateInputSmoothness", 0) >= 3


@lru_cache(8)
def by_name(description: Any) -> Mapping[str, Any]:
    """Return the variables by name, and by their other names."""
    variables = {variable.name: variable for variable in description.modelVariables}
    aliases = {a.name: v for v in variables.values() for a in getattr(v, "aliases", ())}
    return aliases | variables


def unit_of(variable: Any) -> str | None:
    """Return the unit of a variable or of its type; None if it has none."""
    declared = variable.declaredType
    return variable.unit or (declared.unit if declared else None)


def nominal_of(variable: Any) -> float | None:
    """Return the nominal value of a variable or of its type; None without a positive number."""
    declared = variable.declaredType
    nominal = variable.nominal or (declared.nominal if declared else None)
    value = float(nominal or 0.0)
    return value if 0 < value < inf else None


def read_description(folder: Path, name: object) -> Any:
    """Return fmpy's model description of an unpacked FMU.

    An FMU that this package exported with structured names has two names for a variable: the flat
    one, which every backend uses, and the structured one as its alias.

    Raises:
        FmuError: The description cannot be read, has a name twice, or is of another version than
            FMI 2 and 3.
    """
    from fmpy.model_description import VariableAlias, read_model_description

    try:
        root = ET.parse(folder / DESCRIPTION).getroot()
        version = root.get("fmiVersion") or "of unknown version"
        if not version.startswith(("2.0", "3.")):
            called = f"{name} is of FMI {sentence(version)}, which cannot be run"
            raise FmuError(f"{called}; export it as FMI 2.0 or 3.0")
        if root.find("ModelVariables") is None:
            raise FmuError(f"{name}: {DESCRIPTION} has no ModelVariables; there is nothing to run")
        description = read_model_description(str(folder), validate=False)
        names = flat_names(root)
    except FmuError:
        raise
    except Exception as error:
        text = f"{DESCRIPTION} cannot be read: {described(error)}; cosim check finds what is wrong"
        raise FmuError(f"{name}: {text}") from error
    for variable in description.modelVariables:
        if variable.name in names:
            variable.aliases = [VariableAlias(name=variable.name)]
            variable.name = names[variable.name]
    own_names = (v.name for v in description.modelVariables if v.causality != "independent")
    for own, count in Counter(own_names).items():
        if count > 1:
            raise FmuError(f"{name}: {count} variables have the name '{own}'; rename one")
    _drop_inverse_display_units(description, root)
    _read_overlooked(description, root)
    if not is_second(description):  # fmpy does not read the flag of FMI 3
        for kind in (description.modelExchange, description.coSimulation):
            for element in root.iterfind(type(kind).__name__):
                flag = element.get("providesDirectionalDerivatives")
                kind.providesDirectionalDerivative = flag in ("true", "1")
    return description


def _drop_inverse_display_units(description: Any, root: ET.Element) -> None:
    """Remove the display units that are reciprocals, for which fmpy has no attribute."""
    for unit, element in zip(
        description.unitDefinitions, root.iterfind("UnitDefinitions/Unit"), strict=True
    ):
        shown = zip(unit.displayUnits, element.iterfind("DisplayUnit"), strict=True)
        unit.displayUnits = [d for d, own in shown if own.get("inverse") not in ("true", "1")]


def _read_overlooked(description: Any, root: ET.Element) -> None:
    """Read what fmpy overlooks: `relativeQuantity` and the bounds of unsigned integers."""
    elements = {e.get("name"): (e, *e[:1]) for e in root.iterfind("ModelVariables/*")}
    for variable in description.modelVariables:
        own = elements.get(variable.name, ())
        if any(e.get("relativeQuantity") in ("true", "1") for e in own):
            variable.relativeQuantity = True
        if own and variable.type.startswith("UInt"):
            variable.min, variable.max = (own[0].get(end) for end in ("min", "max"))


def choose_interface(
    folder: Path, description: Any, requested: str | None, name: object
) -> Interface:
    """Return the requested interface, or by default co-simulation if the FMU has it.

    Raises:
        UnknownName: There is no such interface in the FMI.
        FmuError: The FMU does not have it, or no binary for this machine, or none can be
            loaded from the folder, or the FMU has input clocks.
        SecurityError: The library's name leads out of its folder.
    """
    if requested is not None and requested not in INTERFACES:
        raise UnknownName.among("cosim", "interface", requested, INTERFACES)
    has = {kind: abilities_of(description, kind) for kind in Interface}
    default = Interface.CO_SIMULATION if description.coSimulation else Interface.MODEL_EXCHANGE
    kind = Interface(requested) if requested else default
    if not has[kind]:
        other = next((offered for offered in INTERFACES if has[offered]), None)
        if other is None:
            raise FmuError(
                f"{name} offers scheduled execution only; export it for model exchange or "
                "co-simulation"
            )
        raise FmuError(f"{name} has no {kind} interface; it has {other}")
    for variable in description.modelVariables:
        if variable.type == "Clock" and variable.causality == "input":
            raise FmuError(
                f"{name}: its clock {variable.name} ticks only when an importer says so, which is "
                "not supported; export it without input clocks"
            )
    _find_library(folder, description, has[kind].modelIdentifier, name)
    if loads_no_library(folder):
        raise FmuError(
            f"{name} was unpacked in {folder.parent}, on a file system mounted noexec, from which "
            "no binary can be loaded; set TMPDIR to another folder"
        )
    return kind


def _find_library(folder: Path, description: Any, identifier: str, name: object) -> None:
    import fmpy

    if not _FILE_NAME.fullmatch(identifier):
        shown = sentence(identifier)
        raise SecurityError(f"{name}: modelIdentifier '{shown}' is no C name; do not use it")
    if len(identifier) > _MOST_LETTERS:
        raise FmuError(f"{name}: its modelIdentifier has {len(identifier)} letters; do not use it")
    own = fmpy.platform if is_second(description) else fmpy.platform_tuple
    library = folder / "binaries" / own / f"{identifier}{fmpy.sharedLibraryExtension}"
    if library.is_file():
        return
    if present := sorted(path.name for path in library.parent.glob(f"*{library.suffix}")):
        raise FmuError(
            f"{name}: modelIdentifier '{identifier}' stands for {library.name}, but the library in "
            f"binaries/{own} is {', '.join(present)}; give them the same name"
        )
    others = sorted({path.parent.name for path in (folder / "binaries").glob("*/*.*")})
    has = f"only for {', '.join(others)}" if others else "for no platform"
    if str(description.generationTool).startswith("cosim"):
        remedy = "export it with --platform"
    elif not others and (folder / "sources").is_dir():
        remedy = "compile its sources, e.g. with fmpy compile"
    else:
        remedy = "run it there, or ask its author for one for this platform"
    raise FmuError(f"{name} has a binary {has}, none for {own}; {remedy}")
