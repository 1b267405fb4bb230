"""SSP files with one to three faults, drawn with a seed: of names, numbers, elements and bytes."""

import io
import random
import zipfile
from collections.abc import Iterator
from xml.etree import ElementTree as ET

from helpers.ssp_files import (
    bindings,
    component,
    connection,
    description,
    experiment,
    mapping,
    parameter_set,
    system,
    values,
)

STUB = (
    '<?xml version="1.0"?><fmiModelDescription fmiVersion="2.0" modelName="m" guid="g">'
    '<ModelExchange modelIdentifier="m"/><CoSimulation modelIdentifier="m"/><ModelVariables>'
    '<ScalarVariable name="u" valueReference="1" causality="input"><Real start="0" unit="m"/>'
    '</ScalarVariable><ScalarVariable name="y" valueReference="2" causality="output"><Real/>'
    '</ScalarVariable><ScalarVariable name="k" valueReference="3" causality="parameter" '
    'variability="fixed"><Real start="1"/></ScalarVariable></ModelVariables><ModelStructure>'
    '<Outputs><Unknown index="2"/></Outputs></ModelStructure></fmiModelDescription>'
)
_WORDS = (
    *("", " ", "a", "g", "h", "q", "y", "u", "k", "in", "x" * 5000, "\u00e4", "\u202e", "a.b", "."),
    *("..", "/", "../..", "1", "1_0", "1e999", "-1e308", "nan", "INF", "0x1", "true", "input"),
    *("output", "inout", "unspecified", "parameter", "%00", "#", "#y", "q.ssp", "#S", "a&lt;b"),
    *("resources/inner.ssp", "resources/a.ssv", "resources/a.ssm", "SystemStructure.ssd"),
    *("any", "ModelExchange", "CoSimulation", "ScheduledExecution"),
    *("application/x-ssp-package", "application/x-ssp-definition", "http://a/b", "m^999", "C:\\a"),
)
_DICTIONARY = (
    '<ssd:SignalDictionaries><ssd:SignalDictionary name="D"><ssb:SignalDictionary version="1.0">'
    '<ssb:DictionaryEntry name="a"><ssc:Real unit="m"/></ssb:DictionaryEntry>'
    "</ssb:SignalDictionary></ssd:SignalDictionary></ssd:SignalDictionaries>"
)


def _parts(connectors):
    kinds = {"u": "input", "y": "output", "k": "parameter"} if connectors else {}
    g = component("g", "", kinds=kinds, source="resources/m.fmu")
    h = component("h", "", values(k=2), kinds=kinds, source="resources/m.fmu")
    exchange = 'type="application/x-fmu-sharedlibrary" implementation="ModelExchange"'
    return g + h.replace("<ssd:Component", f"<ssd:Component {exchange}", 1)


def _whole(inner):
    """Return a description that uses all that is read."""
    linear = '<ssc:LinearTransformation factor="2" offset="1"/>'
    renamed = mapping(("K", "g.k", linear), ("K", "q.h.k", ""))
    file = (
        '<ssd:ParameterBinding source="resources/a.ssv">'
        '<ssd:ParameterMapping source="resources/a.ssm"/></ssd:ParameterBinding>'
    )
    bus = '<ssd:SignalDictionaryReference name="bus" dictionary="D"/>'
    wires = (
        connection("g.y", "h.u", linear)
        + connection("q.out", "bus.a")
        + connection("g.u", "bus.a")
        + connection("in", "q.in")
        + connection("h.y", "out")
    )
    kinds = {"in": "input", "out": "output"}
    sub = system(
        "q", _parts(False), connection("in", "g.u") + connection("g.y", "out"), kinds=kinds
    )
    chosen = values(K=3, mapping=f"<ssd:ParameterMapping>{renamed}</ssd:ParameterMapping>")
    elements = _parts(True) + sub + bus + inner
    whole = system(
        "S", elements, wires, kinds=kinds, bindings=chosen + bindings(file), more=_DICTIONARY
    )
    return description(whole, experiment(0, 1))


def packed(entries):
    """Return a zip archive of entries."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in entries.items():
            archive.writestr(name, content)
    return stream.getvalue()


def base():
    """Return the entries of a right SSP file; `packed` makes the file."""
    fmu = packed({"modelDescription.xml": STUB})
    resources = {
        "resources/m.fmu": fmu,
        "resources/a.ssv": parameter_set(K=1),
        "resources/a.ssm": mapping(("K", "h.k", "")),
    }
    inner = packed({"SystemStructure.ssd": _whole(""), **resources})
    part = '<ssd:Component name="p" type="application/x-ssp-package" source="resources/inner.ssp"/>'
    return {"SystemStructure.ssd": _whole(part), "resources/inner.ssp": inner, **resources}


def mutated(seed: int, number: int) -> Iterator[bytes]:
    """Yield damaged SSP files."""
    draw = random.Random(seed)
    right = base()
    for _ in range(number):
        entries = dict(right)
        for _ in range(draw.randint(1, 3)):
            name = draw.choice([n for n in entries if n.endswith((".ssd", ".ssv", ".ssm"))])
            entries[name] = draw.choice(_CHANGES)(draw, entries[name])
        if draw.random() < 0.1:
            entries.pop(draw.choice(list(entries)))
        content = packed(entries)
        yield _with_damage(draw, content) if draw.random() < 0.1 else content


def _with_word(draw, text):
    """Replace an attribute's value."""
    pieces = text.split('"')
    place = draw.randrange(1, max(2, len(pieces) - 1), 2)
    pieces[min(place, len(pieces) - 1)] = draw.choice(_WORDS)
    return '"'.join(pieces)


def _with_moved_element(draw, text):
    """Remove an element, repeat it, or move a copy of it to another one."""
    try:
        root = ET.fromstring(text)
    except ET.ParseError:
        return text
    parents = [element for element in root.iter() if len(element)]
    if not parents:
        return text
    parent = draw.choice(parents)
    child = draw.choice(list(parent))
    change = draw.randrange(3)
    if change == 0:
        parent.remove(child)
    elif change == 1:
        parent.append(child)
    else:
        target = draw.choice(list(root.iter()))
        if target not in set(child.iter()):
            target.append(child)
    return ET.tostring(root, encoding="unicode")


def _with_swapped_words(draw, text):
    """Exchange the values of two attributes."""
    pieces = text.split('"')
    one, two = (min(draw.randrange(1, max(2, len(pieces)), 2), len(pieces) - 1) for _ in "12")
    pieces[one], pieces[two] = pieces[two], pieces[one]
    return '"'.join(pieces)


def _cut(draw, text):
    """Leave out a piece of the text."""
    begin = draw.randrange(len(text) + 1)
    return text[:begin] + text[begin + draw.choice((1, 10, 100, len(text))) :]


def _with_damage(draw, content):
    """Change bytes of the archive, or cut it."""
    if draw.random() < 0.3:
        return content[: draw.randrange(len(content))]
    damaged = bytearray(content)
    for _ in range(draw.randint(1, 4)):
        damaged[draw.randrange(len(damaged))] = draw.randrange(256)
    return bytes(damaged)


_CHANGES = (_with_word, _with_word, _with_moved_element, _with_swapped_words, _cut)
