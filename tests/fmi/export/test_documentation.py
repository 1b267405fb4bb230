"""The page inside an FMU: validity conditions, solver, tolerance, diagram, equations."""

import re
from html import unescape

import casadi as ca
import numpy as np
import pytest

import cosim
from cosim.fmi.export.documentation import formulas
from cosim.fmi.export.options import FmuOptions
from cosim.fmi.export.package import source_files

BAR = "bar_on_frame/reduced"


def page(name, **options):
    dae = cosim.load(name)
    files = source_files(dae, FmuOptions(identifier="model", tolerance=1e-7, **options))
    return dae, unescape(files["documentation/index.html"].decode()), files


def test_page_shows_validity_conditions_solver_and_tolerance():
    dae, text, _ = page("bicycle", solver="erk")
    assert dae.limits
    for _, meaning in dae.limits:
        assert meaning in text
    assert "integrates with erk" in text
    assert "relative tolerance is\n1e-07" in text


def test_page_names_a_source_if_there_is_one(tmp_path):
    assert "Source: Unit 7" in page(BAR)[1]
    path = tmp_path / "fall.py"
    path.write_text(
        "import cosim\ndef build():\n    model = cosim.Model('fall')\n"
        "    model.derivative(model.state('v', 'm/s', 0.0, 'speed'), -9.81)\n"
        "    return model.freeze()\n"
    )
    assert "Source" not in page(f"{path}:build")[1]


def test_page_shows_the_diagram():
    _, text, files = page(BAR)
    (source,) = re.findall('<img src="([^"]*)"', text)
    assert f"documentation/{source}" in files


def test_short_equations_are_those_of_the_model():
    """Read back by Python with numbers, they give what the model's own expressions give."""
    dae = cosim.load(BAR)
    rng = np.random.default_rng(1)
    values = {v.name: rng.uniform(0.5, 1.5) for v in (*dae.states, *dae.inputs, *dae.parameters)}
    columns = [[values[v.name] for v in g] for g in (dae.states, dae.inputs, dae.parameters)]
    rows = ca.vertcat(dae.ode, dae.outputs)
    numbers = ca.Function("f", [dae.x, dae.u, dae.p], [rows])(*columns).full().ravel()
    told = [right for _, right in formulas(dae)]
    functions = {"sin": np.sin, "cos": np.cos, "sq": np.square}
    short = 0
    for text, expected in zip(told, numbers, strict=True):
        if not text.startswith("f("):
            assert eval(text, functions | values) == pytest.approx(expected, rel=1e-12)
            short += 1
    assert short > 15


def test_long_equations_name_their_variables_and_their_size():
    told = dict(formulas(cosim.load("bicycle")))
    assert told["der(phi)"] == "phi_dot"
    assert re.fullmatch(r"f\(.*phi_dot.*; parameters\), \d+ operations", told["der(phi_dot)"])
    assert told["theta at the start"].startswith("solution of 0 = ")


def test_page_lists_the_invariants():
    _, text, _ = page("bicycle/multipliers")
    assert "the front wheel touches the ground" in text
