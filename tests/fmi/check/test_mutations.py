"""Trials against sound files that were made wrong in one way: each is found by its rule."""

import pytest
from helpers.fmu_files import set_attributes, with_description
from helpers.small_models import decay
from helpers.wrapped import wrapped

from casadi_models.dae import Model
from cosim.fmi.check.check import examine
from cosim.fmi.check.finding import ADVICE, WRONG
from cosim.fmi.check.isolated import TRIALS, try_apart
from cosim.fmi.check.libraries import sources
from cosim.fmi.check.trials.start import reset

QUICK = tuple(trial for trial in TRIALS if trial is not sources)
TWICE = "{ fmi2Status s = CALL; for (size_t i = 0; i < n; i++) value[i] *= 2; return s; }"
KIND = {
    "fmi2Instantiate": "limit = kind == fmi2CoSimulation; return CALL;",
    "fmi2ExitInitializationMode": "limit *= 2; return CALL;",
}
HELD = {"fmi2SetRealInputDerivatives": "(void)&inner_fmi2SetRealInputDerivatives; return fmi2OK;"}
IGNORED = "for (size_t i = 0; i < n; i++) if (limit > 1 && vr[i] == {}) return fmi2OK; return CALL;"
MUTATIONS = {  # wrapped functions, what is found
    "too fast": (
        {"fmi2DoStep": "return inner_fmi2DoStep(c, 1.001 * point, 1.001 * size, keep);"},
        {(WRONG, "motion"), (WRONG, "time"), (ADVICE, "stop")},
    ),
    "a step that ends early": (
        {"fmi2DoStep": "return inner_fmi2DoStep(c, 0.999 * point, 0.999 * size, keep);"},
        {(WRONG, "motion"), (WRONG, "switching"), (WRONG, "time")},
    ),
    "an input without effect": (
        {"fmi2SetReal": IGNORED.format("REF(force)"), **KIND, **HELD},
        {(WRONG, "motion"), (WRONG, "reset")},
    ),
    "a parameter without effect in a run": (
        {"fmi2SetReal": IGNORED.format("REF(rate)"), **KIND},
        {(WRONG, "motion"), (WRONG, "reset"), (WRONG, "settings")},
    ),
    "input derivatives without effect": (
        HELD,
        {(WRONG, "motion"), (WRONG, "ramps")},
    ),
    "input derivatives that are halved": (
        {
            "fmi2SetRealInputDerivatives": "fmi2Real own[9]; for (size_t i = 0; i < n; i++) "
            "own[i] = value[i] / 2; return inner_fmi2SetRealInputDerivatives(c, vr, n, order, own);"
        },
        {(WRONG, "motion"), (WRONG, "ramps")},
    ),
    "a parameter that instances share": (
        {
            "fmi2SetReal": "for (size_t i = 0; i < n; i++) "
            "if (vr[i] == REF(rate)) limit = value[i]; return CALL;",
            "fmi2EnterInitializationMode": "const fmi2ValueReference r = REF(rate); "
            "const double v = limit; return v > 0 && fmi2SetReal(c, &r, 1, &v) ? fmi2Error : CALL;",
        },
        {(WRONG, "instances")},
    ),
    "stored states that share their memory": (
        {
            "fmi2GetFMUstate": "static fmi2FMUstate one; if (!*state) *state = one; "
            "const fmi2Status s = CALL; one = *state; return s;",
            "fmi2FreeFMUstate": "(void)c, (void)&inner_fmi2FreeFMUstate; *state = NULL; "
            "return fmi2OK;",
        },
        {(WRONG, "rollback")},
    ),
    "derivatives of outputs": ({"fmi2GetRealOutputDerivatives": TWICE}, {(WRONG, "slopes")}),
    "standard output": (
        {"fmi2EnterInitializationMode": 'puts("now"); return CALL;'},
        {(ADVICE, "quiet")},
    ),
    "a file in the current folder": (
        {"fmi2EnterInitializationMode": 'fclose(fopen("log.txt", "w")); return CALL;'},
        {(ADVICE, "quiet")},
    ),
    "instances that stay": (
        {"fmi2Instantiate": "limit += *(char *)memset(malloc(512), 0, 512); return CALL;"},
        {(ADVICE, "memory")},
    ),
    "steps that stay": (
        {"fmi2DoStep": "limit += *(char *)memset(malloc(64), 0, 64); return CALL;"},
        {(ADVICE, "memory")},
    ),
    "a time of its own": (
        {
            "fmi2GetReal": "fmi2Status s = CALL; for (size_t i = 0; i < n; i++) "
            "if (vr[i] == REF(time)) value[i] *= 1.5; return s;"
        },
        {(WRONG, "time")},
    ),
}


def found(path):
    return {(one.level, one.rule) for one in try_apart(path, timeout=24.0, trials=QUICK).findings}


@pytest.mark.slow
@pytest.mark.parametrize("mutation", MUTATIONS)
def test_mutation_is_found_by_its_rule(mutation, tmp_path):
    bodies, rules = MUTATIONS[mutation]
    assert found(wrapped(tmp_path, **bodies)) == rules


