"""Faults of FMI 3.0 descriptions whose parts do not fit together, each made in a sound file."""

import io
import zipfile

import pytest

from cosim.fmi.check.check import examine
from cosim.fmi.check.finding import OWN

SOUND = """<fmiModelDescription fmiVersion="3.0" modelName="part" instantiationToken="{part}">
<ModelExchange modelIdentifier="part"/>
<TypeDefinitions><Float64Type name="Length"/>
<EnumerationType name="Gear"><Item name="low" value="1"/><Item name="high" value="3"/>
</EnumerationType></TypeDefinitions>
<ModelVariables>
<UInt64 name="n" valueReference="1" causality="structuralParameter" start="2" min="1" max="4"/>
<Float64 name="A" valueReference="2" causality="parameter" start="0 0" min="-1" max="5">
<Dimension valueReference="1"/></Float64>
<Float64 name="u" valueReference="3" causality="input" start="0"><Alias name="drive"/></Float64>
<Float64 name="x" valueReference="4" causality="output" initial="exact" start="0"/>
<Float64 name="der(x)" valueReference="5" derivative="4"/>
<Int32 name="count" valueReference="6" causality="parameter" start="2" min="1" max="4"/>
<Enumeration name="gear" valueReference="7" causality="parameter" start="1" declaredType="Gear"/>
<Clock name="tick" valueReference="8" causality="output" intervalVariability="triggered"/>
<Int32 name="ticks" valueReference="9" causality="output" variability="discrete" clocks="8"/>
<Float64 name="time" valueReference="10" causality="independent"/>
</ModelVariables>
<ModelStructure><Output valueReference="4"/><Output valueReference="8"/><Output valueReference="9"/>
<ContinuousStateDerivative valueReference="5" dependencies="3 4" dependenciesKind="fixed fixed"/>
<InitialUnknown valueReference="5"/></ModelStructure></fmiModelDescription>"""
TERMINALS = """<fmiTerminalsAndIcons fmiVersion="3.0"><Terminals>
<Terminal name="flange" matchingRule="plug">
<TerminalMemberVariable variableName="drive" memberName="force" variableKind="signal"/>
</Terminal></Terminals></fmiTerminalsAndIcons>"""


def found(description, terminals=TERMINALS):
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("modelDescription.xml", description)
        archive.writestr("sources/part.c", "int part;")
        archive.writestr("terminalsAndIcons/terminalsAndIcons.xml", terminals)
    file.seek(0)
    return [(one.rule, one.place, one.found) for one in examine(file) if one.level != OWN]


def test_sound_description_has_no_fault():
    assert found(SOUND) == []


@pytest.mark.parametrize(
    ("sound", "faulty", "expected"),
    [
        ('start="2" min="1" max="4"/>\n<Enum', 'start="9" min="1" max="4"/>\n<Enum',
         ("bounds", "variable 'count'", "min, start and max do not rise: [1.0, 9.0, 4.0]")),
        ('start="0 0"', 'start="0 7"',
         ("bounds", "variable 'A'", "min, start and max do not rise: [-1.0, 7.0, 5.0]")),
        ('start="0 0"', 'start="0 NaN"',
         ("number", "variable 'A'", "start = 0 NaN is no finite number")),
        ('start="0 0"', 'start="0 0 0"',
         ("structure", "variable 'A'", "it has 3 start values, not 2")),
        ('start="1" declaredType', 'start="2" declaredType',
         ("structure", "gear", "its start value 2 is no item of type 'Gear'")),
        ('declaredType="Gear"', 'declaredType="Gears"',
         ("structure", "gear", "its type 'Gears' is not described, or not of Enumeration")),
        ('declaredType="Gear"', 'declaredType="Length"',
         ("structure", "gear", "its type 'Length' is not described, or not of Enumeration")),
        ('<Dimension valueReference="1"/>', '<Dimension valueReference="77"/>',
         ("structure", "Dimension", "valueReference 77 is that of no UInt64")),
        ('clocks="8"', 'clocks="6"', ("structure", "ticks", "clocks 6 is that of no Clock")),
        ('clocks="8"', 'clocks="8 77"', ("structure", "ticks", "clocks 77 is that of no Clock")),
        ('clocks="8"', 'clocks="8" previous="77"',
         ("structure", "ticks", "previous 77 is that of no variable")),
        ("</ModelStructure>", '<EventIndicator valueReference="77"/></ModelStructure>',
         ("structure", "EventIndicator", "valueReference 77 is that of no variable")),
        ('<Alias name="drive"/>', '<Alias name="drive"/><Alias name="x"/>',
         ("name", "variable 'x'", "2 variables have this name")),
        ('"fixed fixed"', '"fixed"',
         ("structure", "Derivatives", "'der(x)' has 2 dependencies of 1 kinds")),
        ('dependencies="3 4" ', "",
         ("structure", "Derivatives", "'der(x)' has 0 dependencies of 2 kinds")),
    ],
)  # fmt: skip
def test_part_that_does_not_fit_is_the_only_fault(sound, faulty, expected):
    assert SOUND.count(sound) == 1
    assert found(SOUND.replace(sound, faulty)) == [expected]  # before: none


def test_member_of_a_terminal_that_is_no_variable_is_named():
    (fault,) = found(SOUND, TERMINALS.replace('"drive"', '"drives"'))
    assert fault[0] == "structure"
    assert fault[2] == "TerminalMemberVariable 'drives' is no variable"
