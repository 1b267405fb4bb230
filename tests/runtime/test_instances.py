"""Creation, names, memory and log messages of FMI 2.0 instances."""

import ctypes
from ctypes import c_char_p

import pytest
from helpers.harness import ERROR, NAN, OK, WARNING, Callbacks

CATEGORIES = ["logStatusWarning", "logStatusDiscard", "logStatusError"]


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"guid": "{other}"}, "its GUID is {other}, the binary's is {toy-guid}"),
        ({"guid": None}, "its GUID is missing"),
        ({"guid": ""}, "its GUID is , the"),
        ({"name": None}, "needs a name"),
        ({"name": ""}, "needs a name"),
        ({"name": " \t"}, "needs a name"),
        ({"interface": 2}, "model exchange and co-simulation only"),
    ],
)
def test_an_instance_that_cannot_be_is_null_and_the_log_says_why(fmi2, options, reason):
    for logging in (True, False):  # why there is no instance is always told
        fmu = fmi2(logging=logging, **options)
        assert fmu.component is None
        (message,) = fmu.messages
        assert message[0] == ERROR
        assert message[1] == "logStatusError"
        assert reason in message[2]


@pytest.mark.parametrize("name", ["%n%s%n%s", "#r1#", "\u00fc\u4e2d", "x" * 1_000_000])
def test_any_name_is_only_a_name(fmi2, name):
    fmu = fmi2(name=name)
    fmu.initialize()
    assert fmu("DoStep", 0.0, 1.0, 1) == ERROR
    assert fmu.said == "fmi2DoStep: not a function of model exchange"
    assert fmu.instance_names == {name.encode()}


def test_resources_are_never_read(fmi2):
    for location in (None, "", "file:///no/such", "file:/x%20y", "\u00fc", "http://x"):
        assert fmi2(resources=location).component


def test_without_callbacks_there_is_no_instance_and_without_logger_there_is_silence(library):
    create = library.fmi2Instantiate
    create.restype = ctypes.c_void_p
    assert create(b"one", 0, b"{toy-guid}", None, None, 0, 1) is None
    silent = Callbacks()
    assert create(b"one", 0, b"{other}", None, ctypes.byref(silent), 0, 1) is None
    component = ctypes.c_void_p(create(b"one", 0, b"{toy-guid}", None, ctypes.byref(silent), 0, 1))
    assert library.fmi2Terminate(component) == ERROR
    library.fmi2FreeInstance(component)


def test_calls_without_an_instance_are_errors_or_nothing(library):
    library.fmi2FreeInstance(None)
    assert library.fmi2Terminate(None) == ERROR
    assert library.fmi2GetReal(None, None, ctypes.c_size_t(0), None) == ERROR
    assert library.fmi2Reset(bytes(10000)) == ERROR  # memory that is no instance


def test_the_importers_memory_functions_are_never_called(library):
    """As canNotUseMemoryManagementFunctions says."""
    asked = []
    allocate = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_size_t, ctypes.c_size_t)(
        lambda count, size: asked.append((count, size))
    )
    free = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(asked.append)
    callbacks = Callbacks(
        allocate=ctypes.cast(allocate, ctypes.c_void_p), free=ctypes.cast(free, ctypes.c_void_p)
    )
    create = library.fmi2Instantiate
    create.restype = ctypes.c_void_p
    component = create(b"one", 0, b"{toy-guid}", None, ctypes.byref(callbacks), 0, 0)
    assert component
    state = ctypes.c_void_p()
    assert library.fmi2GetFMUstate(ctypes.c_void_p(component), ctypes.byref(state)) == OK
    assert library.fmi2FreeFMUstate(ctypes.c_void_p(component), ctypes.byref(state)) == OK
    library.fmi2FreeInstance(ctypes.c_void_p(component))
    assert asked == []


def test_versions(library):
    for function in (library.fmi2GetVersion, library.fmi2GetTypesPlatform):
        function.restype = c_char_p
    assert library.fmi2GetVersion() == b"2.0"
    assert library.fmi2GetTypesPlatform() == b"default"


# -- log categories -------------------------------------------------------------------------------


def choose(fmu, on, *names):
    texts = (c_char_p * len(names))(*(name.encode() for name in names))
    return fmu("SetDebugLogging", int(on), len(names), texts)


def provoke(fmu):
    """Cause one message of each category; return the categories that came through."""
    fmu.messages.clear()
    assert fmu("Reset") == OK
    assert fmu.set_up(tolerance=1.0) == WARNING
    fmu.set(q=NAN)
    fmu("Terminate")
    return [category for _, category, _ in fmu.messages]


def test_all_categories_are_on_with_logging_and_none_without(fmi2):
    assert provoke(fmi2()) == CATEGORIES
    assert provoke(fmi2(logging=False)) == []


def test_exactly_the_chosen_categories_are_on(me):
    assert choose(me, True, "logStatusError", "logStatusError") == OK
    assert provoke(me) == ["logStatusError"]
    assert choose(me, True, "logStatusWarning", "logStatusDiscard") == OK
    assert provoke(me) == CATEGORIES[:2]
    assert choose(me, False, "logStatusDiscard") == OK
    assert provoke(me) == CATEGORIES[:1]
    assert choose(me, False) == OK
    assert provoke(me) == []
    assert choose(me, True) == OK
    assert provoke(me) == CATEGORIES


def test_unknown_categories_are_an_error_and_change_nothing(me):
    assert choose(me, False, "logStatusError", "log%sAll") == ERROR
    assert me.said.startswith("fmi2SetDebugLogging: log category log?sAll is unknown; known: ")
    assert me("SetDebugLogging", 1, 1, None) == ERROR
    assert me("SetDebugLogging", 1, 1, (c_char_p * 1)(None)) == ERROR
    assert provoke(me) == CATEGORIES


def test_the_categories_have_the_names_of_the_standard():
    from helpers.harness import RUNTIME

    text = (RUNTIME / "logging.h").read_text()
    assert all(f'"{category}"' in text for category in CATEGORIES)


# -- independence ----------------------------------------------------------------------------------


def test_interleaved_instances_do_not_know_each_other(fmi2):
    alone = fmi2(1)
    alone.initialize(load=5.0)
    for k in range(20):
        assert alone("DoStep", k * 0.1, 0.1, 1) == OK
    crowd = [fmi2(1, name=f"instance {i}") for i in range(10)]
    for i, fmu in enumerate(crowd):
        fmu.initialize(load=5.0 if i == 7 else float(i), q=1.0 if i == 7 else 0.1 * i)
    for k in range(20):
        for fmu in crowd:
            assert fmu("DoStep", k * 0.1, 0.1, 1) == OK
    assert crowd[7].get(*alone.reference) == alone.get(*alone.reference)
    assert crowd[6].get("q") != alone.get("q")
