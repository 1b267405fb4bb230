"""FMI 3.0: what differs from FMI 2.0 - life cycle, adjoint derivatives, failing steps."""

import re
from ctypes import byref, c_bool, c_char_p, c_double, c_int32, c_size_t

import numpy as np
import pytest
from helpers.harness import DISCARD, ERROR, HEADERS, NAN, OK, WARNING, reals, references


def run(fmu, function, unknowns, knowns, seed, count):
    values = reals(*[NAN] * count)
    status = fmu(
        function, fmu.refs(*unknowns), len(unknowns), fmu.refs(*knowns), len(knowns),
        reals(*seed), len(seed), values, count,
    )  # fmt: skip
    assert status == OK, fmu.said
    return np.array(values)


# -- creation -------------------------------------------------------------------------------------


@pytest.mark.slow_rows("step-0-options0-its GUID is {other}")
@pytest.mark.parametrize(
    ("interface", "options", "reason"),
    [
        (0, {"token": "{other}"}, "its GUID is {other}"),
        (1, {"token": None}, "its GUID is missing"),
        (1, {"name": " "}, "needs a name"),
        (1, {"events": True}, "no events: instantiate with eventModeUsed = false"),
        (2, {}, "model exchange and co-simulation only"),
    ],
)
def test_an_instance_that_cannot_be_is_null_and_the_log_says_why(fmi3, interface, options, reason):
    fmu = fmi3(interface, **options)
    assert fmu.component is None
    assert reason in fmu.said


def test_every_function_of_the_header_is_exported_and_no_internal_one(library3):
    header = (HEADERS / "fmi3Functions.h").read_text()
    names = re.findall(r"^FMI3_Export \w+TYPE\s+(\w+);", header, re.MULTILINE)
    assert len(names) > 70
    assert all(hasattr(library3, name) for name in names)
    internal = ("refresh", "create", "variables", "model_ode", "do_step", "get_values")
    assert not any(hasattr(library3, prefix + name) for name in internal for prefix in ("", "toy_"))


def test_version(library3):
    library3.fmi3GetVersion.restype = c_char_p
    assert library3.fmi3GetVersion() == b"3.0"


# -- values ---------------------------------------------------------------------------------------


def test_start_values_can_be_read_before_initialization(fmi3):
    fmu = fmi3()
    assert fmu.set(q=0.5, mass=3.0) == OK
    assert fmu.get("q", "mass", "force", "time", "r") == [0.5, 3.0, 0.0, 0.0, 1.0]
    assert fmu.get("w") == [0.5]  # approximate: what the description says
    assert fmu("GetFloat64", fmu.refs("energy"), 1, reals(0), 1) == DISCARD
    assert fmu.said == "fmi3GetFloat64: energy has no value before initialization"


def test_the_number_of_values_must_fit(fmi3):
    for function in ("GetFloat64", "SetFloat64"):
        fmu = fmi3()
        assert fmu(function, fmu.refs("force"), 1, reals(0, 0), 2) == ERROR
        assert fmu.said == f"fmi3{function}: 2 values for 1 scalar variables"


def test_states_may_be_set_in_event_mode(fmi3):
    fmu = fmi3().initialize()
    assert fmu.set(q=0.25, w=2.0) == OK
    assert fmu.get("q", "w") == [0.25, 2.0]
    flags, time = [c_bool(True) for _ in range(5)], c_double(1.0)
    assert fmu("UpdateDiscreteStates", *map(byref, flags), byref(time)) == OK
    assert not any(flag.value for flag in flags)


def test_numbers_of_states_and_indicators(fmi3):
    fmu, count = fmi3(), c_size_t(99)
    assert fmu("GetNumberOfContinuousStates", byref(count)) == OK
    assert count.value == 4
    assert fmu("GetNumberOfEventIndicators", byref(count)) == OK
    assert count.value == 1


def test_variables_of_other_types_do_not_exist(fmi3):
    for function in ("GetInt32", "SetBoolean", "GetFloat32"):
        fmu = fmi3()
        assert fmu(function, references(0), 1, reals(0), 1) == ERROR
        assert fmu.said == f"fmi3{function}: the model has no variable of this type"


def test_experiment_and_tolerance_are_checked_on_entering_initialization(fmi3):
    assert fmi3().enter(start=NAN) == ERROR
    assert fmi3().enter(start=1.0, stop=0.0) == ERROR
    assert fmi3().enter(tolerance=-1.0) == ERROR
    fmu = fmi3()
    assert fmu.enter(tolerance=1e-30) == WARNING
    assert fmu("ExitInitializationMode") == OK


