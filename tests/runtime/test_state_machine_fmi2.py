"""Each FMI 2.0 function in each state: the tables of FMI 2.0.4, 3.2.3 and 4.2.4.

`x` allowed, `.` an error. Left out are the state "fatal", which this runtime does not have, and
the states of asynchronous steps. Arguments are such that only the state can be the reason.
"""

from ctypes import byref, c_double, c_int, c_size_t, c_void_p

import pytest
from helpers.harness import DISCARD, ERROR, OK, EventInfo, reals, references, rows_of

FORCE, ENERGY = 11, 18
TABLE = """
                               inst init event cont term error  |  inst init done failed term error
SetDebugLogging                 x    x     x    x    x     x    |   x    x    x     x     x     x
SetupExperiment                 x    .     .    .    .     .    |   x    .    .     .     .     .
EnterInitializationMode         x    .     .    .    .     .    |   x    .    .     .     .     .
ExitInitializationMode          .    x     .    .    .     .    |   .    x    .     .     .     .
Terminate                       .    .     x    x    .     .    |   .    .    x     x     .     .
Reset                           x    x     x    x    x     x    |   x    x    x     x     x     x
GetReal                         .    x     x    x    x     x    |   .    x    x     x     x     x
GetInteger                      .    x     x    x    x     x    |   .    x    x     x     x     x
GetBoolean                      .    x     x    x    x     x    |   .    x    x     x     x     x
GetString                       .    x     x    x    x     x    |   .    x    x     x     x     x
SetReal                         x    x     x    x    .     .    |   x    x    x     .     .     .
SetInteger                      x    x     x    .    .     .    |   x    x    x     .     .     .
SetBoolean                      x    x     x    .    .     .    |   x    x    x     .     .     .
SetString                       x    x     x    .    .     .    |   x    x    x     .     .     .
GetFMUstate                     x    x     x    x    x     x    |   x    x    x     x     x     x
SetFMUstate                     x    x     x    x    x     x    |   x    x    x     x     x     x
FreeFMUstate                    x    x     x    x    x     x    |   x    x    x     x     x     x
SerializedFMUstateSize          x    x     x    x    x     x    |   x    x    x     x     x     x
SerializeFMUstate               x    x     x    x    x     x    |   x    x    x     x     x     x
DeSerializeFMUstate             x    x     x    x    x     x    |   x    x    x     x     x     x
GetDirectionalDerivative        .    x     x    x    x     x    |   .    x    x     x     x     x
EnterEventMode                  .    .     x    x    .     .    |   .    .    .     .     .     .
NewDiscreteStates               .    .     x    .    .     .    |   .    .    .     .     .     .
EnterContinuousTimeMode         .    .     x    .    .     .    |   .    .    .     .     .     .
CompletedIntegratorStep         .    .     .    x    .     .    |   .    .    .     .     .     .
SetTime                         .    .     .    x    .     .    |   .    .    .     .     .     .
SetContinuousStates             .    .     .    x    .     .    |   .    .    .     .     .     .
GetEventIndicators              .    x     x    x    x     x    |   .    .    .     .     .     .
GetContinuousStates             .    x     x    x    x     x    |   .    .    .     .     .     .
GetDerivatives                  .    x     x    x    x     x    |   .    .    .     .     .     .
GetNominalsOfContinuousStates   x    x     x    x    x     x    |   .    .    .     .     .     .
SetRealInputDerivatives         .    .     .    .    .     .    |   x    x    x     .     .     .
GetRealOutputDerivatives        .    .     .    .    .     .    |   .    .    x     x     x     x
DoStep                          .    .     .    .    .     .    |   .    .    x     .     .     .
CancelStep                      .    .     .    .    .     .    |   .    .    .     .     .     .
GetStatus                       .    .     .    .    .     .    |   .    .    x     x     x     .
GetRealStatus                   .    .     .    .    .     .    |   .    .    x     x     x     .
GetIntegerStatus                .    .     .    .    .     .    |   .    .    x     x     x     .
GetBooleanStatus                .    .     .    .    .     .    |   .    .    x     x     x     .
GetStringStatus                 .    .     .    .    .     .    |   .    .    x     x     x     .
"""


