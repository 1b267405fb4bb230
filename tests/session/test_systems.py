"""Sessions of systems with FMUs as parts: the bits of whole runs, and going back as one."""

import random
import subprocess
import sys
from dataclasses import replace
from math import exp

import casadi as ca
import numpy as np
import pytest
from helpers.detours import detour, straight
from helpers.foreign_part import foreign_part
from helpers.session_systems import EVERY_WAY, LINUX, LOOP, STEP, WAYS, balls, lags

import cosim
from cosim.coupling.connectors import Connector, End
from cosim.errors import FmuError, ParameterError, UnknownName, UsageError
from cosim.fmi.run.arrays import Access

pytestmark = LINUX


SYSTEMS = {
    "loop": lags,
    "chain": lambda files: lags(files, wires={"load.u": "motor.y"}),
    "foreign state": lambda files: lags(files, "keeper", wires={"load.u": "motor.y"}),
    "events": lambda files: balls(files, "ball"),
    "exchange": lambda files: balls(files, "exchange"),
    "exchange, driven": lambda files: cosim.couple(
        {"lag": files["lag"], "ball": files["exchange"]}, {"ball.wind": "lag.y"}, stop_time=1.0
    ),
    "exchange, kept": lambda files: balls(files, "kept"),
    "stateless": lambda files: balls(files, "stateless"),
}
SERIALIZED = ("loop", "chain", "events", "exchange", "exchange, driven")


# -- bits -----------------------------------------------------------------------------------------


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("group", [1, 5])
@pytest.mark.parametrize("way", WAYS[:-1], ids=lambda way: way.get("method", "iterated"))
@pytest.mark.parametrize("name", SYSTEMS)
def test_session_has_the_bits_and_events_of_a_whole_run(name, way, group, files):
    system = SYSTEMS[name](files)
    whole = system.simulate(**way, output_interval=group * STEP)
    with cosim.open(system, stop_time=1.0, **way) as session:
        rows, events = [session.get()], []
        for time in whole.time[1:]:
            events += session.advance(to=time)
            rows.append(session.get())
    assert session.outputs == whole.names
    np.testing.assert_array_equal(rows, whole.values)
    assert [(e.time, e.name) for e in events] == [(e.time, e.name) for e in whole.events]


@pytest.mark.quick_share(0.3)
@pytest.mark.slow_rows(*(f"{way}-{name}" for way in ("extrapolated", "gauss") for name in SYSTEMS))
@EVERY_WAY
@pytest.mark.parametrize("name", [name for name in SYSTEMS if name != "stateless"])
def test_detours_change_no_bit(name, way, files):
    choose = random.Random(name)
    system = SYSTEMS[name](files)
    push = [round(choose.uniform(-2, 2), 2) for _ in range(60)]
    times = np.cumsum([choose.choice([STEP, 0.003, 0.0571, 1e-6]) for _ in push]).tolist()
    with cosim.open(system, **way) as session:
        expected = straight(session, push, times)
    serialized = name in SERIALIZED
    detour(
        cosim.open(system, **way),
        push,
        expected,
        choose,
        moves=100,
        copies=serialized,
        outlives=serialized,
    )


@EVERY_WAY
def test_loop_meets_its_closed_form(way, files):
    bound = 4e-3 if way.get("method") in ("jacobi", "gauss_seidel") else 5e-5 if way else 1e-7
    with cosim.open(lags(files), **way) as session:
        for time in (0.1, 0.35, 1.0, 4.0):  # beyond the stop time of the system, too
            session.advance(to=time)
            assert session["motor.x"] == pytest.approx((1 + exp(-2 * time)) / 2, abs=bound)


# -- exact values ---------------------------------------------------------------------------------


def test_start_is_that_of_the_system_and_nothing_moves_by_itself(files):
    with cosim.open(lags(files), macro_step=STEP) as session:
        start = session.get(["motor.x", "load.x", "load.u"])
        np.testing.assert_array_equal(start, [1, 0, 1])
        assert session.advance(0) == session.advance(to=0.0) == ()
        np.testing.assert_array_equal(session.get(["motor.x", "load.x", "load.u"]), start)
        assert (session.time, session.stop, session.invalid) == (0.0, None, None)


