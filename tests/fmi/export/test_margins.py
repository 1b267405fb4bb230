"""`valid`: an FMU that tells whether its model holds, against a closed form."""

import zipfile
from math import asin, pi
from xml.etree import ElementTree as ET

import casadi as ca
import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu
from helpers.fmi_cases import VERSIONS
from helpers.small_models import decay

import cosim
from casadi_models.dae import Dae, Model
from cosim.errors import UsageError
from cosim.fmi.check.parsed import parse
from cosim.fmi.export.options import FmuOptions
from cosim.fmi.export.package import source_files

LEAVES, RETURNS = asin(0.5), pi - asin(0.5)  # s


def swing() -> Dae:
    """Return x = sin t, good for x < 0.5 m."""
    model = Model("swing", description="swing", source="a test", stop_time=4.0)
    x = model.state("x", "m", 0.0, "place")
    v = model.state("v", "m/s", 1.0, "velocity")
    model.derivative(x, v)
    model.derivative(v, -x)
    model.limit(0.5 - x, "x is below 0.5 m")
    model.limit(2 - v, "v is below 2 m/s")
    return model.freeze()


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("valid")
    return {
        fmi: cosim.export_fmu(swing(), folder / f"swing_{fmi}.fmu", fmi=fmi, valid=True)
        for fmi in (2, 3)
    }


def truth(time):
    return np.sin(time) < 0.5


@pytest.mark.slow_rows("ModelExchange-2", "ModelExchange-3")
@VERSIONS
@pytest.mark.parametrize("interface", ["ModelExchange", "CoSimulation"])
def test_valid_is_true_exactly_where_the_limits_hold(files, fmi, interface):
    result = fmpy.simulate_fmu(str(files[fmi]), fmi_type=interface, output_interval=0.05)
    assert result["valid"].dtype == bool
    time = result["time"]
    clear = np.abs(time[:, None] - [LEAVES, RETURNS]).min(axis=1) > 1e-4
    np.testing.assert_array_equal(result["valid"][clear], truth(time[clear]))
    assert 10 < (~result["valid"]).sum() < len(time) - 10


@VERSIONS
def test_model_exchange_has_an_event_at_each_crossing(files, fmi):
    result = fmpy.simulate_fmu(str(files[fmi]), fmi_type="ModelExchange", output_interval=0.5)
    off = [t for t in result["time"] if abs(t / 0.5 - round(t / 0.5)) > 1e-9]
    assert {round(t, 3) for t in off} == {round(LEAVES, 3), round(RETURNS, 3)}  # measured 2e-5


@VERSIONS
def test_the_description_says_so_and_is_sound(files, fmi):
    assert validate_fmu(str(files[fmi])) == []
    assert cosim.check_fmu(files[fmi]) == []
    with zipfile.ZipFile(files[fmi]) as fmu:
        root = ET.fromstring(fmu.read("modelDescription.xml"))
    *_, one, two, valid = root.find("ModelVariables")
    assert valid.get("causality") == "output"
    assert valid.get("variability") == "discrete"
    assert [one.get("causality"), two.get("causality")] == ["local", "local"]
    assert one.get("description") == "positive while x is below 0.5 m"
    if fmi == 2:
        assert root.get("numberOfEventIndicators") == "2"
    else:
        indicators = root.findall("ModelStructure/EventIndicator")
        references = [one.get("valueReference"), two.get("valueReference")]
        assert [i.get("valueReference") for i in indicators] == references
        assert [i.get("dependencies") for i in indicators] == ["1", "2"]  # x and v


@VERSIONS
def test_violated_condition_is_reported_once(files, fmi):
    said = []

    def collect(*arguments):
        text = arguments[-1]
        said.append(text.decode() if isinstance(text, bytes) else str(text))

    for interface in ("ModelExchange", "CoSimulation"):
        said.clear()
        fmpy.simulate_fmu(
            str(files[fmi]),
            fmi_type=interface,
            debug_logging=True,
            logger=collect,
            output_interval=0.1,
        )
        assert len([text for text in said if "not fulfilled: x is below 0.5 m" in text]) == 1


@VERSIONS
def test_our_own_runs_have_it_as_a_number(files, fmi):
    run = cosim.simulate_fmu(files[fmi], output_interval=0.05)
    assert run.names == ("x", "v", "valid")
    assert set(run["valid"]) == {0.0, 1.0}


def test_without_the_option_there_are_only_the_margins(tmp_path):
    path = cosim.export_fmu(swing(), tmp_path / "swing.fmu")
    with zipfile.ZipFile(path) as fmu:
        text = fmu.read("modelDescription.xml").decode()
    assert "Boolean" not in text
    assert 'numberOfEventIndicators="2"' in text


def test_without_limits_there_are_no_indicators(tmp_path):
    path = cosim.export_fmu(decay(), tmp_path / "decay.fmu")
    with zipfile.ZipFile(path) as fmu:
        assert 'numberOfEventIndicators="0"' in fmu.read("modelDescription.xml").decode()


def test_impossible_valid_output_is_rejected_with_one_message(tmp_path):
    with pytest.raises(UsageError, match="declares no validity conditions"):
        cosim.export_fmu(decay(), tmp_path / "a.fmu", valid=True)
    model = Model("taken", description="taken", source="a test")
    x = model.state("valid", "1", 1.0, "not what the option means")
    model.derivative(x, -x)
    model.limit(x, "x is positive")
    with pytest.raises(UsageError, match="variable 'valid' of its own"):
        cosim.export_fmu(model.freeze(), tmp_path / "a.fmu", valid=True)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("names", ["flat", "structured"])
@VERSIONS
def test_valid_depends_on_what_the_limits_depend_on_and_on_no_other_event(fmi, names):
    model = Model("two")
    x, y = (model.state(name, "1", 1.0, name) for name in "xy")
    model.derivative(x, -ca.fabs(y - 0.5))
    model.derivative(y, -y)
    model.limit(x, "x > 0")
    model.limit(2 - x, "x < 2")
    options = FmuOptions(fmi=fmi, valid=True, names=names)
    file = parse(source_files(model.freeze(), options)["modelDescription.xml"])
    for section in ("Outputs", "InitialUnknowns"):
        (valid,) = (u for u in file.sections[section] if file.variables[u.position].name == "valid")
        assert [file.variables[i].name for i in valid.needs] == ["x"]  # before: y, too
