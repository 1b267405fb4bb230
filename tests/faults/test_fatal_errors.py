"""After a fatal error nothing of the instance is called, and a new run takes a new library."""

import sys

import pytest
from helpers.foreign_part import foreign_part

import cosim
from cosim.errors import CosimError, FmuError

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="it compiles for linux64")

LATE = "a call after a fatal error"
# a second run in the same library would go on
ONCE = "static int calls; if (time > 0.45 && calls++ == 0) return self->is_fatal = 1, 4"


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fatal")
    return {
        "bad": foreign_part(folder, "lag", fault=ONCE),
        "exchange": foreign_part(folder, "lag", fault=ONCE, interface="ModelExchange"),
        "keeper": foreign_part(folder, "lag", fault=ONCE, canSerializeFMUstate="false"),
        "lag": foreign_part(folder, "lag"),
    }


def of_system(files, bad, **way):
    parts = {"bad": files[bad], "lag": files["lag"]}
    wires = {"bad.u": "lag.y", "lag.u": "bad.y"}
    system = cosim.couple(parts, wires, start_values={"bad.x": 1.0}, stop_time=1.0)
    return lambda: system.simulate(**way)


def alone(files, **way):
    return lambda: cosim.simulate_fmu(files["bad"], stop_time=1.0, output_interval=0.1, **way)


RUNS = {
    "fmpy": lambda files: alone(files),
    "c": lambda files: alone(files, master="c"),
    "jacobi": lambda files: of_system(files, "bad", macro_step=0.1, method="jacobi"),
    "accurate": lambda files: of_system(files, "bad"),
    "threads": lambda files: of_system(files, "bad", threads=True),
    "exchange": lambda files: of_system(files, "exchange"),
}


@pytest.mark.parametrize("kind", RUNS)
def test_a_run_calls_nothing_after_a_fatal_error(kind, files, capfd):
    run = RUNS[kind](files)
    for _ in range(2):
        with pytest.raises(CosimError, match=r"4|fatal"):
            run()
    assert LATE not in capfd.readouterr().err


@pytest.mark.parametrize("bad", ["bad", "keeper"])
def test_a_session_of_a_system_begins_again_after_a_fatal_error(bad, files, capfd):
    system = cosim.couple({"bad": files[bad], "lag": files["lag"]}, {}, stop_time=1.0)
    with cosim.open(system, macro_step=0.1) as session:
        saved = session.save()
        session.advance(to=0.4)
        with pytest.raises(FmuError, match="fatal"):
            session.advance(to=1.0)
        with pytest.raises(FmuError, match="part 'bad' has reported a fatal error; begin again"):
            session.restore(saved)
        session.reset({"bad.x": 1.0})
        session.advance(to=0.4)
        assert session["bad.x"] == pytest.approx(2.718281828459045**-0.4, abs=1e-8)
        with pytest.raises(FmuError, match="fatal"):
            session.advance(to=1.0)
    assert LATE not in capfd.readouterr().err