@EVERY_WAY
def test_input_is_felt_at_once_and_constant_within_steps(way, files):
    """x' = u - x from 1 with u = 3 from 0.5 on: 3 + (exp(-0.5) - 3) exp(-(t - 0.5))."""
    system = lags(files, wires={"load.u": "motor.y"})
    with cosim.open(system, **way) as session:
        assert session.inputs == ("motor.u",)
        session.advance(to=0.5)
        session.set([3.0])
        assert session["motor.u"] == 3.0
        session.advance(to=1.0)
        assert session["motor.x"] == pytest.approx(3 + (exp(-0.5) - 3) * exp(-0.5), abs=1e-9)


# -- ends -----------------------------------------------------------------------------------------

_LEFT_OPEN = """
import cosim
session = cosim.open(cosim.couple({{"a": {lag!r}, "b": {lag!r}}}, {{"a.u": "b.y"}}), **{way})
session.advance(to=0.1)
"""


@EVERY_WAY
def test_python_ends_with_a_session_that_is_open(way, files):
    """Before, parts were freed first, and their states then crashed the process (139)."""
    script = _LEFT_OPEN.format(lag=str(files["lag"]), way=way)
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


# -- failures -------------------------------------------------------------------------------------


@EVERY_WAY
def test_failed_session_is_restored(way, files, tmp_path):
    bad = foreign_part(tmp_path, "lag", fault="if (time + size > 0.45) return 3")
    parts = {"motor": bad, "load": files["lag"]}
    system = cosim.couple(parts, LOOP, start_values={"motor.x": 1.0}, stop_time=1.0)
    with cosim.open(system, **way) as session:
        session.advance(to=0.2)
        saved, values = session.save(), session.get()
        with pytest.raises(FmuError, match="part 'motor' failed"):
            session.advance(to=0.6)
        with pytest.raises(FmuError, match="the session has failed; go on with restore or reset"):
            session.advance(0.1)
        session.restore(saved)
        np.testing.assert_array_equal(session.get(), values)
        session.advance(to=0.4)
        ahead = session["motor.x"]
        with pytest.raises(FmuError):
            session.advance(to=0.6)
        session.reset()
        session.advance(to=0.2)
        session.advance(to=0.4)
        assert session["motor.x"] == ahead


def test_state_that_is_not_finite_ends_the_session_where_nothing_shows_it(files, tmp_path):
    bad = foreign_part(tmp_path, "lag", fault="if (time > 0.4) self->x = NAN")
    system = cosim.couple({"motor": bad, "load": files["lag"]}, {}, stop_time=1.0)
    with cosim.open(system) as session:
        session.advance(to=0.3)
        saved = session.save()
        with pytest.raises(FmuError, match=r"part 'motor': its state x is not finite at 0\.7 s"):
            session.advance(to=0.7)
        session.restore(saved)
        assert session["motor.x"] == 0.0


def rooted(folder, lag, drives):
    """A decay x' = -z x with z^2 = k, which has no solution below 0, and a lag that it drives."""
    model = cosim.Model("rooted", stop_time=1.0)
    x, k = model.state("x", "1", 1.0, "state"), model.input("k", "1", 1.0, "square")
    z = model.algebraic("z", "1", 1.0, "root")
    model.derivative(x, -z * x)
    model.equation(z**2 - k)
    path = cosim.export_fmu(model.freeze(), folder / "rooted.fmu", fmi=3)
    return cosim.couple({"root": path, "lag": lag}, {"lag.u": f"root.{drives}"}, stop_time=1.0)


def test_failed_initialization_is_named_and_a_reset_goes_on(files, tmp_path):
    system, words = rooted(tmp_path, files["lag"], "x"), r"part 'root': .*no solution"
    with pytest.raises(FmuError, match=words):
        system.simulate(start_values={"root.k": -1.0})
    with cosim.open(system) as session:
        saved = session.save()
        with pytest.raises(FmuError, match=words):
            session.reset({"root.k": -1.0})
        with pytest.raises(FmuError, match="has not begun; begin again with reset"):
            session.restore(saved)
        session.reset()
        session.restore(saved)
        session.advance(to=0.5)
        assert session["root.x"] == pytest.approx(exp(-0.5), abs=1e-7)


