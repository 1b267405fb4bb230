"""A part that ends the run ends that of its system where it is, within a macro step as well."""

import math
import sys

import numpy as np
import pytest
from helpers.foreign_part import foreign_part

import cosim

END = math.sqrt(0.1)  # of a fall by 0.5 m at 10 m/s2, s
LAG = 0.222318387158601  # x(END) of x' = 1 - 5 t^2 - x from 0: -9 + 10 t - 5 t^2 + 9 exp(-t)
GIVEN = [{"macro_step": 0.1, "method": m} for m in ("jacobi", "gauss_seidel")]
CUBIC = [{"macro_step": 0.1, "method": m} for m in ("extrapolated", "iterated")]
ACCURATE = {"accuracy": 1e-6}
EVERY_WAY = pytest.mark.parametrize(
    "way", [*GIVEN, *CUBIC, ACCURATE], ids=lambda way: "-".join(map(str, way.values()))
)


@pytest.fixture(scope="module")
def models():
    fall, lag = cosim.Model("fall", stop_time=2.0), cosim.Model("lag", stop_time=2.0)
    h, v = fall.state("h", "m", 1.0, "height"), fall.state("v", "m/s", 0.0, "speed")
    fall.derivative(h, v)
    fall.derivative(v, -10.0)
    fall.stop(h < 0.5, "low enough")
    x = lag.state("x", "m", 0.0, "height")
    lag.derivative(x, lag.input("u", "m", 0.0, "input") - x)
    return fall.freeze(), lag.freeze()


@pytest.fixture(scope="module", params=[2, 3])
def files(request, models, tmp_path_factory):
    folder = tmp_path_factory.mktemp("parts")
    return [cosim.export_fmu(m, folder / f"{m.name}.fmu", fmi=request.param) for m in models]


def run_of(parts, way, **abilities):
    system = cosim.couple(
        dict(zip(("a", "b"), parts, strict=True)),
        {"b.u": "a.h"},
        stop_time=2.0,
        output_interval=0.05,
        abilities=abilities,
    )
    return system.simulate(**way)


def assert_ends(run, way):
    """Constant inputs are 1 and 0.95 in the first step; the lag is less than 0.025 off by them."""
    assert run.status == "complete"
    assert run.stats["stop_time"] == run.time[-1] == pytest.approx(END, abs=3e-9)
    np.testing.assert_allclose(run.time[:-1], 0.05 * np.arange(7), atol=1e-12)
    assert run.final["a.h"] == pytest.approx(0.5, abs=1e-8)
    bound = 0.025 if way in GIVEN else 5e-3 if way in CUBIC else 1e-6  # cubics that start as lines
    assert run.final["b.x"] == pytest.approx(LAG, abs=bound)


@EVERY_WAY
def test_system_of_models_ends_where_its_part_does(way, models):
    assert_ends(run_of(models, way), way)


@EVERY_WAY
@pytest.mark.parametrize(
    "abilities",
    [
        {},
        {"a": "no rollback"},
        {"b": "no rollback"},
        {"a": "no event mode"},
        {"a": "no co-simulation"},
    ],
    ids=lambda lacks: "-".join(f"{k} {v}" for k, v in lacks.items()) or "all",
)
def test_system_of_files_ends_where_its_part_does(way, abilities, files):
    """Before, it ended where the macro step had begun, at 0.3 s; with accuracy at 0.29 s."""
    assert_ends(run_of(files, way, **abilities), way)


@pytest.mark.parametrize("way", [*GIVEN, *CUBIC], ids=lambda way: way["method"])
def test_session_ends_where_the_run_does(way, files):
    """Before, with constant inputs it ended where the macro step had begun, at 0.3 s."""
    system = cosim.couple(dict(zip("ab", files, strict=True)), {"b.u": "a.h"}, stop_time=2.0)
    run = system.simulate(**way)
    with cosim.open(system, **way) as session:
        session.advance(to=1.0)
        assert session.time == pytest.approx(run.time[-1], abs=1e-12)
        assert session.time == pytest.approx(END, abs=3e-9)
        np.testing.assert_allclose(session.get(run.names), [*run.final.values()], atol=1e-12)
        assert session.stop == "low enough (part 'a')"


# motor.y = 1 at its start, and the motor discards what leads beyond 0.456 s; whether it steps there
# first and tells so, as the FMI wants
STOPS = (
    "if (time + size > 0.456 + 1e-12) {{ {steps} self->ended = 1; self->time = {time}; return 2; }}"
)
TELLS = STOPS.format(steps="fmi2DoStep(c, time, 0.456 - time, 1);", time="0.456")
SILENT = STOPS.format(steps="", time="time")
WRONG = STOPS.format(steps="", time="NAN")


@pytest.mark.skipif(sys.platform != "linux", reason="it compiles for linux64")
@EVERY_WAY
@pytest.mark.parametrize("saves", ["true", "false"])
@pytest.mark.parametrize("fault", [TELLS, SILENT, WRONG], ids=["tells", "silent", "wrong"])
def test_foreign_part_that_discards_a_step_as_it_ends(way, saves, fault, tmp_path):
    """x' = -x from 1 alone; a part that does not tell where it ended is known at steps only."""
    motor = foreign_part(tmp_path, "lag", fault=fault, canGetAndSetFMUstate=saves)
    parts = {"motor": motor, "load": foreign_part(tmp_path, "lag")}
    wires, start = {"load.u": "motor.y"}, {"motor.x": 1.0}
    system = cosim.couple(parts, wires, start_values=start, stop_time=1.0, output_interval=0.01)
    run = system.simulate(**way)
    end = run.stats["stop_time"]
    if fault == TELLS or (way == ACCURATE and saves == "true"):
        assert end == run.time[-1] == pytest.approx(0.456, abs=3e-9)
    else:
        assert 0.3 <= end <= 0.456
    assert run.final["motor.y"] == pytest.approx(math.exp(-run.time[-1]), abs=1e-5)


@pytest.mark.skipif(sys.platform != "linux", reason="it compiles for linux64")
@pytest.mark.parametrize("master", ["fmpy", "c"])
@pytest.mark.parametrize(("fault", "end"), [(TELLS, 0.456), (SILENT, 0.4), (WRONG, 0.4)])
def test_file_alone_that_discards_a_step_as_it_ends(fault, end, master, tmp_path):
    """Where it tells no time, it is known to have come to the step's begin; fmpy showed the end."""
    path = foreign_part(tmp_path, "lag", fault=fault)
    run = cosim.simulate_fmu(path, start_values={"x": 1.0}, output_interval=0.1, master=master)
    assert run.stats["stop_time"] == run.time[-1] == pytest.approx(end)
    assert run.final["y"] == pytest.approx(math.exp(-end))
