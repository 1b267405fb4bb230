"""The model description: what the model says of a variable is what the file says of it."""

from math import inf, pi
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from helpers.fmi_cases import VERSIONS
from helpers.small_models import decay

import cosim
from casadi_models.dae import Dae, Model, Start
from cosim.errors import ExportError, ParameterError, UnknownName, UsageError
from cosim.fmi.check.parsed import Description, parse
from cosim.fmi.export.dependencies import fixed_parameters, tunable_parameters
from cosim.fmi.export.options import FmuOptions
from cosim.fmi.export.package import source_files


def described(dae: Dae, fmi: int = 2) -> Description:
    return parse(source_files(dae, FmuOptions(fmi))["modelDescription.xml"])


def rich() -> Dae:
    """Return a DAE with every kind of variable, whose dependencies are known by hand."""
    model = Model("rich", description="a < b & c", source="a test", display={"rad": "deg"})
    a = model.state("a", "rad", 0.1, "angle", nominal=0.5, minimum=-1.0, maximum=1.0)
    b = model.state("b", "m", 2.0, "place")
    c = model.state("c", "m", 1.0, "root of p")
    z = model.algebraic("z", "N", 1.0, "force")
    u = model.input("u", "N", 0.25, "push", minimum=-2.0)
    p = model.parameter("p", "1", 4.0, "square of c", positive=True)
    k = model.parameter("k", "1", 0.1, "factor")
    model.derivative(a, k * z)
    model.derivative(b, model.t)
    model.derivative(c, 0)
    model.equation(2 * z - b - u)
    model.start_equation(c, c**2 - p, "root")
    model.output("y", "N", 3 * z + a, "result")
    return model.freeze()


@VERSIONS
def test_every_fact_of_a_variable_arrives(fmi):
    dae, file = rich(), described(rich(), fmi)
    read = {v.name: v for v in file.variables}
    for variable in dae.variables:
        texts = read[variable.name].texts
        assert texts["unit"] == variable.unit
        assert texts.get("displayUnit") == variable.display_unit
        assert float(texts.get("nominal", 1)) == variable.nominal
        guarded = variable.name == "p"  # positive, which `Model` guards against overflow
        assert float(texts.get("min", -inf)) == (0.0 if guarded else variable.minimum)
        assert float(texts.get("max", inf)) == (inf if guarded else variable.maximum)
        if variable.start_kind is Start.EXACT:
            assert float(texts["start"]) == variable.start
        elif variable.name == "c":  # what the start comes to: the root of p = 4
            assert float(texts["start"]) == 2.0
        else:
            assert "start" not in texts


@VERSIONS
def test_causality_and_initial_follow_the_role(fmi):
    kinds = {v.name: (v.causality, v.initial) for v in described(rich(), fmi).variables}
    assert kinds == {
        "time": ("independent", None),
        "a": ("output", "exact"),
        "b": ("output", "exact"),
        "c": ("output", "approx"),
        "der(a)": ("local", "calculated"),
        "der(b)": ("local", "calculated"),
        "der(c)": ("local", "calculated"),
        "z": ("output", "calculated"),
        "u": ("input", None),
        "p": ("parameter", "exact"),
        "k": ("parameter", "exact"),
        "y": ("output", "calculated"),
    }


@VERSIONS
def test_dependencies_are_those_worked_out_by_hand(fmi):
    """z = (b + u) / 2, so that a' = k z and y = 3 z + a follow; c starts at the root of p."""
    file = described(rich(), fmi)

    def needs(section: str) -> dict[str, set[str]]:
        names = [v.name for v in file.variables]
        return {names[u.position]: {names[i] for i in u.needs} for u in file.sections[section]}

    assert needs("Derivatives") == {"der(a)": {"b", "u", "k"}, "der(b)": {"time"}, "der(c)": set()}
    assert needs("Outputs") == {
        "a": {"a"},
        "b": {"b"},
        "c": {"c"},
        "z": {"b", "u"},
        "y": {"a", "b", "u"},
    }
    assert needs("InitialUnknowns") == {
        "c": {"p"},
        "der(a)": {"b", "u", "k"},
        "der(b)": {"time"},
        "der(c)": set(),
        "z": {"b", "u"},
        "y": {"a", "b", "u"},
    }


