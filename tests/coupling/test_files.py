"""Systems as files: TOML and SSP, what they say when they are wrong, and the command line."""

import zipfile
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from fmpy.ssp.ssd import read_ssd

import cosim
from cosim.cli.main import main
from cosim.coupling.files import read_system
from cosim.errors import CosimError, FmuError, ParameterError, UsageError

FOLDER = "examples/coupled"


@pytest.fixture(scope="module")
def ssp(tmp_path_factory):
    return read_system(f"{FOLDER}/ride.toml").write_ssp(tmp_path_factory.mktemp("ssp") / "r.ssp")


@pytest.mark.slow
def test_ssp_gives_the_same_run_as_the_system_that_wrote_it(ssp):
    ways = {"stop_time": 0.5, "output_interval": 0.05, "macro_step": 0.01}
    found = cosim.read_ssp(ssp).simulate(**ways)
    expected = read_system(f"{FOLDER}/ride.toml").simulate(**ways)
    np.testing.assert_allclose(found["rider.phi"], expected["rider.phi"], rtol=0, atol=1e-12)
    assert found.names == expected.names


@pytest.mark.slow
def test_ssp_keeps_the_name_of_the_system(ssp):
    assert ssp.stem == "r"
    assert cosim.read_ssp(ssp).name == "ride"


@pytest.mark.slow
def test_start_values_in_files_are_read(ssp, tmp_path):
    system = read_system(f"{FOLDER}/ride.toml")
    values = {"rider.lag": 0.04, "bicycle.phi_dot": 0.25}
    path = cosim.write_ssp(
        tmp_path / "own.ssp", system.files, [], values=values, parameter_files=True
    )
    found = cosim.read_ssp(path).start_values
    assert {".".join(name): value for name, value in found.items()} == values


@pytest.mark.slow_rows("0.25 rad/s-0.25")
@pytest.mark.parametrize(("text", "value"), [("25 deg/s", 25 * np.pi / 180), ("0.25 rad/s", 0.25)])
def test_start_values_in_another_unit_are_converted(text, value, tmp_path):
    system = cosim.couple({"bicycle": "bicycle"}, {}, start_values={"bicycle.phi_dot": 0.5})
    path, (number, unit) = system.write_ssp(tmp_path / "own.ssp"), text.split()
    own = 'value="0.5" unit="rad/s"'
    other = changed(
        path, tmp_path / "other.ssp", own.encode(), f'value="{number}" unit="{unit}"'.encode()
    )
    assert cosim.read_ssp(other).start_values["bicycle", "phi_dot"] == pytest.approx(value)
    wrong = changed(path, tmp_path / "wrong.ssp", own.encode(), b'value="1" unit="kg"')
    with pytest.raises(ParameterError, match="cannot be converted to 'rad/s'"):
        cosim.read_ssp(wrong)


@pytest.mark.slow_rows('name="phi_dot"-name="phi_dto"-no variable \'phi_dto\'')
@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (b"<ssv:Real value", b"<ssv:String value", "is no number; only numbers"),
        (b'name="phi_dot"', b'name="phi_dto"', "no variable 'phi_dto'"),
    ],
)
def test_values_that_cannot_be_set_are_rejected(old, new, words, tmp_path):
    system = cosim.couple({"bicycle": "bicycle"}, {}, start_values={"bicycle.phi_dot": 0.5})
    path = changed(system.write_ssp(tmp_path / "own.ssp"), tmp_path / "other.ssp", old, new)
    with pytest.raises(CosimError, match=words):
        cosim.read_ssp(path)


@pytest.mark.slow
def test_numbers_of_ssp_2_are_read_and_values_for_no_part_rejected(tmp_path):
    system = cosim.couple({"bicycle": "bicycle"}, {}, start_values={"bicycle.phi_dot": 0.5})
    path = system.write_ssp(tmp_path / "own.ssp")
    old = b'<ssv:Real value="0.5" unit="rad/s" />'
    other = changed(path, tmp_path / "other.ssp", old, b'<ssv:UInt8 value="1" />')
    assert cosim.read_ssp(other).start_values["bicycle", "phi_dot"] == 1
    values = (
        b"<ssd:ParameterBindings><ssd:ParameterBinding><ssd:ParameterValues><ssv:ParameterSet "
        b'version="1.0" name="s"><ssv:Parameters><ssv:Parameter name="bicylce.phi_dot">'
        b'<ssv:Real value="1" /></ssv:Parameter></ssv:Parameters></ssv:ParameterSet>'
        b"</ssd:ParameterValues></ssd:ParameterBinding></ssd:ParameterBindings><ssd:Elements>"
    )
    wrong = changed(path, tmp_path / "wrong.ssp", b"<ssd:Elements>", values)
    with pytest.raises(UsageError, match=r"no part has the parameter bicylce\.phi_dot"):
        cosim.read_ssp(wrong)


