"""The FMU of typed_part.c: arrays (FMI 3.0), and variables of several types."""

from pathlib import Path

from helpers.stubbed import stubbed

_ABILITIES = 'canHandleVariableCommunicationStepSize="true" canGetAndSetFMU{state}="true"'
_ENUMERATION = """<TypeDefinitions>{begin}<Item name="slow" value="1"/><Item name="fast" value="3"/>
{end}</TypeDefinitions>"""
_XML_2 = """<fmiModelDescription fmiVersion="2.0" modelName="typed" guid="t">
<CoSimulation modelIdentifier="typed_part" {abilities}/>{types}
<DefaultExperiment startTime="0" stopTime="1" stepSize="0.1"/><ModelVariables>{variables}
</ModelVariables><ModelStructure><Outputs>{outputs}</Outputs></ModelStructure>
</fmiModelDescription>"""
_XML_3 = """<fmiModelDescription fmiVersion="3.0" modelName="typed" instantiationToken="t">
<ModelExchange modelIdentifier="typed_part"/>
<CoSimulation modelIdentifier="typed_part" {abilities}/>{types}
<DefaultExperiment startTime="0" stopTime="1" stepSize="0.1"/><ModelVariables>
<UInt64 name="n" valueReference="1" causality="structuralParameter" start="2" max="4"/>
<Float64 name="A" valueReference="2" causality="parameter" variability="tunable" start="0 0 0 0">
<Dimension valueReference="1"/><Dimension valueReference="1"/></Float64>
<Float64 name="u" valueReference="3" causality="input" start="0" unit="m/s">{length}
<Alias name="drive"/></Float64>
<Float64 name="y" valueReference="4" causality="output">{length}</Float64>
<Float64 name="x" valueReference="5" initial="exact" start="0 0">{length}</Float64>
<Float64 name="der(x)" valueReference="6" derivative="5">{length}</Float64>
{variables}</ModelVariables><ModelStructure>{outputs}
<ContinuousStateDerivative valueReference="6"/></ModelStructure></fmiModelDescription>"""
_TYPED = ("Boolean", "Int32", "Int64", "Float32")  # macros define their functions
_PAIRS = {"on": ("Boolean", 7), "count": ("Int32", 9), "mode": ("Enumeration", 11)}


def typed_part(folder: Path, fmi: int = 3, fault: tuple[str, str] | None = None) -> Path:
    """Build the FMU; a fault is a piece of its C code and what replaces it."""
    state = "state" if fmi == 2 else "State"
    own = {f"fmi{fmi}{verb}FMU{state}" for verb in ("Get", "Set", "Free")}
    own |= {f"fmi3{verb}{kind}" for verb in ("Get", "Set") for kind in _TYPED}
    source = Path(__file__).with_name("typed_part.c")
    if fault:
        code = source.read_text()
        assert fault[0] in code
        source = folder / source.name
        source.write_text(code.replace(*fault))
    return stubbed(source, folder, fmi, _description(fmi == 2), own)


def _description(second: bool) -> str:
    rows = [
        row
        for name, (kind, reference) in _PAIRS.items()
        for row in (
            (f"{name}_in", kind, reference, "input", "1"),
            (name, kind, reference + 1, "output", None),
        )
    ]
    rows += [("above", "Boolean", 13, "output", None), ("heard", "Boolean", 18, "output", None)]
    rows += [("label_in", "String", 16, "input", "none"), ("label", "String", 17, "output", None)]
    if second:
        rows += [("u", "Real", 3, "input", "0"), ("y", "Real", 4, "output", None)]
    else:
        rows += [
            ("level_in", "Float32", 14, "input", "1"),
            ("level", "Float32", 15, "output", None),
        ]
    variables = "".join(_variable(second, *row) for row in rows)
    outputs = [(i, row) for i, row in enumerate(rows, 1) if row[3] == "output"]
    abilities = _ABILITIES.format(state="state" if second else "State")
    if second:
        types = _ENUMERATION.format(
            begin='<SimpleType name="Speed"><Enumeration>', end="</Enumeration></SimpleType>"
        )
        return _XML_2.format(
            abilities=abilities,
            types=types,
            variables=variables,
            outputs="".join(f'<Unknown index="{i}"/>' for i, _ in outputs),
        )
    types = _ENUMERATION.format(begin='<EnumerationType name="Speed">', end="</EnumerationType>")
    return _XML_3.format(
        abilities=abilities,
        types=types,
        variables=variables,
        length='<Dimension valueReference="1"/>',
        outputs="".join(
            f'<Output valueReference="{r[2]}"/>' for r in [(0, 0, 4), *(o for _, o in outputs)]
        ),
    )


def _variable(
    second: bool, name: str, kind: str, reference: int, causality: str, start: str | None
) -> str:
    variability = "" if kind in ("Real", "Float32") else ' variability="discrete"'
    facts = f'name="{name}" valueReference="{reference}" causality="{causality}"{variability}'
    if kind == "String" and not second:
        return f"<String {facts}>{'' if start is None else f'<Start value={start!r}/>'}</String>"
    own = ("" if start is None else f' start="{start}"') + (
        ' declaredType="Speed"' if kind == "Enumeration" else ""
    )
    if second:
        kind = "Integer" if kind == "Int32" else kind
        return f"<ScalarVariable {facts}><{kind}{own}/></ScalarVariable>"
    return f"<{kind} {facts}{own}/>"