@VERSIONS
def test_fixed_parameters_are_knowns_of_fmi_3_only(fmi):
    """FMI 3.0.2, 2.4.8: what is not listed has no influence; parameters are no exception."""
    files = source_files(rich(), FmuOptions(fmi, tunable=()))
    file = parse(files["modelDescription.xml"])
    names = [v.name for v in file.variables]
    listed = {u.position: {names[i] for i in u.needs} for u in file.sections["Derivatives"]}
    assert listed[names.index("der(a)")] == {"b", "u"} | ({"k"} if fmi == 3 else set())
    assert {v.variability for v in file.variables if v.causality == "parameter"} == {"fixed"}


@VERSIONS
def test_parameters_that_starts_follow_from_are_fixed(fmi):
    kinds = {v.name: v.variability for v in described(rich(), fmi).variables}
    assert (kinds["p"], kinds["k"]) == ("fixed", "tunable")
    with pytest.raises(UsageError, match="p cannot be tunable, as nothing follows from it after"):
        source_files(rich(), FmuOptions(fmi, tunable=["p"]))
    with pytest.raises(UnknownName, match="no parameter 'q'"):
        source_files(rich(), FmuOptions(fmi, tunable=["q"]))


def test_inertias_and_parameters_of_start_values_are_fixed_unless_requested():
    pendulum, bicycle = map(cosim.load, ("double_pendulum/quaternion", "bicycle/independent"))
    assert "momentum" in fixed_parameters(pendulum)["m"]
    assert "g" not in fixed_parameters(pendulum)
    assert fixed_parameters(bicycle)["w"] == "start values follow from it"
    assert "w" not in tunable_parameters(bicycle, None)
    assert {"w", "mB"} < set(tunable_parameters(bicycle, ["all"]))


def test_adjoint_derivatives_are_declared_when_requested():
    for adjoint in (False, True):
        files = source_files(rich(), FmuOptions(3, adjoint=adjoint))
        root = ET.fromstring(files["modelDescription.xml"])
        told = [element.get("providesAdjointDerivatives") for element in root[:2]]
        assert told == (["true"] * 2 if adjoint else [None] * 2)


@VERSIONS
def test_display_units_convert_as_the_standard_says(fmi):
    """A display value is unit value times factor (FMI 2.0.4, 2.2.2): pi is 180 degrees."""
    display = described(rich(), fmi).root.find("UnitDefinitions/Unit[@name='rad']/DisplayUnit")
    assert display.get("name") == "deg"
    assert float(display.get("factor")) * 3.141592653589793 == pytest.approx(180, rel=1e-15)


@VERSIONS
def test_variables_have_declared_types_with_quantity_and_unit(fmi):
    root = described(rich(), fmi).root
    types = {}
    for element in root.find("TypeDefinitions"):
        facts = element if fmi == 3 else element[0]
        types[element.get("name")] = facts.get("quantity"), facts.get("unit")
    assert types["Angle"] == ("Angle", "rad")
    assert types["Length"] == ("Length", "m")
    for element in root.find("ModelVariables"):
        facts = element if fmi == 3 else element[0]
        if kind := facts.get("declaredType"):
            assert types[kind][1] == facts.get("unit")
    assert {v.texts.get("declaredType") for v in described(rich(), fmi).variables} >= {"Force"}


@VERSIONS
def test_rates_are_shown_like_what_they_are_the_rate_of(fmi):
    read = {v.name: v.texts for v in described(rich(), fmi).variables}
    assert read["der(a)"]["displayUnit"] == "deg/s"
    assert "displayUnit" not in read["der(b)"]


@VERSIONS
def test_description_contains_author_license_and_date_if_given(fmi):
    about = {"author": "A. U. Thor", "license": "MIT", "date": "2025-01-01T00:00:00Z"}
    given = source_files(rich(), FmuOptions(fmi, about=about))
    root = ET.fromstring(given["modelDescription.xml"])
    names = ("author", "license", "generationDateAndTime")
    assert [root.get(name) for name in names] == [*about.values()]
    assert "generationDateAndTime" not in described(rich(), fmi).root.attrib


@pytest.mark.parametrize(
    ("text", "written"),
    [
        ("2026-01-02", "2026-01-02T00:00:00"),
        ("2026-01-02 03:04:05+00:00", "2026-01-02T03:04:05Z"),
    ],
)
def test_dates_are_written_as_the_schema_wants_them(text, written):
    given = source_files(rich(), FmuOptions(about={"date": text}))
    root = ET.fromstring(given["modelDescription.xml"])
    assert root.get("generationDateAndTime") == written


