"""SSP files from pieces of text, as other tools write them; parts are gains and a source."""

import zipfile
from pathlib import Path

import cosim

NAMESPACES = " ".join(
    f'xmlns:{prefix}="http://ssp-standard.org/SSP1/SystemStructure{name}"'
    for prefix, name in (
        ("ssc", "Common"),
        ("ssd", "Description"),
        ("ssv", "ParameterValues"),
        ("ssm", "ParameterMapping"),
        ("ssb", "SignalDictionary"),
    )
)
HEAD = (
    '<?xml version="1.0" encoding="UTF-8"?>\n'
    f'<ssd:SystemStructureDescription version="1.0" name="{{name}}" {NAMESPACES}>'
)
CONNECTORS = {
    "gain": {"u": "input", "y": "output", "k": "parameter"},
    "source": {"y": "output", "a": "parameter"},
}


def gain():
    """Return y = k u with the integral x of y."""
    model = cosim.Model("gain", stop_time=1.0, output_interval=0.1)
    u, k = model.input("u", "m", 0.0, "input"), model.parameter("k", "1", 1.0, "gain")
    model.derivative(model.state("x", "m.s", 0.0, "integral"), k * u)
    model.output("y", "m", k * u, "output")
    return model.freeze()


def source():
    """Return y = a + t."""
    model = cosim.Model("source", stop_time=1.0, output_interval=0.1)
    a = model.parameter("a", "m", 2.0, "value")
    model.derivative(model.state("s", "m", 0.0, "time"), 1.0)
    model.output("y", "m", a + model.t, "output")
    return model.freeze()


def component(name, kind, bindings="", *, kinds=None, source=None):
    """Return a component with its connectors."""
    inner = connectors(**(CONNECTORS[kind] if kinds is None else kinds))
    source = source or f"resources/{kind}.fmu"
    return f'<ssd:Component name="{name}" source="{source}">{inner}{bindings}</ssd:Component>'


def system(name, elements, connections="", *, kinds=None, bindings="", more=""):
    """Return a system of elements."""
    return (
        f'<ssd:System name="{name}">{connectors(**(kinds or {}))}{bindings}<ssd:Elements>{elements}'
        f"</ssd:Elements><ssd:Connections>{connections}</ssd:Connections>{more}</ssd:System>"
    )


def connectors(unit=None, **kinds):
    """Return connectors by kind; all have the same unit."""
    inner = "<ssc:Real/>" if unit is None else f'<ssc:Real unit="{unit}"/>'
    rows = (
        f'<ssd:Connector name="{n}" kind="{k}">{inner}</ssd:Connector>' for n, k in kinds.items()
    )
    return f"<ssd:Connectors>{''.join(rows)}</ssd:Connectors>"


def connection(start, end, inner="", **attributes):
    """Return a connection of "element.connector", or "connector" of the system itself."""
    ends = ""
    for side, name in (("start", start), ("end", end)):
        element, dot, connector = name.partition(".")
        ends += f'{side}Element="{element}" ' if dot else ""
        ends += f'{side}Connector="{connector if dot else name}" '
    more = " ".join(f'{key}="{value}"' for key, value in attributes.items())
    return f"<ssd:Connection {ends}{more}>{inner}</ssd:Connection>"


def values(*, mapping="", **numbers):
    """Return a parameter binding with a set in the description."""
    chosen = parameter_set(**numbers)
    inner = f"<ssd:ParameterValues>{chosen}</ssd:ParameterValues>{mapping}"
    return bindings(f"<ssd:ParameterBinding>{inner}</ssd:ParameterBinding>")


def bindings(inner):
    """Return parameter bindings."""
    return f"<ssd:ParameterBindings>{inner}</ssd:ParameterBindings>"


def parameter_set(**numbers):
    """Return a parameter set; __ in a name stands for a dot."""
    rows = "".join(
        f'<ssv:Parameter name="{name.replace("__", ".")}"><ssv:Real value="{number}"/>'
        "</ssv:Parameter>"
        for name, number in numbers.items()
    )
    attributes = 'xmlns:ssv="v" version="1.0" name="set"'
    return (
        f"<ssv:ParameterSet {attributes}><ssv:Parameters>{rows}</ssv:Parameters></ssv:ParameterSet>"
    )


def mapping(*rows):
    """Return a parameter mapping of (source, target, content) rows."""
    entries = "".join(
        f'<ssm:MappingEntry source="{source}" target="{target}">{inner}</ssm:MappingEntry>'
        for source, target, inner in rows
    )
    return f'<ssm:ParameterMapping {NAMESPACES} version="1.0">{entries}</ssm:ParameterMapping>'


def description(whole, after="", name="case"):
    """Return a system description."""
    return f"{HEAD.format(name=name)}{whole}{after}</ssd:SystemStructureDescription>"


def experiment(start=0, stop=1):
    """Return a default experiment."""
    return f'<ssd:DefaultExperiment startTime="{start}" stopTime="{stop}"/>'


def package(path: Path, fmus, ssd, **entries):
    """Write an SSP file; __ in the name of an entry stands for a slash, a last _ for a dot.

    Args:
        fmus: Files of the folder resources.
        ssd: The default description.
        entries: Content of more entries.
    """
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("SystemStructure.ssd", ssd)
        for fmu in fmus:
            archive.write(fmu, f"resources/{fmu.name}")
        for name, content in entries.items():
            stem, _, ending = name.replace("__", "/").rpartition("_")
            archive.writestr(f"{stem}.{ending}", content)
    return path


def ends(found):
    """Return what drives each input of a system, with factor and offset."""
    return {".".join(w.input): (".".join(w.output), w.factor, w.offset) for w in found.connections}