def test_categories_are_switched_one_by_one(fmi3):
    fmu = fmi3()
    names = (c_char_p * 1)(b"logStatusError")
    assert fmu("SetDebugLogging", False, 0, None) == OK
    fmu.set(q=NAN)
    assert fmu.messages == []
    assert fmu("SetDebugLogging", True, 1, names) == OK
    assert fmu("SetDebugLogging", True, 1, (c_char_p * 1)(b"logStatusDiscard")) == OK
    fmu.set(q=NAN)
    assert fmu("Terminate") == ERROR
    assert [category for _, category, _ in fmu.messages] == ["logStatusDiscard", "logStatusError"]


# -- derivatives ----------------------------------------------------------------------------------

UNKNOWNS = ("q", "q_dot", "v_dot", "w_dot", "s_dot", "a", "r", "energy", "wave", "log")


@pytest.mark.parametrize("mode", ["initialization", "continuous"])
def test_adjoint_and_directional_derivatives_have_the_same_jacobian(fmi3, mode):
    fmu = fmi3()
    assert fmu.set(q=0.7, v=-0.3, s=1.2, load=3.0, blow=0.2, push=0.7) == OK
    assert fmu.enter(start=0.4) == OK
    knowns, unknowns = ["time", "q", "v", "s", "force", "push", "mass", "load", "blow"], UNKNOWNS
    if mode == "initialization":
        unknowns = ("w", *UNKNOWNS)
    else:
        assert fmu("ExitInitializationMode") == fmu("EnterContinuousTimeMode") == OK
        assert fmu("SetTime", 0.3) == OK
        knowns.append("w")
    m, n = len(unknowns), len(knowns)
    columns = [run(fmu, "GetDirectionalDerivative", unknowns, knowns, e, m) for e in np.eye(n)]
    rows = [run(fmu, "GetAdjointDerivative", unknowns, knowns, e, n) for e in np.eye(m)]
    np.testing.assert_allclose(np.array(rows), np.column_stack(columns), rtol=0, atol=1e-14)
    assert np.abs(rows).max() > 1


def test_lengths_of_seed_and_sensitivity_must_fit(fmi3):
    for function in ("GetDirectionalDerivative", "GetAdjointDerivative"):
        for seed, result in ((2, 1), (1, 2)):
            fmu = fmi3().initialize()
            refs = fmu.refs("energy"), 1, fmu.refs("q"), 1
            assert fmu(function, *refs, reals(1, 1), seed, reals(0, 0), result) == ERROR


# -- co-simulation --------------------------------------------------------------------------------


def test_both_versions_compute_the_same_bits(fmi2, fmi3):
    old, new = fmi2(1), fmi3(1)
    old.initialize(load=3.0)
    new.initialize(load=3.0)
    for k in range(10):
        assert old("DoStep", k * 0.1, 0.1, 1) == OK
        assert new.step(k * 0.1, 0.1) == (OK, [False] * 3, new.get("time")[0])
    assert old.get(*old.reference) == new.get(*new.reference)


def test_a_step_that_fails_leaves_the_instance_as_it_was_and_a_shorter_one_may_do(fmi3):
    fmu = fmi3(1).initialize(blow=1.0)
    assert fmu.step(0.0, 0.5)[0] == OK
    before = fmu.get(*fmu.reference)
    assert fmu.step(0.5, 1.0) == (DISCARD, [False] * 3, 0.5)
    assert fmu.get(*fmu.reference) == before
    assert fmu.step(0.5, 0.25) == (OK, [False] * 3, 0.75)
    assert fmu.get("s") == [pytest.approx(4.0, rel=1e-6)]


@pytest.mark.parametrize(("time", "length"), [(0.0, NAN), (0.0, 0.0), (0.1, 0.1), (NAN, 0.1)])
def test_a_senseless_step_terminates(fmi3, time, length):
    fmu = fmi3(1).initialize()
    assert fmu.step(time, length)[0] == ERROR
    assert fmu.step(0.0, 0.1)[0] == ERROR


def test_output_derivatives(fmi3):
    fmu = fmi3(1).initialize()
    assert fmu.step(0.0, 0.3)[0] == OK
    rates = reals(0, 0)
    orders = (c_int32 * 2)(1, 1)
    assert fmu("GetOutputDerivatives", fmu.refs("q", "v"), 2, orders, rates, 2) == OK
    assert list(rates) == fmu.get("q_dot", "v_dot")
    assert fmu("GetOutputDerivatives", fmu.refs("q", "v"), 2, orders, rates, 3) == ERROR
