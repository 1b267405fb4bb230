"""Fifty-seven faults, each in a sound file of its own: all are found."""

import pytest
from helpers.fmu_files import set_attributes, with_description
from helpers.samples import sampled
from helpers.wrapped import wrapped

from cosim.errors import FmuError
from cosim.fmi.check.check import examine
from cosim.fmi.check.isolated import TRIALS, try_apart
from cosim.fmi.check.libraries import sources

pytestmark = pytest.mark.slow
QUICK = tuple(trial for trial in TRIALS if trial is not sources)
ALL = "for (size_t i = 0; i < n; i++)"
KEPT = (
    "fmi2ValueReference r = REF(force); double v; fmi2GetReal(c, &r, 1, &v); "
    "fmi2Status s = CALL; fmi2SetReal(c, &r, 1, &v); return s;"
)
IN_C = {  # wrapped functions, each with its body
    "derivatives that are those of the call before": (
        "fmi2GetDerivatives",
        "static double old; fmi2Status s = CALL; double now = x[0]; x[0] = old; old = now; "
        "return s;",
    ),
    "derivatives with another sign": (
        "fmi2GetDerivatives",
        f"fmi2Status s = CALL; {ALL} x[i] = -x[i]; return s;",
    ),
    "states that are read as 0": (
        "fmi2GetContinuousStates",
        f"fmi2Status s = CALL; {ALL} x[i] = 0; return s;",
    ),
    "states that cannot be set": (
        "fmi2SetContinuousStates",
        "(void)c, (void)x, (void)n; (void)&inner_fmi2SetContinuousStates; return fmi2OK;",
    ),
    "a time that cannot be set": (
        "fmi2SetTime",
        "(void)c, (void)time; (void)&inner_fmi2SetTime; return fmi2OK;",
    ),
    "a step that is an error": ("fmi2CompletedIntegratorStep", "(void)CALL; return fmi2Error;"),
    "a step that ends the run": (
        "fmi2CompletedIntegratorStep",
        "fmi2Status s = CALL; *terminate = fmi2True; return s;",
    ),
    "a step that moves a state": (
        "fmi2CompletedIntegratorStep",
        "double x[1]; fmi2Status s = CALL; fmi2GetContinuousStates(c, x, 1); x[0] *= 1.001; "
        "fmi2SetContinuousStates(c, x, 1); return s;",
    ),
    "nominal values of 0": (
        "fmi2GetNominalsOfContinuousStates",
        f"fmi2Status s = CALL; {ALL} x[i] = 0; return s;",
    ),
    "events that never end": (
        "fmi2NewDiscreteStates",
        "fmi2Status s = CALL; info->newDiscreteStatesNeeded = fmi2True; return s;",
    ),
    "a time event in the past": (
        "fmi2NewDiscreteStates",
        "fmi2Status s = CALL; info->nextEventTimeDefined = fmi2True; info->nextEventTime = -1; "
        "return s;",
    ),
    "an end that is an error": ("fmi2Terminate", "(void)CALL; return fmi2Error;"),
    "a reset that leaves a parameter": (
        "fmi2Reset",
        "fmi2ValueReference r = REF(rate); fmi2Real v; fmi2GetReal(c, &r, 1, &v); "
        "fmi2Status s = CALL; v *= 2; fmi2SetReal(c, &r, 1, &v); return s;",
    ),
    "a stored state that is ignored": (
        "fmi2SetFMUstate",
        "(void)c, (void)state; (void)&inner_fmi2SetFMUstate; return fmi2OK;",
    ),
    "bytes of a state that are 0": (
        "fmi2SerializeFMUstate",
        "fmi2Status s = CALL; memset(bytes, 0, size); return s;",
    ),
    "a size of a state that is 0": (
        "fmi2SerializedFMUstateSize",
        "fmi2Status s = CALL; *size = 0; return s;",
    ),
    "a directional derivative with another sign": (
        "fmi2GetDirectionalDerivative",
        "fmi2Status s = CALL; for (size_t i = 0; i < m; i++) value[i] = -value[i]; return s;",
    ),
    "a directional derivative that ignores the seed": (
        "fmi2GetDirectionalDerivative",
        "double one[9]; for (size_t i = 0; i < n; i++) one[i] = 1; "
        "return inner_fmi2GetDirectionalDerivative(c, unknowns, m, knowns, n, one, value);",
    ),
    "a token that is not compared": (
        "fmi2Instantiate",
        'return inner_fmi2Instantiate(name, kind, "TOKEN", place, functions, visible, log);',
    ),
    "another version": ("fmi2GetVersion", '(void)CALL; return "1.0";'),
    "another platform": ("fmi2GetTypesPlatform", '(void)CALL; return "standard64";'),
    "a log that cannot be set": ("fmi2SetDebugLogging", "(void)CALL; return fmi2Error;"),
    "a start time that is ignored": (
        "fmi2SetupExperiment",
        "return inner_fmi2SetupExperiment(c, hasTol, tolerance, 0, hasStop, end);",
    ),
    "start values that are lost": (
        "fmi2EnterInitializationMode",
        "fmi2ValueReference r = REF(rate); fmi2Real v = 0.5; fmi2SetReal(c, &r, 1, &v); "
        "return CALL;",
    ),
    "a parameter that others share": (
        "fmi2GetReal",
        f"static double k; fmi2Status s = CALL; {ALL} if (vr[i] == REF(y)) value[i] += k, k = 1; "
        "return s;",
    ),
    "an output of the step before": (
        "fmi2GetReal",
        f"fmi2Status s = CALL; {ALL} if (vr[i] == REF(y)) {{ double v = value[i]; "
        "value[i] = limit ? limit : v; limit = v; } return s;",
    ),
    "a second instance that is refused": (
        "fmi2Instantiate",
        "static int made; return made++ ? NULL : CALL;",
    ),
    "a value that is not a number": (
        "fmi2GetReal",
        f"fmi2Status s = CALL; {ALL} if (vr[i] == REF(y)) value[i] = NAN; return s;",
    ),
    "a step that does nothing": (
        "fmi2DoStep",
        "(void)c, (void)point, (void)size, (void)keep; (void)&inner_fmi2DoStep; return fmi2OK;",
    ),
    "a step that fails late": (
        "fmi2DoStep",
        "return point > 0.5 ? fmi2Discard : CALL;",
    ),
    "a step that takes inputs a step late": (
        "fmi2SetReal",
        f"static double old; fmi2Real own[9]; {ALL} {{ own[i] = value[i]; "
        "if (vr[i] == REF(force)) own[i] = old, old = value[i]; } "
        "return inner_fmi2SetReal(c, vr, n, own);",
    ),
    "a memory that every call takes": (
        "fmi2GetReal",
        "limit += *(char *)memset(malloc(999), 0, 999); return CALL;",
    ),
    "derivatives with another sign later": (
        "fmi2GetDerivatives",
        "double own[1]; fmi2GetContinuousStates(c, own, 1); fmi2Status s = CALL; "
        f"if (own[0] < 0.75) {ALL} x[i] = -x[i]; return s;",
    ),
    "a directional derivative that is wrong later": (
        "fmi2GetDirectionalDerivative",
        "double own[1]; fmi2GetContinuousStates(c, own, 1); fmi2Status s = CALL; "
        "if (own[0] < 0.75) for (size_t i = 0; i < m; i++) value[i] *= 1.05; return s;",
    ),
    "a parameter that keeps below a bound of its own": (
        "fmi2SetReal",
        f"{ALL} if (vr[i] == REF(rate) && value[i] > 0.6) return fmi2OK; return CALL;",
    ),
    "inputs that a stored state lacks": ("fmi2SetFMUstate", KEPT),
    "inputs that a reset leaves": ("fmi2Reset", KEPT),
    "a memory that every stored state takes": (
        "fmi2GetFMUstate",
        "limit += *(char *)memset(malloc(999), 0, 999); return CALL;",
    ),
    "a memory that every input takes": (
        "fmi2SetReal",
        "limit += *(char *)memset(malloc(999), 0, 999); return CALL;",
    ),
    "a count of steps that all instances share": (
        "fmi2DoStep",
        "static int k; return ++k > 500 ? fmi2Error : CALL;",
    ),
    "input derivatives that are doubled": (
        "fmi2SetRealInputDerivatives",
        f"fmi2Real own[9]; {ALL} own[i] = 2 * value[i]; "
        "return inner_fmi2SetRealInputDerivatives(c, vr, n, order, own);",
    ),
    "several values of which the first is set": (
        "fmi2SetReal",
        "return inner_fmi2SetReal(c, vr, n ? 1 : 0, value);",
    ),
    "a directional derivative by the first of several": (
        "fmi2GetDirectionalDerivative",
        "double own[9]; for (size_t i = 0; i < n; i++) own[i] = i ? 0 : seed[i]; "
        "return inner_fmi2GetDirectionalDerivative(c, unknowns, m, knowns, n, own, value);",
    ),
    "a stored state without its time": (
        "fmi2GetReal",
        f"fmi2Status s = CALL; {ALL} if (vr[i] == REF(time)) value[i] += limit; return s;",
        "fmi2SetFMUstate",
        "limit = 0.5; return CALL;",
    ),
    "a second reset that is an error": (
        "fmi2Reset",
        "return limit++ > 0 ? fmi2Error : CALL;",
    ),
    "a value that may not be set": (
        "fmi2SetReal",
        f"{ALL} if (vr[i] == REF(rate)) return fmi2Error; return CALL;",
    ),
}
VARIABLE = "ModelVariables/ScalarVariable[@name='{}']"
IN_XML = {
    "a state of another derivative": lambda r: r.find(VARIABLE.format("der(x)") + "/Real").set(
        "derivative", "1"
    ),
    "an unlisted dependency": set_attributes(
        "ModelStructure/Outputs/Unknown[@index='6']", dependencies=""
    ),
    "a unit's offset": set_attributes("UnitDefinitions/Unit[@name='m']/BaseUnit", offset="1"),
    "a parameter that is fixed": set_attributes(VARIABLE.format("rate"), variability="fixed"),
    "an event indicator": set_attributes(".", numberOfEventIndicators="1"),
    "a stop before the start": set_attributes("DefaultExperiment", stopTime="-1"),
    "bounds that exclude the start": set_attributes(VARIABLE.format("rate") + "/Real", min="1"),
    "a derivative order too high": set_attributes("CoSimulation", maxOutputDerivativeOrder="9"),
    "a library of another name": set_attributes("CoSimulation", modelIdentifier="other"),
    "a continuous output that is declared discrete": set_attributes(
        VARIABLE.format("y"), variability="discrete"
    ),
    "an output that is listed as local": set_attributes(VARIABLE.format("y"), causality="local"),
}


def found(path):
    try:
        trials = try_apart(path, timeout=12.0, trials=QUICK).findings
    except FmuError as error:
        return {str(error)}
    return {(one.level, one.rule) for one in (*examine(path), *trials)}


MUTATIONS = [*IN_C, *IN_XML]


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    return found(wrapped(tmp_path_factory.mktemp("sound")))


@pytest.mark.parametrize("name", sampled(MUTATIONS, (), MUTATIONS[::2]))
def test_mutation_is_found(name, sound, tmp_path):
    if name in IN_C:
        pairs = iter(IN_C[name])
        path = wrapped(tmp_path, **dict(zip(pairs, pairs, strict=True)))
    else:
        path = with_description(wrapped(tmp_path), tmp_path / "a.fmu", IN_XML[name])
    assert found(path) - sound