def test_failure_after_a_rejected_value_ends_the_session(files, tmp_path, monkeypatch):
    """An FMU keeps a value that it rejects, and takes the one before it no more."""
    accept, given = Access.set, []

    def reject(access, values):
        if not given:
            accept(access, values)
        given.append(values)
        raise FmuError("rejected")

    with cosim.open(rooted(tmp_path, files["lag"], "z")) as session:
        saved = session.save()
        with monkeypatch.context() as patched:
            patched.setattr(Access, "set", reject)
            with pytest.raises(FmuError, match=r"part 'root' failed .*no solution"):
                session.set({"root.k": -1.0})
        with pytest.raises(FmuError, match="the session has failed"):
            session.advance(0.1)
        session.restore(saved)
        session.advance(to=0.5)
        assert session["root.x"] == pytest.approx(exp(-0.5), abs=1e-7)


def test_copy_has_the_events_and_the_violation_of_its_session(tmp_path, files):
    model = cosim.Model("limited", stop_time=1.0)
    x, u = model.state("x", "1", 0.0, "state"), model.input("u", "1", 0.0, "input")
    n = model.discrete("n", "1", 0, "count")
    model.derivative(x, 1.0)
    model.limit(x < 0.3, "x is small")
    model.when(u > 1, {n: n + 1}, name="above")
    path = cosim.export_fmu(model.freeze(), tmp_path / "limited.fmu", fmi=3)
    system = cosim.couple({"a": path, "lag": files["lag"]}, {"lag.u": "a.x"}, stop_time=1.0)
    with cosim.open(system) as session:
        session.advance(to=0.5)
        session.set({"a.u": 2.0})
        with session.copy() as other:
            assert "a: not fulfilled: x is small" in session.invalid
            assert other.invalid == session.invalid
            (event,), (same,) = session.advance(to=0.6), other.advance(to=0.6)
            assert (event.name, event.time) == (same.name, same.time)
            assert event.name == "a: above"


def test_part_that_ends_the_run_is_named_with_the_time(files):
    model = cosim.Model("ending", stop_time=1.0)
    x = model.state("x", "1", 0.0, "state")
    model.derivative(x, 1.0)
    model.stop(x > 0.3, "far enough")
    system = cosim.couple({"a": model.freeze(), "b": files["lag"]}, {"b.u": "a.x"}, stop_time=1.0)
    with cosim.open(system, macro_step=STEP) as session:
        session.advance(to=0.2)
        saved = session.save()
        session.advance(to=0.9)
        assert "far enough" in session.stop
        assert "part 'a'" in session.stop
        assert session.time == pytest.approx(0.3, abs=1e-9)
        assert session["a.x"] == pytest.approx(0.3, abs=1e-9)
        with pytest.raises(FmuError, match="the run has ended at 0"):
            session.advance(0.1)
        session.restore(saved)
        assert (session.time, session.stop) == (0.2, None)


def test_parts_that_cannot_do_it_are_named(files):
    with cosim.open(lags(files, "forward"), macro_step=STEP) as session:
        session.advance(0.1)
        with pytest.raises(FmuError, match="cannot save its state, as motor cannot; begin again"):
            session.save()
        session.reset()
        assert (session.time, session["motor.x"]) == (0.0, 1.0)
    stateless = cosim.open(balls(files, "stateless"))
    with stateless, pytest.raises(FmuError, match="cannot save its state, as ball cannot"):
        stateless.save()
    with cosim.open(lags(files, "keeper")) as session:
        saved = session.save()
        with pytest.raises(FmuError, match="cannot be copied"):
            session.copy()
        session.reset()
        with pytest.raises(UsageError, match="another session"):
            session.restore(saved)


def test_steps_of_one_length_are_the_only_ones(files):
    with cosim.open(lags(files, "fixed"), macro_step=STEP) as session:
        session.advance(to=0.05)
        with pytest.raises(ParameterError, match=r"no multiple of .* s after the start"):
            session.advance(0.005)
        session.advance(to=0.06)
        assert session.time == 0.06