@pytest.mark.slow
def test_fmpy_reads_the_same_connections(ssp):
    description = read_ssd(str(ssp))
    assert len(description.system.connections) == len(cosim.read_ssp(ssp).connections) == 6


def changed(ssp, target, old, new, entry="SystemStructure.ssd"):
    with zipfile.ZipFile(ssp) as source, zipfile.ZipFile(target, "w") as archive:
        for name in source.namelist():
            content = source.read(name)
            assert name != entry or old in content
            archive.writestr(name, content.replace(old, new) if name == entry else content)
    return target


@pytest.mark.slow
def test_linear_transformation_of_a_connection_is_applied(ssp, tmp_path):
    old = b'endElement="rider" endConnector="phi" />'
    factor = b'<ssc:LinearTransformation factor="-2" offset="0.5" />'
    new = b'endElement="rider" endConnector="phi">' + factor + b"</ssd:Connection>"
    system = cosim.read_ssp(changed(ssp, tmp_path / "changed.ssp", old, new))
    run = system.simulate(stop_time=0.1, macro_step=0.01)
    np.testing.assert_allclose(run["rider.phi"], 0.5 - 2 * run["bicycle.phi"], atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (
            b'endElement="rider" endConnector="phi" />',
            b'endElement="rider" endConnector="phi"><ssc:IntegerMappingTransformation>'
            b"</ssc:IntegerMappingTransformation></ssd:Connection>",
        ),
        (b'endConnector="phi" ', b'endConnector="phi" endIndices="1" '),
    ],
    ids=["mapping", "indices"],
)
def test_what_would_change_the_result_and_is_not_read_is_rejected(ssp, tmp_path, old, new):
    file = changed(ssp, tmp_path / "changed.ssp", old, new)
    with pytest.raises(UsageError, match=r"changed\.ssp: SystemStructure\.ssd: .* read"):
        cosim.read_ssp(file)


def nested(ssp, target):
    """Write the same system with the rider in a system of its own, and reverse phi twice."""
    with zipfile.ZipFile(ssp) as source:
        files = {name: source.read(name) for name in source.namelist()}
    root = ET.fromstring(files["SystemStructure.ssd"])
    names = {"d": root.tag[1:].partition("}")[0]}
    tag, reversing = f"{{{names['d']}}}", '<LinearTransformation factor="-1" />'
    elements = root.find("d:System/d:Elements", names)
    rider = elements.find("d:Component[@name='rider']", names)
    elements.remove(rider)
    man = ET.SubElement(elements, f"{tag}System", name="man")
    man.append(rider.find("d:Connectors", names))
    ET.SubElement(man, f"{tag}Elements").append(rider)
    inner = ET.SubElement(man, f"{tag}Connections")
    for wire in root.findall("d:System/d:Connections/d:Connection", names):
        for end in ("start", "end"):
            if wire.get(f"{end}Element") != "rider":
                continue
            wire.set(f"{end}Element", "man")
            other = {"start": "end", "end": "start"}[end]
            name = wire.get(f"{end}Connector")
            facts = {f"{end}Element": "rider", "endConnector": name, "startConnector": name}
            within = ET.SubElement(inner, f"{tag}Connection", facts)
            assert f"{other}Element" not in within.attrib
            if name == "phi":
                for joint in (wire, within):
                    joint.append(ET.fromstring(reversing))
    bindings = ET.SubElement(man, f"{tag}ParameterBindings")
    values = '<V><ParameterSet><Parameters><Parameter name="rider.lag"><Real value="0.04" />'
    values += "</Parameter></Parameters></ParameterSet></V>"
    binding = ET.SubElement(bindings, f"{tag}ParameterBinding")
    inline = ET.fromstring(values)
    inline.tag = f"{tag}ParameterValues"
    binding.append(inline)
    files["SystemStructure.ssd"] = ET.tostring(root)
    with zipfile.ZipFile(target, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return target


def test_systems_within_a_system_are_read(ssp, tmp_path):
    found = cosim.read_ssp(nested(ssp, tmp_path / "nested.ssp"))
    assert list(found.parts) == ["bicycle", "man_rider"]
    assert found.start_values["man_rider", "lag"] == 0.04
    ways = {"stop_time": 0.5, "output_interval": 0.05, "macro_step": 0.01}
    run = found.simulate(**ways)
    plain = cosim.read_ssp(ssp).simulate(**ways, start_values={"rider.lag": 0.04})
    np.testing.assert_array_equal(run["bicycle.phi"], plain["bicycle.phi"])


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (b'source="resources/rider.fmu"', b'source="../rider.fmu"', "has no file"),
        (b'startConnector="delta_dot"', b'startConnector="nothing"', "no variable 'nothing'"),
        (b'type="application/x-fmu-sharedlibrary"', b'type="x/y"', "cannot be simulated"),
        (b"<ssd:System ", b"<ssd:Other ", "not well-formed"),
    ],
)
def test_damaged_ssp_is_rejected(ssp, tmp_path, old, new, words):
    with pytest.raises(CosimError, match=words):
        cosim.read_ssp(changed(ssp, tmp_path / "damaged.ssp", old, new))


