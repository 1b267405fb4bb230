"""Each FMI 3.0 function in each state: the allowed calls of FMI 3.0.2, 2.3, 3.2 and 4.2.

`x` allowed, `.` an error. Left out are the states of structural parameters, of intermediate
updates and of scheduled execution, which the models here do not have. After an error the state is
"terminated". Arguments are such that only the state can be the reason.
"""

from ctypes import byref, c_bool, c_double, c_int32, c_size_t, c_void_p

import pytest
from helpers.harness import ERROR, OK, reals, references, rows_of

FORCE, ENERGY = 11, 18
SIZES = (8, 16, 32, 64)
INTEGERS = [f"{sign}{size}" for sign in ("Int", "UInt") for size in SIZES]
TYPES = ["Float32", *INTEGERS, "Boolean", "String", "Binary"]
CLOCKS = ["Interval", "Shift"]
TABLE = """
                                 inst init event cont term  |  inst init step term
SetDebugLogging                   x    x     x    x    x    |   x    x    x    x
EnterInitializationMode           x    .     .    .    .    |   x    .    .    .
ExitInitializationMode            .    x     .    .    .    |   .    x    .    .
EnterEventMode                    .    .     .    x    .    |   .    .    .    .
Terminate                         .    .     x    x    .    |   .    .    x    .
Reset                             x    x     x    x    x    |   x    x    x    x
GetFloat64                        x    x     x    x    x    |   x    x    x    x
GetOther                          x    x     x    x    x    |   x    x    x    x
SetFloat64                        x    x     x    x    .    |   x    x    x    .
SetOther                          x    x     x    .    .    |   x    x    x    .
GetClock                          .    .     x    .    .    |   .    .    .    .
SetClock                          .    .     x    .    .    |   .    .    .    .
GetNumberOfVariableDependencies   .    .     .    .    .    |   .    .    .    .
GetVariableDependencies           .    .     .    .    .    |   .    .    .    .
GetFMUState                       x    x     x    x    x    |   x    x    x    x
SetFMUState                       x    x     x    x    x    |   x    x    x    x
FreeFMUState                      x    x     x    x    x    |   x    x    x    x
SerializedFMUStateSize            x    x     x    x    x    |   x    x    x    x
SerializeFMUState                 x    x     x    x    x    |   x    x    x    x
DeserializeFMUState               x    x     x    x    x    |   x    x    x    x
GetDirectionalDerivative          .    x     x    x    x    |   .    x    x    x
GetAdjointDerivative              .    x     x    x    x    |   .    x    x    x
EnterConfigurationMode            .    .     .    .    .    |   .    .    .    .
ExitConfigurationMode             .    .     .    .    .    |   .    .    .    .
Interval                          .    x     x    .    .    |   .    x    .    .
Shift                             .    x     .    .    .    |   .    x    .    .
EvaluateDiscreteStates            .    .     x    .    .    |   .    .    .    .
UpdateDiscreteStates              .    .     x    .    .    |   .    .    .    .
EnterContinuousTimeMode           .    .     x    .    .    |   .    .    .    .
CompletedIntegratorStep           .    .     .    x    .    |   .    .    .    .
SetTime                           .    .     .    x    .    |   .    .    .    .
SetContinuousStates               .    .     .    x    .    |   .    .    .    .
GetContinuousStateDerivatives     .    x     x    x    x    |   .    .    .    .
GetEventIndicators                .    x     x    x    x    |   .    .    .    .
GetContinuousStates               .    x     x    x    x    |   .    .    .    .
GetNominalsOfContinuousStates     .    x     x    x    x    |   .    .    .    .
GetNumberOfEventIndicators        x    x     x    x    x    |   .    .    .    .
GetNumberOfContinuousStates       x    x     x    x    x    |   .    .    .    .
EnterStepMode                     .    .     .    .    .    |   .    .    .    .
GetOutputDerivatives              .    .     .    .    .    |   .    .    x    x
DoStep                            .    .     .    .    .    |   .    .    x    .
ActivateModelPartition            .    .     .    .    .    |   .    .    .    .
"""


