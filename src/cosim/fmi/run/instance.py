"""An FMU's description and a live instance of it through fmpy; every failure says why."""

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import chdir, contextmanager
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from cosim.errors import FmuError, SecurityError, UnknownName
from cosim.fmi.aliases import flat_names
from cosim.fmi.archive import DESCRIPTION
from cosim.fmi.run.patient import ADVICE, LIMIT
from cosim.host.temporary import loads_no_library
from cosim.text.escaping import sentence

INTERFACES = ("ModelExchange", "CoSimulation")
NUMERIC = re.compile("Real|Integer|Boolean|Enumeration|Float..|U?Int.{1,2}")
_MOST_LETTERS = 200  # of a library's name; file systems take 255
_OF_CVODE = re.compile(r"CVode error \(code -?\d+\) in module \w+, function \S+: ")
_ENDED_WITHIN_A_STEP = re.compile(r"came no further than \S+$")  # and nothing says why
_CLOSER = "a singularity, or more steps than one call allows: closer output times allow more"
_MESSAGES = 3  # of an FMU's log, in an error


def read_description(folder: Path, name: object) -> Any:
    """Return fmpy's model description of an unpacked FMU.

    Variables of FMUs that were exported here with structured names have their flat ones, by which
    runs on other roads know them; the structured ones are their aliases.

    Raises:
        FmuError: The file is not as the FMI wants it.
    """
    from fmpy import read_model_description

    try:
        description = read_model_description(str(folder), validate=False)
        names = flat_names(ET.parse(folder / DESCRIPTION).getroot())
    except Exception as error:
        told = f"{type(error).__name__}: {sentence(str(error))}"
        raise FmuError(f"{name}: modelDescription.xml cannot be read: {told}") from error
    if names:
        _flatten(description, names)
    return description


def _flatten(description: Any, names: Mapping[str, str]) -> None:
    from fmpy.model_description import VariableAlias

    for variable in description.modelVariables:
        if variable.name in names:
            variable.aliases = [VariableAlias(name=variable.name)]
            variable.name = names[variable.name]


def choose_interface(folder: Path, description: Any, wanted: str | None, name: object) -> str:
    """Return the interface to run: the wanted one, else co-simulation where there is one.

    Raises:
        UnknownName: There is no such interface in the FMI.
        FmuError: The FMU does not have it, or no binary for this machine, or none can be
            loaded from the folder.
        SecurityError: The binary lies elsewhere.
    """
    if wanted is not None and wanted not in INTERFACES:
        raise UnknownName.among("cosim", "interface", wanted, INTERFACES)
    has = {"ModelExchange": description.modelExchange, "CoSimulation": description.coSimulation}
    kind = wanted or ("CoSimulation" if has["CoSimulation"] else "ModelExchange")
    if not has[kind]:
        other = next((offered for offered in INTERFACES if has[offered]), "neither")
        raise FmuError(f"{name} has no {kind} interface; it has {other}")
    _find_library(folder, description, has[kind].modelIdentifier, name)
    if loads_no_library(folder):
        raise FmuError(
            f"{name} was unpacked in {folder.parent}, on a file system mounted noexec, from which "
            "no binary can be loaded; set TMPDIR to another folder"
        )
    return kind


def _find_library(folder: Path, description: Any, identifier: str, name: object) -> None:
    import fmpy

    if not (identifier.isascii() and identifier.isidentifier()):
        told = sentence(identifier)
        raise SecurityError(f"{name}: modelIdentifier '{told}' is no C name; do not use it")
    if len(identifier) > _MOST_LETTERS:
        raise FmuError(f"{name}: its modelIdentifier has {len(identifier)} letters; do not use it")
    own = fmpy.platform_tuple if description.fmiVersion.startswith("3") else fmpy.platform
    if (folder / "binaries" / own / f"{identifier}{fmpy.sharedLibraryExtension}").is_file():
        return
    others = sorted(path.name for path in (folder / "binaries").glob("*") if path.is_dir())
    has = f"only for {', '.join(others)}" if others else "for no platform"
    raise FmuError(f"{name} has a binary {has}, none for {own}; export it with --platform")


@contextmanager
def instantiated(
    folder: Path, description: Any, kind: str, name: object
) -> Iterator[tuple[Any, Callable[[Exception], FmuError]]]:
    """Yield fmpy's instance of an unpacked FMU, and what turns an error into one with reasons.

    Raises:
        FmuError: The library cannot be loaded, or refuses.
    """
    from fmpy import instantiate_fmu

    log: list[str] = []

    def collect(*arguments: Any) -> None:
        """Keep the message, the last argument in every version of the FMI."""
        text = arguments[-1]
        log.append(text.decode(errors="replace") if isinstance(text, bytes) else str(text))

    def explained(error: Exception) -> FmuError:
        told = _OF_CVODE.sub("CVODE: ", str(error)) or type(error).__name__
        last = log[-_MESSAGES:]
        advice = [ADVICE] if LIMIT in told else []
        if last and _ENDED_WITHIN_A_STEP.search(last[-1]):
            advice.append(_CLOSER)
        reasons = dict.fromkeys(map(sentence, (told, *last, *advice)))
        return FmuError(f"{name}: {'; '.join(reasons)}")

    with chdir("."):  # fmpy stays in the library's folder where it cannot load it
        try:
            instance = instantiate_fmu(
                str(folder), description, kind, debug_logging=True, logger=collect
            )
        except Exception as error:
            raise explained(error) from error
    _refuse_unknown_status(instance)
    try:
        yield instance, explained
    finally:
        instance.freeInstance()


def _refuse_unknown_status(instance: Any) -> None:
    """Have a status below 0 end the run, which fmpy takes for success."""
    original = instance._call

    def checked(function: str, *arguments: Any) -> Any:
        result = original(function, *arguments)
        if isinstance(result, int) and result < 0:
            raise FmuError(f"{function} returned {result}, which is no status of the FMI")
        return result

    instance._call = checked


def count_derivatives(instance: Any) -> list[int]:
    """Count the evaluations of the derivatives from now on, in the list's only item."""
    calls = [0]
    name = (
        "getDerivatives" if hasattr(instance, "getDerivatives") else "getContinuousStateDerivatives"
    )
    original = getattr(instance, name)

    def counted(*arguments: Any) -> Any:
        calls[0] += 1
        return original(*arguments)

    setattr(instance, name, counted)
    return calls


def is_number(variable: Any) -> bool:
    """Tell whether a variable holds one number."""
    return NUMERIC.fullmatch(variable.type) is not None and not variable.dimensions


def may_be_set(variable: Any) -> bool:
    """Tell whether a run begins with what is given; an approximate start is but a guess."""
    if variable.start is None or variable.variability == "constant":
        return False
    return variable.causality == "input" or variable.initial in ("exact", None)


def by_name(description: Any) -> Mapping[str, Any]:
    """Return the variables by name, and by their other names."""
    variables = {variable.name: variable for variable in description.modelVariables}
    aliases = {a.name: v for v in variables.values() for a in getattr(v, "aliases", ())}
    return aliases | variables
