"""Files with variables of every type and without nominal values: described, set, connected."""

import zipfile

import pytest
from helpers.described_files import described_file

import cosim
from cosim.cli.arguments import value_of_fmu
from cosim.cli.main import main
from cosim.errors import FmuError, ParameterError, UsageError

DESCRIPTION = """<fmiModelDescription fmiVersion="3.0" modelName="part" instantiationToken="1">
  <{kind} modelIdentifier="part"/>
  <ModelVariables>
    <Float64 name="x" valueReference="1" causality="output"/>
    <Float64 name="tiny" valueReference="2" causality="input" start="5e-17"/>
    <Int32 name="count" valueReference="3" causality="input" start="2"/>
    <Boolean name="on" valueReference="4" causality="input"><Start value="true"/></Boolean>
    <String name="label" valueReference="5" causality="input"><Start value="007"/></String>
    <Float64 name="y" valueReference="6" causality="output"><Dimension start="3"/></Float64>
    <Int32 name="n" valueReference="7" causality="output"/>
    <Binary name="blob" valueReference="8" causality="input"/>
  </ModelVariables>
  <ModelStructure>
    <Output valueReference="1"/><Output valueReference="6"/><Output valueReference="7"/>
  </ModelStructure>
</fmiModelDescription>"""


@pytest.fixture
def written(tmp_path):
    """Return a function that writes the file for an interface."""

    def write(kind="CoSimulation", name="part"):
        path = tmp_path / f"{name}.fmu"
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("modelDescription.xml", DESCRIPTION.format(kind=kind))
        return path

    return write


@pytest.mark.parametrize("fmi", [2, 3])
def test_info_shows_a_file_without_nominal_values(fmi, tmp_path):
    text = str(cosim.info(described_file(tmp_path / "a.fmu", "m", 'm="1"', fmi=fmi)))
    assert "u     m     m         0" in text


def test_info_shows_variables_of_every_type(written, capsys):
    path = written()
    assert main(["info", str(path)]) == 0
    shown = {line.split()[0]: line.split() for line in capsys.readouterr().out.splitlines() if line}
    assert shown["tiny"][3] == "0"
    assert shown["count"][3] == "2"
    assert shown["label"][3] == "007"
    assert main(["info", str(path), "--json"]) == 0


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("9007199254740993", 2**53 + 1),
        ("18446744073709551615", 2**64 - 1),
        ("-3", -3),
        ("1e3", 1000.0),
        (".5", 0.5),
        ("true", "true"),
        ("Option 2", "Option 2"),
        ("infrared", "infrared"),
    ],
)
def test_value_on_the_command_line_keeps_its_digits_and_words(text, expected):
    found = value_of_fmu("u", text)
    assert found == expected
    assert type(found) is type(expected)


@pytest.mark.parametrize("text", ["3deg", "1.5 m", "-2rpm", "3 items"])
def test_unit_on_the_command_line_is_rejected_for_files(text):
    with pytest.raises(ParameterError, match="give a number in the FMU's own unit"):
        value_of_fmu("u", text)


@pytest.mark.parametrize(
    ("connection", "reason"),
    [
        ({"b.count": "a.x"}, r"a.x \(Float64\) cannot drive b.count \(Int32\)"),
        ({"b.on": "a.x"}, r"cannot drive b.on \(Boolean\)"),
        ({"b.label": "a.x"}, r"a.x \(Float64\) cannot drive b.label \(String\)"),
        ({"b.blob": "a.x"}, "b.blob is of type Binary, which connections do not carry"),
        ({"b.tiny": "a.y"}, r"a.y is an array; connect its elements, such as a.y\[1\]"),
        ({"b.x": "a.x"}, "b.x is no input; connect an input: tiny, count, on"),
    ],
)
def test_connection_of_another_type_is_rejected_with_the_type(connection, reason, written):
    with pytest.raises(UsageError, match=reason):
        cosim.couple({"a": written(), "b": written(name="other")}, connection)


def test_text_cannot_be_recorded_in_a_system(written):
    with pytest.raises(UsageError, match=r"a\.label is not a single number"):
        cosim.couple({"a": written()}, {}).simulate(outputs=["a.label"])


def test_file_that_cannot_be_a_part_says_for_what_it_is(written):
    reason = "scheduled execution only, .*; export it for co-simulation or model exchange$"
    with pytest.raises(UsageError, match=reason):
        cosim.couple({"a": written("ScheduledExecution")}, {})


def test_file_for_scheduled_execution_is_rejected_alone(written):
    with pytest.raises(FmuError, match="offers scheduled execution only"):
        cosim.simulate_fmu(written("ScheduledExecution"))
