"""Units in SSP files: of connectors, of the file and of its FMUs."""

import pytest
from helpers.described_files import described_file
from helpers.ssp_files import component, connection, description, ends, package, system, values

import cosim
from cosim.coupling.connectors import End
from cosim.errors import UsageError

SOURCE = component("s", "source")


def test_units_are_converted_along_connectors_of_systems(read):
    one = '<ssc:LinearTransformation offset="1"/>'
    inner = (
        '<ssd:System name="q"><ssd:Connectors><ssd:Connector name="in" kind="input">'
        '<ssc:Real unit="mm"/></ssd:Connector></ssd:Connectors><ssd:Elements>'
        f"{component('g', 'gain')}</ssd:Elements><ssd:Connections>"
        f"{connection('in', 'g.u', one)}</ssd:Connections></ssd:System>"
    )
    shift = '<ssc:LinearTransformation offset="500"/>'  # mm
    found = read(system("S", SOURCE + inner, connection("s.y", "q.in", shift)))
    assert ends(found) == {"q_g.u": ("s.y", 1, 1.5)}  # (1000 y + 500) / 1000 + 1
    plain = connection("s.y", "q.in", suppressUnitConversion="true")
    found = read(system("S", SOURCE + inner, plain))
    assert ends(found) == {"q_g.u": ("s.y", 0.001, 1)}  # y m are y mm


FURLONG = '<ssc:Unit name="{}"><ssc:BaseUnit m="1" factor="201.168"/></ssc:Unit>'


def units(name, prefix="ssd"):
    return f"<{prefix}:Units>{FURLONG.format(name)}</{prefix}:Units>"


@pytest.mark.parametrize("name", ["furlong", "km"])
def test_units_that_the_file_defines_are_converted(read, name):
    """Connectors of the system in a unit of the file set a parameter in m, and show an output."""
    wires = connection("K", "s.a") + connection("s.y", "out")
    whole = system("S", SOURCE, wires, kinds={"K": "parameter", "out": "output"})
    whole = whole.replace("<ssc:Real/>", f'<ssc:Real unit="{name}"/>', 2)
    system_ = read(whole, units(name))
    final = system_.simulate(start_values={"K": 2.0}, macro_step=0.5).final
    assert final["s.y"] == pytest.approx(2 * 201.168 + 1, rel=1e-12)
    assert final["out"] == pytest.approx(2 + 1 / 201.168, rel=1e-12)
    final = system_.simulate(start_values={"K": f"2 {name}"}, macro_step=0.5).final
    assert final["s.y"] == pytest.approx(2 * 201.168 + 1, rel=1e-12)


@pytest.mark.parametrize("name", ["furlong", "m"])  # m also has the usual meaning in the FMU
@pytest.mark.parametrize("place", ["description", "set"])
def test_value_in_a_unit_that_the_file_defines_is_converted(read, name, place):
    bound = values(a=2).replace('value="2"', f'value="2" unit="{name}"')
    if place == "set":
        own = units(name, "ssv")
        bound = bound.replace("</ssv:ParameterSet>", f"{own}</ssv:ParameterSet>")
    whole = system("S", component("s", "source", bound))
    found = read(whole, units(name) if place == "description" else "")
    assert found.start_values == {("s", "a"): pytest.approx(2 * 201.168, rel=1e-15)}


def test_units_are_converted_by_the_definitions_of_the_fmus(tmp_path):
    files = [
        described_file(tmp_path / f"{name}.fmu", unit, base)
        for name, unit, base in (("gain", "a", 'm="1" factor="3"'), ("source", "b", 'm="1"'))
    ]
    parts = component("s", "source", kinds={}) + component("g", "gain", kinds={})
    whole = description(system("S", parts, connection("g.y", "s.u")))
    found = cosim.read_ssp(package(tmp_path / "case.ssp", files, whole))
    assert ends(found) == {"s.u": ("g.y", 3, 0)}


def test_units_of_fmus_are_written(tmp_path):
    parts = {
        name: described_file(tmp_path / f"{name}.fmu", unit, base)
        for name, unit, base in (
            ("g", "a", 'm="1" factor="3"'),
            ("s", "b", 'm="1"'),
            ("w", "c", None),
        )
    }
    path = cosim.couple(parts, {"s.u": "g.y"}).write_ssp(tmp_path / "case.ssp")
    assert ends(cosim.read_ssp(path)) == {"s.u": ("g.y", 3, 0)}
    parts["x"] = described_file(tmp_path / "x.fmu", "a", 'm="1" factor="4"')
    with pytest.raises(UsageError, match="two FMUs define the unit 'a' differently"):
        cosim.couple(parts, {}).write_ssp(tmp_path / "case.ssp")


def test_unit_that_is_no_definition_is_rejected(read):
    wrong = units("furlong").replace('"201.168"', '"two"')
    with pytest.raises(UsageError, match=r"SystemStructure\.ssd: unit 'furlong' has a factor"):
        read(system("S", SOURCE), wrong)


@pytest.mark.parametrize("unit", [None, "degC", "K"])
@pytest.mark.parametrize("connector", [None, "degC", "K"])
def test_connector_of_a_relative_quantity_has_differences(tmp_path, connector, unit):
    """A difference of 5 K into a part, and that of its output, out of it."""
    facts = ' relativeQuantity="true"'
    file = described_file(tmp_path / "gain.fmu", "K", 'K="1"', facts=facts)
    number = values(**{"in": 5})
    if unit:
        number = number.replace('value="5"', f'value="5" unit="{unit}"')
    whole = system(
        "S",
        component("g", "gain", kinds={}),
        connection("in", "g.u") + connection("g.y", "out"),
        kinds={"unit": connector, "in": "input", "out": "output"},
        bindings=number,
    )
    found = cosim.read_ssp(package(tmp_path / "case.ssp", [file], description(whole)))
    assert found.start_values == {("g", "u"): 5.0}
    for name, variable in (("in", "u"), ("out", "y")):
        assert found.connectors[name].ends == (End(("g", variable), 1.0, 0.0),)