@pytest.mark.parametrize("way", [{"macro_step": 0.1}, {}], ids=str)
def test_equal_steps_reach_the_stop_time_whatever_their_rounding(way, files):
    """3 * 0.1 is 0.3 and one unit in the last place."""
    with cosim.open(lags(files), stop_time=0.3, **way) as session:
        for _ in range(3):
            session.advance(0.1)
        bound = 1e-3 if way else 1e-7  # measured 5e-4 and 2e-11
        assert session["motor.x"] == pytest.approx((1 + exp(-0.6)) / 2, abs=bound)
        with pytest.raises(ParameterError, match=r"after the stop time 0\.3 s"):
            session.advance(1e-6)


WRONG = [
    (lambda s: s.set({"nothing.u": 1.0}), UnknownName, "no part 'nothing'"),
    (lambda s: s.set({"motor.v": 1.0}), UnknownName, "no variable 'v'"),
    (lambda s: s.set({"load.u": 1.0}), UsageError, "load.u is connected and cannot be set"),
    (lambda s: s.set({"motor.x": 1.0}), UsageError, "motor.x cannot be set during a run"),
    (lambda s: s.set({"motor.u": "1 m"}), ParameterError, "motor.u"),
    (lambda s: s.set({"motor.u": float("nan")}), ParameterError, "nan is not finite"),
    (lambda s: s.set([1.0, 2.0]), UsageError, "one for each of its 1 inputs motor.u"),
    (lambda s: s.get(["x"]), UnknownName, "no part 'x'"),
    (lambda s: s.advance(), UsageError, "give one"),
    (lambda s: s.advance(to=2.0), ParameterError, "after the stop time 1 s"),
    (lambda s: s.reset({"load.u": 1.0}), UsageError, "load.u is connected and given a value"),
    (lambda s: s.restore(b""), UsageError, "no saved session, or damaged"),
    (lambda s: s.linearize(), UsageError, "linearize"),
]


@pytest.mark.parametrize(("call", "kind", "words"), WRONG, ids=[words for *_, words in WRONG])
def test_wrong_calls_say_why_and_change_nothing(call, kind, words, files):
    with cosim.open(lags(files, wires={"load.u": "motor.y"}), stop_time=1.0) as session:
        session.advance(0.1)
        time, values = session.time, session.get()
        with pytest.raises(kind, match=words):
            call(session)
        np.testing.assert_array_equal((session.time, *session.get()), (time, *values))


# -- from files -----------------------------------------------------------------------------------


def test_connector_without_influence_is_set_and_not_read(files):
    system = cosim.couple({"a": files["lag"]}, {}, stop_time=1.0)
    entry = Connector("g", None, is_input=True, ends=(End(("a", "u"), 0.0, 3.0),))
    with cosim.open(replace(system, connectors={"g": entry})) as session:
        session.set(g=5.0)
        assert session["a.u"] == 3.0
        with pytest.raises(UsageError, match=r"g has no influence on a\.u"):
            session.get(["g"])


def test_systems_open_from_their_files(files, tmp_path):
    system = lags(files, wires={"load.u": "motor.y"})
    toml = tmp_path / "pair.toml"
    toml.write_text(
        f"stop_time = 1.0\n[parts]\nmotor = '{files['lag']}'\nload = '{files['lag']}'\n"
        "[connections]\n'load.u' = 'motor.y'\n[start_values]\n'motor.x' = 1.0\n"
    )
    package = system.write_ssp(tmp_path / "pair.ssp")
    for place in (toml, str(toml), package, str(package)):
        with cosim.open(place, start_values={"motor.u": 2.0}, macro_step=STEP) as session:
            session.advance(to=0.5)
            assert session["motor.x"] == pytest.approx(2 - exp(-0.5), abs=1e-9)


def test_file_for_model_exchange_only_is_opened_as_a_part(files):
    with pytest.raises(FmuError, match="model exchange only") as caught:
        cosim.open(files["exchange"])
    call = str(caught.value).partition(": cosim.open")[2]
    with eval(f"cosim.open{call}", {"cosim": cosim}) as session:
        (sample,) = session.advance(to=0.1)
        assert sample.time == pytest.approx(0.05, abs=1e-12)


