"""Units of values, of files of inputs and of measurements that meet an FMU, whose file decides."""

import json
from xml.etree import ElementTree as ET

import pytest
from helpers.fmu_files import with_description

import cosim
from cosim.cli.main import main
from cosim.errors import ParameterError, UnknownName
from cosim.study.fit.subject import FmuSubject


@pytest.fixture(scope="module")
def oven(tmp_path_factory):
    """Return an FMU with units that are not SI: T' = (surroundings - T) rate + load."""
    model = cosim.Model("oven", stop_time=2.0, output_interval=0.5)
    T = model.state("T", "degC", 20.0, "temperature")
    rate = model.parameter("rate", "1/s", 0.5, "rate", minimum=0.1, maximum=2.0)
    surroundings = model.input("surroundings", "degC", 20.0, "surroundings")
    load, volume = model.input("load", "%", 0.0, "load"), model.input("volume", "m3", 0.0, "volume")
    model.derivative(T, rate * (surroundings - T) + load)
    model.output("filled", "m3", 1 * volume, "volume")
    turning = model.state("turning", "rad/s", 1.0, "speed")
    model.derivative(turning, 0)
    return cosim.export_fmu(model.freeze(), tmp_path_factory.mktemp("oven") / "oven.fmu")


@pytest.fixture(scope="module")
def with_gallons(oven):
    """Return that FMU with a display unit, the gallon of another country."""

    def define(root):
        unit = root.find("UnitDefinitions/Unit[@name='m3']")
        ET.SubElement(unit, "DisplayUnit", name="gal", factor="219.96924829908778")

    return with_description(oven, oven.with_name("gallons.fmu"), define)


@pytest.mark.parametrize("name", ["nope", "rate"])
def test_name_of_no_input_is_rejected_before_its_unit(oven, name):
    with pytest.raises(UnknownName, match=f"no input '{name}'; it has surroundings, load, volume"):
        cosim.simulate_fmu(oven, inputs={name: "3m"})


def test_constant_input_may_have_a_unit_of_the_file(with_gallons):
    run = cosim.simulate_fmu(with_gallons, inputs={"volume": "1gal"}, stop_time=0.5)
    assert run["filled"][-1] == pytest.approx(0.00454609, rel=1e-12)
    system = cosim.couple({"a": with_gallons}, {})
    run = system.simulate(inputs={"a.volume": "1 gal"}, stop_time=0.5, macro_step=0.5)
    assert run["a.filled"][-1] == pytest.approx(0.00454609, rel=1e-12)


@pytest.mark.parametrize("law", ["1m^3*(1 + 0*t)", "where(t < 1s, 2, 3)"])
def test_formula_with_units_is_none_in_a_unit_of_the_file_that_is_not_si(oven, law):
    def define(root):
        unit = ET.SubElement(root.find("UnitDefinitions"), "Unit", name="barrel")
        ET.SubElement(unit, "BaseUnit", m="3", factor="0.158987294928")
        (volume,) = root.findall("ModelVariables/ScalarVariable[@name='volume']")
        volume[0].set("unit", "barrel")

    path = with_description(oven, oven.with_name("barrels.fmu"), define)
    system = cosim.couple({"a": path}, {})
    span = {"stop_time": 0.5, "macro_step": 0.5}
    for call in (
        lambda law: cosim.simulate_fmu(path, inputs={"volume": law}, stop_time=0.5)["filled"],
        lambda law: system.simulate(inputs={"a.volume": law}, **span)["a.filled"],
    ):
        assert call("2e1*t")[-1] == pytest.approx(10.0)
        assert call("1m^3")[-1] == pytest.approx(1 / 0.158987294928)
        with pytest.raises(ParameterError, match="is in barrel; write all numbers without units"):
            call(law)


@pytest.mark.parametrize("header", ["time,load\ns,%", "time,load [%]"])
def test_file_of_inputs_of_an_fmu_has_no_units(oven, header, tmp_path, capsys):
    (tmp_path / "load.csv").write_text(f"{header}\n0,5\n2,5\n")
    line = ["simulate", str(oven), "--trust", "--input-file", str(tmp_path / "load.csv")]
    assert main(line) == 2
    assert "load has the unit of the FMU; leave the unit out" in capsys.readouterr().err


def test_command_fits_an_fmu_to_measurements_in_other_units(oven, tmp_path, capsys):
    true = cosim.simulate_fmu(oven, start_values={"surroundings": 40.0, "rate": 0.7})
    rows = [
        f"{t!r},{1.8 * T + 32!r}"
        for t, T in zip(true.time.tolist(), true["T"].tolist(), strict=True)
    ]
    (tmp_path / "d.csv").write_text("time,T [degF]\n" + "\n".join(rows) + "\n")
    line = ["fit", str(oven), str(tmp_path / "d.csv"), "--trust", "--free", "rate,surroundings"]
    assert main([*line, "--noise", "T=0.18degF", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["values"] == pytest.approx({"rate": 0.7, "surroundings": 40.0}, rel=1e-6)
    assert found["noise"] == pytest.approx({"T": 0.1})


def test_unit_and_bounds_of_a_type_are_those_of_its_variables(oven):
    def move(root):
        for variable in root.iter("ScalarVariable"):
            if variable.get("name") in ("turning", "rate"):
                real = variable[0]
                for name in ("unit", "min", "max"):
                    real.attrib.pop(name, None)
                real.set("declaredType", f"type of {variable.get('name')}")
        types = root.find("TypeDefinitions")
        for name, facts in (
            ("turning", {"unit": "rad/s"}),
            ("rate", {"unit": "1/s", "min": "0.1", "max": "2"}),
        ):
            ET.SubElement(ET.SubElement(types, "SimpleType", name=f"type of {name}"), "Real", facts)

    path = with_description(oven, oven.with_name("typed.fmu"), move)
    found = cosim.sweep(path, {"turning": [1.0, 2.0]}, outputs=["T"], stop_time=0.5, workers=0)
    assert found.to_xarray()["turning"].attrs["units"] == "rad/s"
    known = FmuSubject(str(path), {}).known("rate")
    assert (known.minimum, known.maximum, known.column.unit) == (0.1, 2.0, "1/s")
