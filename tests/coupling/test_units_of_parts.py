"""Units of connections and values by the definitions of the files that use them."""

import numpy as np
import pytest
from helpers.described_files import described_file

import cosim
from cosim.coupling.connectors import Connector, End, with_outputs
from cosim.errors import ParameterError, UsageError
from cosim.fmi.archive import unpacked
from cosim.fmi.run.description import by_name, read_description
from cosim.fmi.run.request import column_of
from cosim.trajectory import Column, Trajectory

PRESSURE, POWER, TIME = 'kg="1" m="-1" s="-2"', 'kg="1" m="2" s="-3"', 's="-1"'


@pytest.fixture
def factors(tmp_path):
    """Return a function: factor and offset of the connection of two units."""

    def found(source, source_base, target, target_base, **facts):
        first = described_file(tmp_path / "a.fmu", source, source_base, **facts)
        second = described_file(tmp_path / "b.fmu", target, target_base, **facts)
        [wire] = cosim.couple({"a": first, "b": second}, {"b.u": "a.y"}).connections
        return wire.factor, wire.offset

    return found


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize(
    ("source", "source_base", "target", "target_base", "expected"),
    [
        ("Pa", PRESSURE, "bar", f'{PRESSURE} factor="1e5"', (1e-5, 0)),
        ("W", POWER, "kW", f'{POWER} factor="1000"', (1e-3, 0)),
        ("m3/s", f'm="3" {TIME}', "l/h", f'm="3" {TIME} factor="2.777777777777778e-7"', (3.6e6, 0)),
        ("%", 'factor="0.01"', "1", "", (0.01, 0)),
        ("K", 'K="1"', "degC", 'K="1" offset="273.15"', (1, -273.15)),
        ("degC", 'K="1" offset="273.15"', "degF", 'K="1" factor="0.5555555555555556" '
         'offset="255.3722222222222"', (1.8, 32)),
        ("u", 'm="1" factor="0.001"', "u", 'm="1"', (0.001, 0)),  # one name, two definitions
        ("rpm", 'm="1"', "m", 'm="1"', (1, 0)),  # the file decides what rpm is
    ],
)  # fmt: skip
def test_connection_converts_by_the_definitions_in_the_files(
    factors, fmi, source, source_base, target, target_base, expected
):
    found = factors(source, source_base, target, target_base, fmi=fmi)
    assert found == pytest.approx(expected, rel=1e-13, abs=1e-12)  # measured 2e-16, 6e-14


def test_model_in_kelvin_drives_a_file_in_degrees_celsius(tmp_path):
    model = cosim.Model("room")
    temperature = model.state("temperature", "K", 293.15, "temperature")
    model.derivative(temperature, 0)
    file = described_file(tmp_path / "b.fmu", "degC", 'K="1" offset="273.15"')
    [wire] = cosim.couple({"a": model.freeze(), "b": file}, {"b.u": "a.temperature"}).connections
    assert (wire.factor, wire.offset) == (1.0, -273.15)


def test_units_of_different_dimensions_are_rejected_with_both_variables(factors):
    with pytest.raises(UsageError, match=r"a\.y \[x\] cannot drive b\.u \[x\]: not the same kind"):
        factors("x", 'm="1"', "x", 'kg="1"')
    with pytest.raises(UsageError, match=r"a\.y \[N.m\] cannot drive b\.u \[rad\]"):
        factors("N.m", POWER, "rad", 'rad="1"')


def test_offset_of_a_relative_quantity_does_not_count(factors):
    kelvin, celsius = 'K="1"', 'K="1" offset="273.15"'
    found = factors("K", kelvin, "degC", celsius, facts=' relativeQuantity="true"')
    assert found == (1.0, 0.0)


RELATIVE = ' relativeQuantity="true"'


@pytest.mark.parametrize("display", ["", '<DisplayUnit name="degC" offset="-273.15"/>'])
@pytest.mark.parametrize(("text", "kelvin"), [("5 degC", 5.0), ("9 degF", 5.0), ("5 K", 5.0)])
def test_value_of_a_relative_quantity_is_a_difference_in_every_unit(
    tmp_path, display, text, kelvin
):
    file = described_file(tmp_path / "a.fmu", "K", 'K="1"', display=display, facts=RELATIVE)
    system = cosim.couple({"a": file}, {}, start_values={"a.u": text})
    assert system.start_values["a", "u"] == pytest.approx(kelvin, rel=1e-14)


def test_relative_quantity_is_the_same_after_writing_and_reading_an_ssp_file(tmp_path):
    base = 'K="1" offset="273.15"'
    file = described_file(tmp_path / "a.fmu", "degC", base, facts=RELATIVE)
    system = cosim.couple({"a": file}, {}, start_values={"a.u": 5.0})
    again = cosim.read_ssp(system.write_ssp(tmp_path / "a.ssp"))
    assert again.start_values == {("a", "u"): 5.0}