def test_copies_of_a_system_are_advanced_together(files):
    system = lags(files, wires={"load.u": "motor.y"})
    with cosim.open(system, copies=3, start_values={"motor.u": [1.0, 2.0, 3.0]}) as copies:
        saved = copies.save()
        copies.advance(to=0.5)
        expected = [u + (1 - u) * exp(-0.5) for u in (1, 2, 3)]
        np.testing.assert_allclose(copies["motor.x"], expected, rtol=0, atol=1e-9)
        copies.restore(saved)
        np.testing.assert_array_equal(copies["motor.x"], [1, 1, 1])


@pytest.mark.parametrize(
    ("ends", "expected"),
    [
        ([(0.0, 3.0)], [3.0, 3.0]),
        ([(1.0, 0.0), (2.0, 0.0)], [0.5, 0.7]),
        ([(0.1, 0.3)], [0.35, 0.37]),
    ],
)
def test_copies_of_a_system_set_its_connectors(ends, expected, files):
    system = cosim.couple({"a": files["lag"], "b": files["lag"]}, {}, stop_time=1.0)
    pairs = (End((part, "u"), *end) for part, end in zip("ab", ends, strict=False))
    entry = Connector("g", None, is_input=True, ends=tuple(pairs))
    with cosim.open(replace(system, connectors={"g": entry}), copies=2) as copies:
        copies.set(g=[0.5, 0.7])
        before = copies.get(["a.u", "b.u"])
        assert before[0].tolist() == expected
        with pytest.raises(ParameterError, match=r"copy 1: .*not finite"):
            copies.set(g=[0.2, np.nan])
        np.testing.assert_array_equal(copies.get(["a.u", "b.u"]), before)  # to the bit


def test_closing_frees_the_instances_and_runs_go_on_beside_a_session(files):
    system = lags(files)
    session = cosim.open(system, macro_step=STEP)
    session.advance(0.1)
    run = system.simulate(macro_step=STEP, output_interval=STEP)
    other = session.copy()
    session.close()
    with pytest.raises(FmuError, match="closed"):
        session.get()
    session.close()
    other.advance(to=1.0)
    assert other["motor.y"] == run.final["motor.y"]
    other.close()


def test_solver_is_that_of_the_parts(files):
    with pytest.raises(UsageError, match="its parts have their own solvers"):
        cosim.open(lags(files), solver="cvodes")
    with pytest.raises(UsageError, match="leave macro_step out"):
        cosim.open(lags(files), accuracy=1e-6, macro_step=STEP)


def test_a_session_says_that_its_error_has_no_estimate_and_what_limits_it(tmp_path):
    """A wheel of 0.4 kg m2 sticks to a driven one of 5, which no macro step follows exactly."""
    fast, slow = cosim.Model("fast", stop_time=1.0), cosim.Model("slow", stop_time=1.0)
    w, torque = fast.state("w", "rad/s", 0.16, "speed"), fast.input("T", "N.m", 0.0, "torque")
    fast.derivative(w, (torque - 1.5) / 5)
    own, other = slow.state("w", "rad/s", 0.0, "speed"), slow.input("u", "rad/s", 0.0, "speed")
    slow.derivative(own, 2.5 * ca.sign(other - own) / 0.4)
    slow.output("R", "N.m", -2.5 * ca.sign(other - own), "reaction")
    parts = {
        "a": fast.freeze(),
        "b": str(cosim.export_fmu(slow.freeze(), tmp_path / "b.fmu", fmi=3)),
    }
    system = cosim.couple(parts, {"a.T": "b.R", "b.u": "a.w"})
    with cosim.open(system, macro_step=0.1) as session:
        alone = "the error of the coupling is not estimated: no second run checks the macro steps"
        assert session.note == alone
        session.advance(to=1.0)
        assert session.note.startswith(f"{alone}; ")
        assert "a relation of part 'b' slides along 0" in session.note
        session.reset()
        assert session.note == alone