@pytest.mark.slow
def test_adjoint_derivative_that_is_wrong_is_found(tmp_path):
    options = {"fmi": 3, "adjoint": True}
    assert found(wrapped(tmp_path, options)) == set()
    wrong = "fmi3Status s = CALL; value[n - 1] *= 2; (void)p; return s;"
    path = wrapped(tmp_path, options, fmi3GetAdjointDerivative=wrong)
    assert found(path) == {(WRONG, "derivatives")}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("function", "change", "rule"),
    [
        ("fmi3DoStep", "*last = point", "calls"),
        ("fmi3DoStep", "*early = fmi3True", "calls"),
        ("fmi3GetNumberOfEventIndicators", "++*n", "exchange"),
    ],
)
def test_answer_of_fmi_3_that_is_wrong_is_found(function, change, rule, tmp_path):
    path = wrapped(tmp_path, {"fmi": 3}, **{function: f"fmi3Status s = CALL; {change}; return s;"})
    assert (WRONG, rule) in found(path)


@pytest.mark.slow
def test_sign_of_0_is_no_difference(tmp_path):
    model = Model("rest", description="rest", source="a test", stop_time=1.0)
    x = model.state("x", "1", 0.0, "x")
    model.derivative(x, -x)
    negative = (
        "fmi2Status s = CALL; for (size_t i = 0; limit && i < n; i++) if (value[i] == 0) "
        "value[i] = -0.0; "
    )
    bodies = {"fmi2Reset": "limit = 1; return CALL;", "fmi2GetReal": f"{negative}return s;"}
    path = wrapped(tmp_path, {}, model.freeze(), **bodies)
    assert try_apart(path, timeout=24.0, trials=(reset,)).findings == []


@pytest.mark.slow
def test_output_that_depends_on_the_times_before_is_found(tmp_path):
    model = Model("clock", description="clock", source="a test", stop_time=1.0)
    x = model.state("x", "1", 1.0, "x")
    model.derivative(x, -x)
    model.output("y", "1", x + model.t, "sum")
    ignored = "static double t; if (time > t && time < t + 0.005) return fmi2OK; t = time; "
    path = wrapped(tmp_path, {}, model.freeze(), fmi2SetTime=f"{ignored}return CALL;")
    assert (WRONG, "exchange") in found(path)


@pytest.mark.slow
def test_solver_that_is_too_coarse_is_advice_unless_its_step_is_declared(tmp_path):
    options, model = {"solver": "rk4", "step_size": 0.1}, decay(rate=20.0)
    large = set_attributes("DefaultExperiment", stepSize="0.1")
    for fmi, rules in ((2, {(ADVICE, "motion")}), (3, set())):
        path = wrapped(tmp_path, {**options, "fmi": fmi}, model)
        assert found(with_description(path, tmp_path / "a.fmu", large)) == rules


@pytest.mark.slow
def test_coarse_solver_of_a_model_at_rest_is_not_blamed_for_input_derivatives(tmp_path):
    model = Model("decay", description="decay", source="a test", stop_time=1.0)
    x, force = model.state("x", "m", 0.0, "place"), model.input("force", "m/s", 0.0, "push")
    model.derivative(x, force - 20 * x)
    model.output("y", "m", 2 * x, "twice")
    path = wrapped(tmp_path, {"solver": "rk4", "step_size": 0.1}, model.freeze())
    large = set_attributes("DefaultExperiment", stepSize="0.1")
    assert found(with_description(path, tmp_path / "a.fmu", large)) == {(ADVICE, "motion")}


@pytest.mark.slow
@pytest.mark.parametrize(
    "change",
    [
        set_attributes("ModelVariables/ScalarVariable[@name='x']/Real", start="1.1"),
        set_attributes("ModelVariables/ScalarVariable[@name='rate']/Real", start="0.6"),
    ],
)
def test_start_value_of_the_file_that_is_not_the_library_s_is_found(change, tmp_path):
    path = with_description(wrapped(tmp_path), tmp_path / "a.fmu", change)
    assert found(path) == {(WRONG, "defaults")}


def test_units_are_those_of_their_names_also_through_types(tmp_path):
    sound, path = wrapped(tmp_path), tmp_path / "a.fmu"

    def rules(change):
        return {(f.level, f.rule) for f in examine(with_description(sound, path, change))}

    without = rules(lambda _root: None)
    for change in (
        set_attributes("UnitDefinitions/Unit[@name='m/s']/BaseUnit", kg="1"),
        set_attributes("UnitDefinitions/Unit[@name='m/s']/BaseUnit", factor="3.6"),
        lambda root: unit_of_type(root, "furlong"),
    ):
        assert rules(change) - without - {(ADVICE, "unit-of-rate")} == {(WRONG, "unit")}
    assert rules(lambda root: unit_of_type(root, "m")) == without


def unit_of_type(root, unit):
    """Let the type of lengths name the unit, in place of the variables."""
    root.find("TypeDefinitions/SimpleType[@name='Length']/Real").set("unit", unit)
    for real in root.findall("ModelVariables/ScalarVariable/Real[@declaredType='Length']"):
        real.attrib.pop("unit", None)
