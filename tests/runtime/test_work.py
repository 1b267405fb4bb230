"""A call of co-simulation computes no more than it may, however long its step; counted in calls."""

import ctypes
import re
from pathlib import Path

import casadi as ca
import pytest
from helpers import harness
from helpers.harness import DISCARD, INCLUDES, OK, RUNTIME, run

from casadi_models.dae import Model
from cosim.fmi.export.options import FmuOptions
from cosim.fmi.export.package import source_files

SINES = 100  # in a right-hand side
# of it; measured 57,000, 540,000 and 184,000; with 20,000, 10,000 and 4000 steps in any model's
# call 240,000, 727,000 and more
MOST_CALLS = {"dop853": 100_000, "erk": 600_000, "rosenbrock": 250_000}
COUNTER = """
#include <math.h>
double __real_sin(double);
long sines;
double __wrap_sin(double x) { sines++; return __real_sin(x); }
"""


def shaken():
    """A state that is shaken by many sines, forever at the same pace."""
    model = Model("shaken", description="d", source="s", stop_time=1.0)
    x = model.state("x", "m", 1.0, "place")
    load = sum(ca.sin((50 + k) * model.t + k) for k in range(SINES))
    model.derivative(x, load - x)
    return model.freeze()


@pytest.fixture(scope="module", params=["dop853", "erk", "rosenbrock"])
def counted(request, tmp_path_factory):
    """Return an instance after initialization, and what counts its sines so far."""
    if harness.compiler() is None:
        pytest.skip("needs a C compiler")
    folder = tmp_path_factory.mktemp(request.param)
    files = source_files(shaken(), FmuOptions(tolerance=1e-8, solver=request.param))
    files = {Path(n).name: c for n, c in files.items() if n.startswith("sources/")}
    for name, content in {**files, "counter.c": COUNTER.encode()}.items():
        (folder / name).write_bytes(content)
    flags = ["-O2", "-fPIC", "-shared", "-fno-builtin-sin", "-Wl,--wrap=sin"]
    include = [f"-I{folder}", f"-I{RUNTIME}", *INCLUDES, f"-I{harness.HEADERS}"]
    library = folder / "shaken.so"
    run(
        [
            harness.compiler(),
            *flags,
            *include,
            folder / "fmu.c",
            folder / "counter.c",
            "-o",
            library,
            "-lm",
        ]
    )
    loaded = ctypes.CDLL(str(library))
    guid = re.search(r'MODEL_GUID "(.*)"', (folder / "model.h").read_text())[1]

    def fresh():
        fmu = harness.Fmu2(loaded, ["time", "x"], 1, guid=guid)
        assert fmu.set_up() == OK
        assert fmu("EnterInitializationMode") == fmu("ExitInitializationMode") == OK
        return fmu

    return fresh, ctypes.c_long.in_dll(loaded, "sines"), MOST_CALLS[request.param]


def step(counted, length):
    """Return status, right-hand sides and messages of one communication step."""
    fresh, sines, _ = counted
    fmu, before = fresh(), sines.value
    status = fmu("DoStep", ctypes.c_double(0.0), ctypes.c_double(length), 1)
    messages, calls = list(fmu.messages), (sines.value - before) / SINES
    fmu.free()
    return status, calls, messages


@pytest.mark.slow
@pytest.mark.parametrize("length", [1e4, 1e9, 1e15])
def test_absurd_step_is_discarded_after_bounded_work(counted, length):
    status, calls, messages = step(counted, length)
    assert status == DISCARD
    assert calls < counted[2]
    assert "came no further than" in messages[-1][2]


@pytest.mark.quick_rows("dop853")
def test_step_of_a_second_has_all_the_work_it_needs(counted):
    status, calls, _ = step(counted, 1.0)
    assert status == OK
    assert calls < 20_000
