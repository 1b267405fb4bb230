"""FMU files that only describe themselves: enough to couple them, not to run them."""

import zipfile
from pathlib import Path

_DESCRIPTIONS = {
    2: """<fmiModelDescription fmiVersion="2.0" modelName="part" guid="{{part}}">
  <CoSimulation modelIdentifier="part"/>
  <UnitDefinitions>{units}</UnitDefinitions>
  <ModelVariables>
    <ScalarVariable name="u" valueReference="0" causality="input">
      <Real start="0" unit="{unit}"{facts}/>
    </ScalarVariable>
    <ScalarVariable name="y" valueReference="1" causality="output">
      <Real unit="{unit}"{facts}/>
    </ScalarVariable>
  </ModelVariables>
  <ModelStructure><Outputs><Unknown index="2"/></Outputs></ModelStructure>
</fmiModelDescription>""",
    3: """<fmiModelDescription fmiVersion="3.0" modelName="part" instantiationToken="{{part}}">
  <CoSimulation modelIdentifier="part"/>
  <UnitDefinitions>{units}</UnitDefinitions>
  <ModelVariables>
    <Float64 name="u" valueReference="0" causality="input" start="0" unit="{unit}"{facts}/>
    <Float64 name="y" valueReference="1" causality="output" unit="{unit}"{facts}/>
  </ModelVariables>
  <ModelStructure><Output valueReference="1"/></ModelStructure>
</fmiModelDescription>""",
}


def described_file(
    path: Path, unit: str, base: str | None, *, display: str = "", facts: str = "", fmi: int = 2
) -> Path:
    """Write a file with input u and output y.

    Args:
        path: Where.
        unit: Of both variables.
        base: Attributes of its BaseUnit; no definition if None.
        display: Elements DisplayUnit.
        facts: Further attributes of both variables.
        fmi: Version.
    """
    defined = "" if base is None else f"<BaseUnit {base}/>"
    units = "" if base is None and not display else f'<Unit name="{unit}">{defined}{display}</Unit>'
    with zipfile.ZipFile(path, "w") as archive:
        text = _DESCRIPTIONS[fmi].format(units=units, unit=unit, facts=facts)
        archive.writestr("modelDescription.xml", text)
    return path
