"""SSP files: valid by schema, with units, read by FMPy; values inside or in files of their own."""

import zipfile
from dataclasses import replace
from pathlib import Path

import fmpy
import pytest
from fmpy.ssp.ssd import read_ssd
from helpers.small_models import decay
from helpers.typed_part import typed_part
from lxml import etree

import cosim
from casadi_models.dae import Model
from cosim.errors import ParameterError, UsageError
from cosim.fmi.export.package import zipped

SCHEMAS = Path(fmpy.__file__).parent / "ssp" / "schema"
SSD = "{http://ssp-standard.org/SSP1/SystemStructureDescription}"
SSC = "{http://ssp-standard.org/SSP1/SystemStructureCommon}"
SSV = "{http://ssp-standard.org/SSP1/SystemStructureParameterValues}"
WRITTEN = pytest.mark.parametrize("own_files", [False, True])


@pytest.fixture(scope="module")
def fmu(tmp_path_factory):
    return cosim.export_fmu(decay(), tmp_path_factory.mktemp("ssp") / "decay.fmu", valid=False)


def written(fmu, folder, own_files):
    path = cosim.write_ssp(
        folder / "two.ssp",
        {"a": fmu, "b": fmu},
        [("a.y", "b.force")],
        values={"a.x": 2.0, "b.rate": 0.25},
        stop_time=1.0,
        parameter_files=own_files,
    )
    with zipfile.ZipFile(path) as archive:
        return path, {name: archive.read(name) for name in archive.namelist()}


def valid(content, schema):
    root = etree.fromstring(content)
    etree.XMLSchema(etree.parse(SCHEMAS / schema)).assertValid(root)
    return root


@WRITTEN
def test_it_is_valid_and_every_connector_and_value_has_its_unit(fmu, tmp_path, own_files):
    _, files = written(fmu, tmp_path, own_files)
    root = valid(files["SystemStructure.ssd"], "SystemStructureDescription.xsd")
    units = {c.get("name"): c[0].get("unit") for c in root.iter(f"{SSD}Connector")}
    assert units == {"x": "m", "y": "m", "force": "m/s", "rate": "1"}
    defined = root.find(f"{SSD}Units")
    assert {u.get("name") for u in defined} >= set(units.values())
    (speed,) = (u for u in defined if u.get("name") == "m/s")
    assert dict(speed.find(f"{SSC}BaseUnit").attrib) == {"m": "1", "s": "-1"}
    sets = list(root.iter(f"{SSV}ParameterSet"))
    if own_files:
        schema = "SystemStructureParameterValues.xsd"
        sets = [valid(files[f"resources/{name}.ssv"], schema) for name in "ab"]
    values = [
        (p.get("name"), float(p[0].get("value")), p[0].get("unit"))
        for one in sets
        for p in one.iter(f"{SSV}Parameter")
    ]
    assert values == [("x", 2.0, "m"), ("rate", 0.25, "1")]
    sources = [b.get("source") for b in root.iter(f"{SSD}ParameterBinding")]
    assert sources == (["resources/a.ssv", "resources/b.ssv"] if own_files else [None, None])


@WRITTEN
def test_fmpy_reads_it(fmu, tmp_path, own_files):
    path, _ = written(fmu, tmp_path, own_files)
    system = read_ssd(str(path)).system
    assert [element.name for element in system.elements] == ["a", "b"]
    bindings = [element.parameterBindings for element in system.elements]
    read = [p.name for own in bindings for b in own for p in b.parameterValues[0].parameters]
    assert read == ["x", "rate"]


def test_files_with_structured_names_are_written_with_these_and_read_again(tmp_path):
    path = cosim.export_fmu(cosim.load("bar_on_frame"), tmp_path / "bar.fmu", names="structured")
    system = cosim.couple(
        {"a": path, "b": path}, {"b.T2": "a.tk_G_F"}, start_values={"a.theta_dot": 2.0, "b.m": 1.0}
    )
    file = system.write_ssp(tmp_path / "two.ssp")
    with zipfile.ZipFile(file) as archive:
        root = etree.fromstring(archive.read("SystemStructure.ssd"))
    (connection,) = root.iter(f"{SSD}Connection")
    assert connection.get("startConnector") == "G.t_F[3]"  # as in the FMU
    assert "G.t_F[3]" in {c.get("name") for c in root.iter(f"{SSD}Connector")}
    runs = [one.simulate(stop_time=0.1) for one in (system, cosim.read_ssp(file))]
    assert cosim.compare(*runs).worst.scaled == 0


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), 0.0, -1.0, "1"])
def test_stop_time_that_is_no_positive_number_is_rejected(fmu, tmp_path, bad):
    with pytest.raises(ParameterError, match="write_ssp: stop_time = "):
        cosim.write_ssp(tmp_path / "one.ssp", {"a": fmu}, [], stop_time=bad)
    assert not (tmp_path / "one.ssp").exists()


