"""Parameter values of SSP files: sets (.ssv), and mappings of their names and values (.ssm)."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from math import isfinite
from xml.etree import ElementTree as ET

from casadi_models.units import conversion
from cosim.coupling.connectors import transformed
from cosim.coupling.ssp.package import Document
from cosim.errors import CosimError, ParameterError, UnknownName
from cosim.fmi.run.typed_values import RANGES, REALS
from cosim.fmi.units import Measured
from cosim.model.quantities import quantity

_SET, _MAPPING = "application/x-ssp-parameter-set", "application/x-ssp-parameter-mapping"
_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_INTEGER = re.compile(r"[+-]?[0-9]+")
_TRUTH = {"true": 1.0, "1": 1.0, "false": 0.0, "0": 0.0}
_TABLES = ("BooleanMappingTransformation", "IntegerMappingTransformation")


@dataclass(frozen=True)
class Value:
    """A value of a variable: `factor` times the number in the variable's unit, plus `offset`.

    Attributes:
        number: As the parameter set has it; the name of an item, of an enumeration.
        unit: Its unit; without a name, that of the variable.
        factor, offset: Of a mapping's linear transformation.
        keeps_unit: Whether the unit is not converted.
    """

    number: float | str
    unit: Measured
    factor: float = 1.0
    offset: float = 0.0
    keeps_unit: bool = False

    def in_unit(self, name: str, unit: Measured) -> float | str:
        """Return the number in a unit; of an enumeration, the name of its item.

        Raises:
            ParameterError: The units do not fit, or an item would be transformed.
        """
        number = self.number
        if isinstance(number, str):
            if (self.factor, self.offset) != (1.0, 0.0):
                raise ParameterError(f"{name} = {number!r} is no number and cannot be transformed")
            return number
        if None in (self.unit.name, unit.name) or self.keeps_unit:
            return transformed(number, self.factor, self.offset)
        own = self.unit.definition
        if own is None or unit.definition is None:
            number = quantity(name, f"{number!r} {self.unit.name}", str(unit.name))
        else:
            try:
                own = own.difference() if unit.is_difference else own
                scale, shift = conversion(own, unit.definition)
            except ValueError as error:
                reason = f"'{self.unit.name}' of the file cannot be converted to '{unit.name}' of"
                reason += " the FMU, by their definitions"
                raise ParameterError(f"{name} = {number!r}: {reason}") from error
            number = transformed(number, scale, shift)
        return transformed(number, self.factor, self.offset)


def real(document: Document, where: str, text: str | None, default: float = 0.0) -> float:
    """Return a finite number as XML writes it; `default` for None.

    Raises:
        UsageError: It is none, such as 1_0, NaN or an empty text.
    """
    if text is None:
        return default
    written = text.strip(" \t\r\n")
    value = float(written) if _NUMBER.fullmatch(written) else float("nan")
    if not isfinite(value):
        raise document.fault(f"{where} = {text!r} is no number; only numbers can be set here")
    return value


def truth(document: Document, where: str, text: str | None) -> bool:
    """Return a Boolean value as XML writes it; False for None."""
    if text is not None and text.strip() not in _TRUTH:
        raise document.fault(f"{where} = {text!r} is neither true nor false")
    return text is not None and bool(_TRUTH[text.strip()])


def linear(document: Document, where: str, element: ET.Element) -> tuple[float, float]:
    """Return factor and offset of the linear transformation in an element; 1 and 0 without one."""
    found = element.find("LinearTransformation")
    if found is None:
        return 1.0, 0.0
    factor = real(document, f"factor of {where}", found.get("factor"), 1.0)
    return factor, real(document, f"offset of {where}", found.get("offset"))


def bound_values(
    document: Document, element: ET.Element, unmatched: dict[ET.Element, CosimError | None]
) -> Iterator[tuple[Document, str, Value]]:
    """Yield the values that an element binds, in order, with the document that has them.

    Args:
        document: Where the element is.
        element: A system or a component.
        unmatched: Gets each entry of a mapping: the error if no set so far has its source, else
            None. One mapping may serve several sets.

    Raises:
        CosimError: A set or a mapping cannot be read.
    """
    for binding in element.iterfind("ParameterBindings/ParameterBinding"):
        owner = f"a parameter binding of '{element.get('name')}'"
        prefix = binding.get("prefix") or ""
        for place, chosen in _content(document, binding, owner, "ParameterValues", _SET):
            values = {prefix + name: value for name, value in _parameters(place, chosen)}
            mapping = binding.find("ParameterMapping")
            if mapping is None:
                yield from ((place, name, value) for name, value in values.items())
                continue
            where = f"the parameter mapping of '{element.get('name')}'"
            targets = set[str]()
            for table, entries in _content(document, mapping, where, None, _MAPPING):
                for target, value in _mapped(table, entries, values, unmatched):
                    if target in targets:
                        raise table.fault(f"two parameters are mapped to {target}; drop one")
                    targets.add(target)
                    yield table, target, value


def _content(
    document: Document, element: ET.Element, where: str, inline: str | None, kind: str
) -> Iterator[tuple[Document, ET.Element]]:
    """Yield the set or the mapping that an element has or refers to."""
    if element.get("type", kind) != kind:
        raise document.fault(f"{where} is of type {element.get('type')}, not {kind}")
    if element.get("sourceBase", "SSD") != "SSD":
        raise document.fault(f'{where} has sourceBase="{element.get("sourceBase")}"; give SSD')
    root = "ParameterSet" if kind == _SET else "ParameterMapping"
    source = element.get("source")
    if source is not None:
        found = document.package.document(document.find(source)[0], root)
        yield found, found.root
        return
    for holder in [element] if inline is None else element.iterfind(inline):
        yield from ((document, chosen) for chosen in holder.iterfind(root))


def _parameters(document: Document, chosen: ET.Element) -> Iterator[tuple[str, Value]]:
    units = document.units_in(chosen)
    for parameter in chosen.iterfind("Parameters/Parameter"):
        name = parameter.get("name", "")
        for element in parameter:
            if element.tag == "Annotations":
                continue
            if element.tag == "Dimension":
                raise document.fault(f"{name} is an array; only numbers can be set here")
            number = _number(document, name, element)
            yield name, Value(number, Measured.of(element.get("unit"), units))


def _number(document: Document, name: str, element: ET.Element) -> float | str:
    text = element.get("value", "")
    if element.tag in REALS:
        return real(document, name, text)
    if element.tag in RANGES and _INTEGER.fullmatch(text.strip()):
        return int(text) if len(text) < 100 else real(document, name, "")
    if element.tag in ("Enumeration", "String"):
        return text
    if element.tag == "Boolean" and text.strip() in _TRUTH:
        return _TRUTH[text.strip()]
    raise document.fault(
        f"{name} = {text!r} ({element.tag}) is no number; only numbers can be set here"
    )


def _mapped(
    document: Document,
    mapping: ET.Element,
    values: Mapping[str, Value],
    unmatched: dict[ET.Element, CosimError | None],
) -> Iterator[tuple[str, Value]]:
    for entry in mapping.iterfind("MappingEntry"):
        source, target = entry.get("source", ""), entry.get("target", "")
        if not source:  # of a table that some tools write for all targets
            continue
        if source not in values:
            what = f"the mapping to {target}: the parameter set"
            near = UnknownName.among(what, "parameter", source, values)
            unmatched.setdefault(entry, document.fault(str(near), UnknownName))
            continue
        unmatched[entry] = None
        where = f"the mapping of {source} to {target}"
        if not target:
            raise document.fault(f"a mapping of {source} has no target; name one")
        value = values[source]
        if value.unit.name is not None and truth(
            document, f"suppressUnitConversion of {where}", entry.get("suppressUnitConversion")
        ):
            value = replace(value, keeps_unit=True)
        factor, offset = linear(document, where, entry)
        number = _looked_up(document, where, entry, value.number)
        yield target, replace(value, number=number, factor=factor, offset=offset)


def _looked_up(
    document: Document, where: str, entry: ET.Element, number: float | str
) -> float | str:
    """Return what a table of a mapping gives for a value; the value where it has no row."""
    for row in entry.iterfind("EnumerationMappingTransformation/MapEntry"):
        if row.get("source") == number:
            return row.get("target", "")
    for kind in _TABLES:
        for row in entry.iterfind(f"{kind}/MapEntry"):
            pair = [_TRUTH.get(row.get(end, ""), row.get(end, "")) for end in ("source", "target")]
            source, target = (real(document, f"an entry of {where}", str(text)) for text in pair)
            if source == number:
                return target
    return number