def bring(fmu, mode):
    """Walk to a state by the calls that lead there."""
    if mode == "error":
        assert fmu("SetupExperiment", 0, 0.0, float("nan"), 0, 0.0) == ERROR
        return fmu
    ways = {
        "inst": (),
        "init": ("EnterInitializationMode",),
        "event": ("EnterInitializationMode", "ExitInitializationMode"),
        "term": ("EnterInitializationMode", "ExitInitializationMode", "Terminate"),
    }
    ways["done"] = ways["failed"] = ways["event"]
    ways["cont"] = (*ways["event"], "EnterContinuousTimeMode")
    assert fmu.set_up() == OK
    for step in ways[mode]:
        assert fmu(step) == OK
    if mode == "failed":
        assert fmu("DoStep", 0.0, 1e300, 1) == DISCARD
    return fmu


def call(fmu, function, snapshot, blob):
    force, energy, one, room = references(FORCE), references(ENERGY), reals(1.0), reals(0.0)
    four, order, integer, text = reals(0, 0, 0, 0), (c_int * 1)(1), c_int(), c_void_p()
    arguments = {
        "SetDebugLogging": (1, 0, None),
        "SetupExperiment": (0, 0.0, 0.0, 0, 0.0),
        "GetReal": (energy, 1, room),
        "SetReal": (force, 1, one),
        "GetFMUstate": (byref(c_void_p()),),
        "SetFMUstate": (snapshot,),
        "FreeFMUstate": (byref(c_void_p()),),
        "SerializedFMUstateSize": (snapshot, byref(c_size_t())),
        "SerializeFMUstate": (snapshot, blob, len(blob)),
        "DeSerializeFMUstate": (blob, len(blob), byref(c_void_p())),
        "GetDirectionalDerivative": (energy, 1, references(1), 1, one, room),
        "NewDiscreteStates": (byref(EventInfo()),),
        "CompletedIntegratorStep": (1, byref(c_int()), byref(c_int())),
        "SetTime": (0.1,),
        "SetContinuousStates": (four, 4),
        "GetEventIndicators": (reals(0.0), 1),
        "GetContinuousStates": (four, 4),
        "GetDerivatives": (four, 4),
        "GetNominalsOfContinuousStates": (four, 4),
        "SetRealInputDerivatives": (force, 1, order, one),
        "GetRealOutputDerivatives": (energy, 1, order, room),
        "DoStep": (0.0, 0.1, 1),
        "GetStatus": (0, byref(integer)),
        "GetRealStatus": (2, byref(c_double())),
        "GetIntegerStatus": (0, byref(integer)),
        "GetBooleanStatus": (3, byref(integer)),
        "GetStringStatus": (1, byref(text)),
    }
    typed = {"Integer", "Boolean", "String"}
    if function[:3] in {"Get", "Set"} and function[3:] in typed:
        return fmu(function, None, 0, None)
    return fmu(function, *arguments.get(function, ()))


def check(fmu, function, mode, mark):
    snapshot = fmu.take()
    blob = fmu.serialize(snapshot)
    bring(fmu, mode)
    fmu.messages.clear()
    status = call(fmu, function, snapshot, blob)
    said = " ".join(text for _, _, text in fmu.messages)
    assert (status != ERROR) == (mark == "x"), f"fmi2{function} {mode}: {status} {said}"
    if mark == ".":
        assert said.startswith(f"fmi2{function}: not a")  # not allowed, not a function of
        assert fmu("DoStep", 0.0, 0.1, 1) == ERROR  # an error is a state of its own


@pytest.mark.parametrize(("interface", "function", "marks"), rows_of(TABLE))
def test_functions_follow_the_table(fmi2, interface, function, marks):
    for mode, mark in marks.items():
        check(fmi2(interface), function, mode, mark)