def test_display_unit_of_a_relative_quantity_without_definition_has_no_offset(tmp_path):
    facts = f'{RELATIVE} displayUnit="degC"'
    with unpacked(described_file(tmp_path / "a.fmu", "K", 'K="1"', facts=facts)) as folder:
        description = read_description(folder, "a.fmu")
    column = column_of(by_name(description)["y"], description)
    assert (column.shown_unit, column.shown(5.0)) == ("degC", 5.0)


@pytest.mark.parametrize(("unit", "kelvin"), [("degC", 5.0), ("K", 5.0), ("degF", 5.0 / 1.8)])
def test_column_of_a_csv_file_is_a_difference_where_the_variable_is_one(tmp_path, unit, kelvin):
    path = described_file(tmp_path / "a.fmu", "K", 'K="1"', facts=RELATIVE)
    with unpacked(path) as folder:
        description = read_description(folder, "a.fmu")
    column = column_of(by_name(description)["y"], description)
    like = Trajectory("a", [0.0], (column,), [[0.0]])
    (tmp_path / "a.csv").write_text(f"time,y [{unit}]\n0,5\n")
    read = Trajectory.read_csv(tmp_path / "a.csv", like=like)
    assert read["y"] == pytest.approx([kelvin], rel=1e-14)


def test_unit_that_a_file_does_not_define_has_its_usual_meaning(factors):
    assert factors("bar", None, "Pa", PRESSURE) == (1e5, 0.0)


def test_unit_without_any_definition_is_not_converted(factors):
    assert factors("widget", None, "m", 'm="1"') == (1.0, 0.0)


@pytest.mark.parametrize(
    ("text", "value"),
    [("3 u", 3.0), ("30 cm", 3.0), ("2 w", 7.0), (3, 3.0)],
)
def test_value_may_have_a_unit_of_the_file_or_a_known_one(tmp_path, text, value):
    display = '<DisplayUnit name="w" factor="0.5" offset="-1.5"/>'
    file = described_file(tmp_path / "a.fmu", "u", 'm="1" factor="0.1"', display=display)
    system = cosim.couple({"a": file}, {}, start_values={"a.u": text})
    assert system.start_values["a", "u"] == pytest.approx(value, rel=1e-15)
    with pytest.raises(ParameterError, match=r"a\.u = 3 kg: 'kg' cannot be converted to 'u'"):
        cosim.couple({"a": file}, {}, start_values={"a.u": "3 kg"})


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize(
    ("unit", "base", "display", "value", "shown"),
    [
        ("rad", 'rad="1"', 'name="grad" factor="63.66197723675814"', 2.0, 127.32395447351628),
        ("Pa", PRESSURE, 'name="mbar" factor="0.01"', 5000.0, 50.0),
        ("K", 'K="1"', 'name="degC" offset="-273.15"', 300.0, 26.85),
        ("K", 'K="1"', 'name="degF" factor="1.8" offset="-459.67"', 300.0, 80.33),
        ("x", 'm="1"', 'name="deg" factor="2"', 3.0, 6.0),  # a name that means something else
    ],
)
def test_display_unit_has_factor_and_offset_of_the_file(
    tmp_path, fmi, unit, base, display, value, shown
):
    name = display.split('"')[1]
    facts = f' displayUnit="{name}"'
    display = f"<DisplayUnit {display}/>"
    path = described_file(tmp_path / "a.fmu", unit, base, display=display, facts=facts, fmi=fmi)
    with unpacked(path) as folder:
        description = read_description(folder, path)
    column = column_of(by_name(description)["y"], description)
    assert column.shown_unit == name
    assert column.shown(value) == pytest.approx(shown, rel=1e-13)  # measured 5e-16
    assert column.shown(1.0, difference=True) == pytest.approx(
        column.shown(value + 1) - column.shown(value), rel=1e-11
    )  # measured 3e-13


def test_display_unit_that_is_a_reciprocal_is_not_used(tmp_path):
    display = '<DisplayUnit name="s" inverse="true"/>'
    facts = ' displayUnit="s"'
    path = described_file(tmp_path / "a.fmu", "Hz", TIME, display=display, facts=facts, fmi=3)
    with unpacked(path) as folder:
        description = read_description(folder, path)
    assert column_of(by_name(description)["y"], description).shown_unit == "Hz"


def test_output_of_the_system_in_another_unit_is_not_shown_as_that_of_the_part():
    column = Column("a.T", "K", "C", display_factor=1.0, display_offset=-273.15)
    run = Trajectory("room", np.zeros(1), (column,), np.full((1, 1), 300.0), {})
    shown = Connector("T", "degC", is_input=False, ends=(End(("a", "T"), 1.0, -273.15),))
    own, whole = with_outputs(run, {"T": shown}, None).columns
    assert own.shown(300.0) == pytest.approx(26.85, rel=1e-13)
    assert (whole.shown_unit, whole.shown(26.85)) == ("degC", 26.85)