def test_fmu_is_no_ssp(tmp_path):
    path = cosim.export_fmu(cosim.load("crank_shaft"), tmp_path / "crank.fmu")
    with pytest.raises(FmuError, match="give an SSP file"):
        cosim.read_ssp(path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('[parts]\na = "nothing"\n', "nothing"),
        ("[parts]\na = 1\n", "line 2: 1 does not fit"),
        ('color = 1\n[parts]\na = "crank_shaft"\n', "line 1: a system has no key 'color'"),
        ('stop_time = "x"\n[parts]\na = "crank_shaft"\n', "line 1: 'x' does not fit"),
        ('[parts]\na = "crank_shaft"\n[connections]\n"a.phi" = "a.omega"\n', "a.phi is no input"),
    ],
)
def test_wrong_toml_is_rejected_with_its_line(tmp_path, text, words):
    (tmp_path / "wrong.toml").write_text(text)
    with pytest.raises(CosimError, match=words):
        read_system(tmp_path / "wrong.toml")


def test_parts_that_are_fmus_have_no_equations(ssp):
    with pytest.raises(UsageError, match="part 'bicycle' is an FMU"):
        cosim.read_ssp(ssp).dae  # noqa: B018 # it is computed on demand


@pytest.mark.slow
def test_command_line_runs_the_model_the_co_simulation_and_the_ssp(ssp, tmp_path, capsys):
    ride, runs = f"{FOLDER}/ride.toml", []
    ways = ([ride], [ride, "--method", "iterated"], [str(ssp)])
    for number, way in enumerate(ways):
        out = str(tmp_path / f"{number}.csv")
        times = ["--stop-time", "0.5", "--output-interval", "0.1"]
        assert main(["simulate", *way, *times, "-o", out]) == 0, capsys.readouterr().err
        runs.append(cosim.Trajectory.read_csv(out))
    assert "error of the coupling at most about" in capsys.readouterr().err
    for run in runs[1:]:
        np.testing.assert_allclose(run["rider.phi"], runs[0]["rider.phi"], rtol=0, atol=1e-6)
    assert main(["info", ride]) == 0
    assert "rider.steer_torque -> bicycle.steer_torque" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["simulate", "bicycle", "--method", "jacobi"], "are for coupled systems"),
        (["simulate", "bicycle", "--macro-step", "0"], "are for coupled systems"),
        (["simulate", "SSP", "--solver", "dop853"], "--solver is for models"),
        (["simulate", "SSP", "--method", "jacobi"], "give macro_step"),
        (["export", "crank_shaft", "-o", "x.ssp"], ".ssp is for coupled systems"),
        (["linearize", "SSP"], "a system is taken by simulate, tradeoff and info"),
    ],
)
def test_options_that_do_not_fit_are_rejected(words, message, ssp, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main([str(ssp) if word == "SSP" else word for word in words]) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_missing_file_is_reported_before_options_that_do_not_fit(capsys):
    assert main(["simulate", "missing.toml", "--method", "jacobi"]) == 3
    assert "has no scene 'missing.toml'" in capsys.readouterr().err