def test_elements_of_arrays_are_connectors_and_values(tmp_path):
    fmu = typed_part(tmp_path)  # x' = u, y = x, with two components
    parts, wires = {"a": fmu, "b": fmu}, [("a.y[1]", "b.u[2]")]
    path = cosim.write_ssp(
        tmp_path / "two.ssp", parts, wires, values={"a.u[1]": 2.0}, stop_time=1.0
    )
    system = cosim.read_ssp(path)
    assert {*system.parts} == {"a", "b"}
    final = system.simulate(macro_step=0.1, method="jacobi").final
    assert final["a.y[1]"] == pytest.approx(2.0, rel=1e-12)
    assert final["b.u[2]"] == final["a.y[1]"]
    assert final["a.y[2]"] == final["b.y[1]"] == 0.0


def test_parts_whose_names_differ_in_case_or_are_no_file_names_have_files_of_their_own(
    fmu, tmp_path
):
    names = "A", "a", "a#b", "a b", "50%"
    path = cosim.write_ssp(tmp_path / "odd.ssp", dict.fromkeys(names, fmu), [])
    with zipfile.ZipFile(path) as archive:
        files = sorted(archive.namelist())
    assert files[1:] == [f"resources/{n}.fmu" for n in ("50_", "A", "a_", "a_b", "a_b_")]
    assert len(cosim.read_ssp(path).parts) == len(names)  # before: an entry occurs twice


@pytest.mark.parametrize("value", [float("nan"), "fast", None])
def test_values_that_are_none_of_the_variable_are_refused(fmu, tmp_path, value):
    with pytest.raises(ParameterError, match="write_ssp: rate = "):
        cosim.write_ssp(tmp_path / "s.ssp", {"a": fmu}, [], values={"a.rate": value})


@pytest.mark.parametrize(
    ("change", "kind", "words"),
    [
        ({"a.force": (2.0, 0.0)}, UsageError, r"a\.force has no connections"),
        ({"b.force": (float("nan"), 0.0)}, ParameterError, r"b\.force = nan is not finite"),
        ({"b.force": (2.0, "1")}, ParameterError, r"b\.force = '1' is not a real number"),
        ({"b.force": 2.0}, UsageError, r"give pairs \(FACTOR, OFFSET\)"),
        ({"b.force": (1.0, 2.0, 3.0)}, UsageError, r"give pairs \(FACTOR, OFFSET\)"),
    ],
)
def test_transformation_that_no_connection_can_have_is_refused(fmu, tmp_path, change, kind, words):
    place, parts = tmp_path / "s.ssp", {"a": fmu, "b": fmu}
    with pytest.raises(kind, match=f"write_ssp: .*{words}"):  # before: left out, or written
        cosim.write_ssp(place, parts, [("a.y", "b.force")], transformations=change)
    assert not place.exists()


def test_input_that_is_connected_twice_is_refused(fmu, tmp_path):
    wires = [("a.x", "b.force"), ("a.y", "b.force")]
    with pytest.raises(UsageError, match=r"b\.force has 2 connections"):
        cosim.write_ssp(tmp_path / "s.ssp", {"a": fmu, "b": fmu}, wires)


def test_open_inputs_keep_their_start_values_of_every_type(tmp_path):
    inputs = (("Int64", "n", "9007199254740993"), ("Float64", "u", "0.1"), ("Boolean", "b", "true"))
    rows = [f'<{k} name="{n}" causality="input" start="{v}"/>' for k, n, v in inputs]
    rows[1] = rows[1].replace(" name", ' unit="bar" name')  # that the file does not define
    rows.append('<String name="s" causality="input"><Start value="none"/></String>')
    rows = [row.replace(" name", f' valueReference="{i}" name', 1) for i, row in enumerate(rows)]
    description = f"""<fmiModelDescription fmiVersion="3.0" modelName="m" instantiationToken="t">
    <CoSimulation modelIdentifier="m"/><ModelVariables>{"".join(rows)}</ModelVariables>
    <ModelStructure/></fmiModelDescription>"""
    fmu = tmp_path / "m.fmu"
    fmu.write_bytes(zipped({"modelDescription.xml": description.encode()}))
    every = [f"a.{name}" for name in "nubs"]
    path = cosim.write_ssp(tmp_path / "s.ssp", {"a": fmu}, [], open_inputs=every)
    with zipfile.ZipFile(path) as archive:
        root = valid(archive.read("SystemStructure.ssd"), "SystemStructureDescription.xsd")
    written = [p[0].get("value") for p in root.iter(f"{SSV}Parameter")]
    assert written == ["9007199254740993", "0.1", "true", "none"]  # before: ...992 and 0.0
    (bar,) = root.find(f"{SSD}Units")
    assert bar.find(f"{SSC}BaseUnit").get("factor") == "100000"


def test_systems_without_connections_or_connectors_are_valid(tmp_path):
    model = Model("alone")
    model.output("y", "1", model.t, "time")
    rows = [model.freeze(), replace(model.freeze(), observed=())]
    for i, dae in enumerate(rows):
        fmu = cosim.export_fmu(dae, tmp_path / f"{i}.fmu", derivatives=False)
        path = cosim.write_ssp(tmp_path / "s.ssp", {"a": fmu}, [])
        with zipfile.ZipFile(path) as archive:
            valid(archive.read("SystemStructure.ssd"), "SystemStructureDescription.xsd")
        assert len(cosim.read_ssp(path).parts) == 1