def functions(row):
    """The functions that share a row of the table."""
    if row in {"GetOther", "SetOther"}:
        return [row[:3] + kind for kind in TYPES]
    if row in CLOCKS:
        return [f"{verb}{row}{form}" for verb in ("Get", "Set") for form in ("Decimal", "Fraction")]
    return [row]


def bring(fmu, mode):
    """Walk to a state by the calls that lead there."""
    way = {
        "inst": (),
        "init": ("Enter",),
        "event": ("Enter", "ExitInitializationMode"),
        "step": ("Enter", "ExitInitializationMode"),
        "cont": ("Enter", "ExitInitializationMode", "EnterContinuousTimeMode"),
        "term": ("Enter", "ExitInitializationMode", "Terminate"),
    }[mode]
    for step in way:
        assert (fmu.enter() if step == "Enter" else fmu(step)) == OK


def call(fmu, function, snapshot, blob):
    force, energy, one, room = references(FORCE), references(ENERGY), reals(1.0), reals(0.0)
    four, flags = reals(0, 0, 0, 0), [byref(c_bool()) for _ in range(5)]
    arguments = {
        "SetDebugLogging": (True, 0, None),
        "EnterInitializationMode": (False, 0.0, 0.0, False, 0.0),
        "GetFloat64": (energy, 1, room, 1),
        "SetFloat64": (force, 1, one, 1),
        "GetNumberOfVariableDependencies": (ENERGY, byref(c_size_t())),
        "GetVariableDependencies": (ENERGY, None, None, None, None, 0),
        "GetFMUState": (byref(c_void_p()),),
        "SetFMUState": (snapshot,),
        "FreeFMUState": (byref(c_void_p()),),
        "SerializedFMUStateSize": (snapshot, byref(c_size_t())),
        "SerializeFMUState": (snapshot, blob, len(blob)),
        "DeserializeFMUState": (blob, len(blob), byref(c_void_p())),
        "GetDirectionalDerivative": (energy, 1, references(1), 1, one, 1, room, 1),
        "GetAdjointDerivative": (energy, 1, references(1), 1, one, 1, room, 1),
        "UpdateDiscreteStates": (*flags, byref(c_double())),
        "CompletedIntegratorStep": (True, *flags[:2]),
        "SetTime": (0.1,),
        "SetContinuousStates": (four, 4),
        "GetContinuousStateDerivatives": (four, 4),
        "GetEventIndicators": (reals(0.0), 1),
        "GetContinuousStates": (four, 4),
        "GetNominalsOfContinuousStates": (four, 4),
        "GetNumberOfEventIndicators": (byref(c_size_t()),),
        "GetNumberOfContinuousStates": (byref(c_size_t()),),
        "GetOutputDerivatives": (energy, 1, (c_int32 * 1)(1), room, 1),
        "DoStep": (0.0, 0.1, True, *flags[:3], byref(c_double())),
        "ActivateModelPartition": (0, 0.0),
    }
    alone = function in {"Terminate", "Reset"} or function.startswith(("Enter", "Exit", "Evaluate"))
    default = () if alone else (None, 0, None, None, 0)
    return fmu(function, *arguments.get(function, default))


def check(fmu, function, mode, mark):
    snapshot = fmu.take()
    blob = fmu.serialize(snapshot)
    bring(fmu, mode)
    fmu.messages.clear()
    status = call(fmu, function, snapshot, blob)
    said = " ".join(text for _, _, text in fmu.messages)
    assert (status != ERROR) == (mark == "x"), f"fmi3{function} {mode}: {status} {said}"
    if mark == ".":
        assert said.startswith((f"fmi3{function}: not a", f"fmi3{function}: the model does not"))
        assert fmu("Terminate") == ERROR  # the error has terminated the instance
        assert fmu("GetFloat64", references(0), 1, reals(0), 1) == OK
    fmu("FreeFMUState", byref(snapshot))


@pytest.mark.parametrize(("interface", "row", "marks"), rows_of(TABLE))
def test_functions_follow_the_table(fmi3, interface, row, marks):
    for function in functions(row):
        for mode, mark in marks.items():
            check(fmi3(interface), function, mode, mark)
