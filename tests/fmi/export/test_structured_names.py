"""Structured names: what becomes an array, and that both names reach the same variable."""

import csv
import io
import re
import zipfile
from xml.etree import ElementTree as ET

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu

import casadi_models
import cosim
from casadi_models.dae import Dae, Model
from cosim.errors import UnknownName
from cosim.fmi.export.variables import structured_names
from cosim.verify.comparison import Verdict
from cosim.verify.reference_result import check_file, export_with_reference

# FMI 2.0.4, 2.2.9 and FMI 3.0.2, 2.4.7.5.1, without quoted names
WORD = r"[A-Za-z_]\w*(\[\d+(,\d+)*\])?"
STRUCTURED = re.compile(rf"{WORD}(\.{WORD})*")


@pytest.mark.parametrize(
    ("flat", "expected"),
    [
        ("fx_A fy_A fz_A", "A.f[1] A.f[2] A.f[3]"),
        ("f1_G_F f2_G_F fk_G_F", "G.f_F[1] G.f_F[2] G.f_F[3]"),
        ("x_tip y_tip", "tip.r[1] tip.r[2]"),
        ("q1_w q1_x q1_y q1_z", "q1[1] q1[2] q1[3] q1[4]"),
        ("vx_G1_dot vy_G1_dot", "G1.v_dot[1] G1.v_dot[2]"),
        ("y_1 y_2 y_10", "y_1 y_2 y_10"),  # not whole
        ("y_2 y_1", "y[2] y[1]"),
        ("fy_A fz_A", "fy_A fz_A"),  # the first component is missing
        ("fx_A fy_A A", "fx_A fy_A A"),  # A is something else already
        ("energy xP IAxx theta1 psi1_0", "energy xP IAxx theta1 psi1_0"),
    ],
)
def test_whole_vectors_become_arrays_and_nothing_else(flat, expected):
    names = flat.split()
    assert structured_names(dict.fromkeys(names, "N")) == dict(
        zip(names, expected.split(), strict=True)
    )


def test_what_differs_in_unit_is_no_array():
    assert structured_names({"y_1": "N", "y_2": "m"}) == {"y_1": "y_1", "y_2": "y_2"}


@pytest.mark.parametrize("name", casadi_models.CATALOG)
def test_names_of_every_model_are_unique_and_structured(name):
    flat = [v.name for v in cosim.load(name).variables]
    names = structured_names(dict.fromkeys(flat, ""))
    assert len(set(names.values())) == len(flat)
    assert all(STRUCTURED.fullmatch(n) for n in names.values())


def spinning() -> Dae:
    """Return v' = gain_1 e_x - v, places integrated, with names of both kinds."""
    model = Model("spinning", description="a point", source="a test", stop_time=1.0)
    v = [model.state(f"v{axis}_P", "m/s", 1.0, "velocity") for axis in "xyz"]
    gain = [model.parameter(f"gain_{i}", "m/s2", float(i), "gain") for i in (1, 2)]
    push = [model.input(f"push_{i}", "m/s2", 0.0, "push") for i in (1, 2)]
    for i, component in enumerate(v):
        model.derivative(component, (gain[0] + push[0] if i == 0 else 0) - component)
    model.output("sum", "m/s2", v[0] + gain[1] * push[1], "sum")
    return model.freeze()


@pytest.fixture(scope="module", params=[2, 3])
def file(request, tmp_path_factory):
    path = tmp_path_factory.mktemp("names") / "spinning.fmu"
    return export_with_reference(spinning(), path, fmi=request.param, names="structured")


@pytest.mark.slow_rows("3")
def test_importers_see_structured_names(file):
    assert validate_fmu(str(file)) == []
    assert cosim.check_fmu(file) == []
    with zipfile.ZipFile(file) as fmu:
        root = ET.fromstring(fmu.read("modelDescription.xml"))
    names = [v.get("name") for v in root.find("ModelVariables")]
    assert names[:6] == ["time", "P.v[1]", "P.v[2]", "P.v[3]", "der(P.v[1])", "der(P.v[2])"]
    assert "push[2]" in names
    assert "sum" in names
    result = fmpy.simulate_fmu(str(file), start_values={"gain[1]": 3.0}, output=["P.v[1]"])
    assert result["P.v[1]"][-1] == pytest.approx(3 - 2 * np.exp(-1), abs=1e-6)


@pytest.mark.slow_rows("2")
def test_the_tools_here_know_both_names(file):
    flat = cosim.simulate_fmu(file, start_values={"gain_1": 3.0}, outputs=["vx_P"])
    other = cosim.simulate_fmu(file, start_values={"gain[1]": 3.0}, outputs=["P.v[1]"])
    assert flat.names == other.names == ("vx_P",)
    np.testing.assert_array_equal(flat["vx_P"], other["vx_P"])
    assert cosim.simulate_fmu(file).names == ("vx_P", "vy_P", "vz_P", "sum")
    worst = cosim.compare(cosim.simulate(spinning()), cosim.simulate_fmu(file)).worst
    assert worst.scaled < 1e-6
    with pytest.raises(UnknownName):
        cosim.simulate_fmu(file, outputs=["P.v[4]"])


@pytest.mark.slow_rows("3")
def test_the_reference_inside_has_the_files_own_names_and_is_found(file):
    with zipfile.ZipFile(file) as fmu:
        head = next(csv.reader(io.StringIO(fmu.read("documentation/reference.csv").decode())))
    assert head == ["time", "P.v[1]", "P.v[2]", "P.v[3]", "sum"]
    assert [check.verdict for check in check_file(file)] == [Verdict.OK, Verdict.OK]


def test_unknown_kind_of_names_is_rejected(tmp_path):
    with pytest.raises(UnknownName, match="flat"):
        cosim.export_fmu(spinning(), tmp_path / "a.fmu", names="modelica")
