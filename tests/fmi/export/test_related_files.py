"""What an FMU carries besides: its manifest tells of it, parameter sets fit it."""

import zipfile
from pathlib import Path
from posixpath import normpath
from xml.etree import ElementTree as ET

import fmpy
import pytest
from helpers.small_models import decay
from lxml import etree

import cosim
from cosim.scene.scene_file import scene_values
from cosim.verify.reference_result import export_with_reference

FOLDER = "extra/org.fmi-standard.fmi-ls-ref"
LS = "{http://fmi-standard.org/fmi-ls-manifest}"
SSV = "{http://ssp-standard.org/SSP1/SystemStructureParameterValues}"
SCHEMA = Path(fmpy.__file__).parent / "ssp" / "schema" / "SystemStructureParameterValues.xsd"
ROLES = {"result", "report", "parameter"}  # of those that FMI-LS-REF 1.0.0-alpha.1 defines
SETS = {"fast": ("a fast decay", {"rate": 2.0, "x": 3.0, "y": 1.0, "unknown": 5.0})}


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    path = export_with_reference(decay(), tmp_path_factory.mktemp("related") / "a.fmu", sets=SETS)
    with zipfile.ZipFile(path) as fmu:
        return {name: fmu.read(name) for name in fmu.namelist()}


def test_the_manifest_is_as_the_layered_standard_has_it(files):
    root = ET.fromstring(files[f"{FOLDER}/fmi-ls-manifest.xml"])
    assert root.tag == "fmiReferences"
    assert root.get(f"{LS}fmi-ls-name") == "org.fmi-standard.fmi-ls-ref"
    assert root.get(f"{LS}fmi-ls-version")
    assert root.get(f"{LS}fmi-ls-description") == (
        "Layered Standard providing information on related files included in an FMU."
    )
    related = root.findall("Related")
    assert {entry.get("role") for entry in related} == ROLES
    for entry in related:
        assert normpath(f"{FOLDER}/{entry.get('source')}") in files
        assert entry.get("type") in (
            "text/csv",
            "application/json",
            "application/x-ssp-parameter-set",
        )
        assert entry.get("description")


def test_a_parameter_set_is_schema_valid_and_holds_what_can_be_set(files):
    content = files[f"{FOLDER}/fast.ssv"]
    etree.XMLSchema(etree.parse(SCHEMA)).assertValid(etree.fromstring(content))
    root = ET.fromstring(content)
    assert root.get("description") == "a fast decay"
    values = {p.get("name"): p[0] for p in root.iter(f"{SSV}Parameter")}
    assert {name: float(v.get("value")) for name, v in values.items()} == {"rate": 2.0, "x": 3.0}
    assert values["x"].get("unit") == "m"


def test_without_results_and_sets_there_is_no_manifest(tmp_path):
    path = export_with_reference(decay("plain"), tmp_path / "a.fmu", reference=False)
    with zipfile.ZipFile(path) as fmu:
        assert not [name for name in fmu.namelist() if name.startswith("extra/")]


def test_shipped_scenes_with_values_belong_to_their_own_model():
    assert scene_values(cosim.load("crank_shaft/multipliers")) == {}
    bar = scene_values(cosim.load("bar_on_frame/reduced"))
    title, values = bar["bar_on_frame"]
    assert title
    assert values["Omega"] == pytest.approx(2 * 3.141592653589793, rel=1e-15)  # 60 rpm
    assert "bar_theta" not in bar  # sets nothing