@pytest.mark.parametrize("text", ["yesterday", "", "2026-13-01"])
def test_texts_that_are_no_dates_are_refused(text):
    with pytest.raises(ParameterError, match="is no date; write it like 2026-12-31T"):
        FmuOptions(about={"date": text})


@pytest.mark.parametrize("character", ["\x0b", "\0", "\ud800", "\uffff"])
def test_characters_that_xml_cannot_hold_are_refused(character):
    model = Model("odd", description=f"a{character}b")
    model.derivative(model.state("x", "1", 1.0, "x"), 0)
    with pytest.raises(ExportError, match="description of fmiModelDescription has the character"):
        source_files(model.freeze(), FmuOptions())


@VERSIONS
def test_rates_of_temperatures_have_no_offset(fmi, tmp_path):
    model = Model("oven", stop_time=1.0, output_interval=1.0)
    T = model.state("T", "degC", 20.0, "temperature", display_unit="K")
    model.derivative(T, 0.5)
    fmu = cosim.export_fmu(model.freeze(), tmp_path / "oven.fmu", fmi=fmi)  # before: not sound
    read = {v.name: v.texts for v in described(model.freeze(), fmi).variables}
    assert read["der(T)"]["unit"] == "degC/s"
    assert cosim.simulate_fmu(fmu)["T"][-1] == pytest.approx(20.5, rel=1e-12)


def test_start_values_are_not_rounded_out_of_bounds():
    model = Model("bounded")
    k = model.parameter("k", "rad", pi / 3, "start")
    x = model.state("x", "rad", 1.0, "x", maximum=pi / 3)
    model.derivative(x, 0)
    model.start(x, k, "k")
    (shown,) = (v.texts for v in described(model.freeze()).variables if v.name == "x")
    assert float(shown["start"]) == pi / 3  # to 15 digits, it is larger


@pytest.mark.parametrize("fact", ["tolerance", "max_step", "step_size"])
def test_options_may_be_numbers_of_numpy(fact):
    solver = "rk4" if fact == "step_size" else None
    headers = [
        source_files(rich(), FmuOptions(solver=solver, **{fact: value}))["sources/model.h"]
        for value in (0.01, np.float64(0.01))
    ]
    assert headers[0] == headers[1]


def test_fmu_contains_the_licenses():
    files = source_files(rich(), FmuOptions())
    own = Path(__file__).parents[3] / "LICENSE"
    assert files["documentation/licenses/LICENSE.txt"] == own.read_bytes()
    assert b"free of copyright" in files["documentation/licenses/GENERATED.txt"]


@VERSIONS
def test_texts_with_markup_survive(fmi):
    assert described(rich(), fmi).root.get("description") == "a < b & c"


@VERSIONS
def test_default_experiment_is_that_of_the_model(fmi):
    experiment = described(decay(), fmi).root.find("DefaultExperiment")
    numbers = {name: float(value) for name, value in experiment.attrib.items()}
    assert numbers == {"startTime": 0, "stopTime": 1, "tolerance": 1e-9, "stepSize": 0.01}


@pytest.mark.slow
def test_names_of_states_are_those_of_native_runs(exported):
    run = cosim.simulate(cosim.load("bicycle"), stop_time=0.02, compiled=False)
    again = cosim.simulate_fmu(exported("bicycle/independent"), stop_time=0.02)
    assert again.names == run.names
    assert again.units == run.units
    assert [c.nominal for c in again.columns] == [c.nominal for c in run.columns]
    assert [c.meaning for c in again.columns] == [c.meaning for c in run.columns]


def test_documentation_lists_every_variable_but_derivatives():
    page = source_files(rich(), FmuOptions())["documentation/index.html"].decode()
    root = ET.fromstring(page.partition("\n")[2].replace('<meta charset="utf-8">', ""))
    cells = [row[0].text for row in root.iter("tr") if row[0].tag == "td"]
    assert sorted(cells) == sorted(v.name for v in rich().variables)
    assert "a &lt; b &amp; c" in page


@pytest.mark.slow
def test_bounds_are_those_that_a_reader_means():
    """Positive parameters have 0, not a guard of 1e-12; bounds that an author gave stay."""
    bicycle = {v.name: v.texts for v in described(cosim.load("bicycle")).variables}
    assert (bicycle["mA"].get("min"), bicycle["mA"].get("max")) == ("0.0", None)
    assert "min" not in bicycle["zGB"]
    bar = {v.name: v.texts for v in described(cosim.load("bar_on_frame")).variables}
    assert (bar["frame_inertia"]["min"], bar["frame_inertia"]["max"]) == ("0.0", "1.0")
