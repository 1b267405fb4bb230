"""Sessions: the bits of straight runs, and exact values."""

import gc
import random
from math import exp
from weakref import ref

import casadi as ca
import numpy as np
import pytest
from helpers.detours import detour, straight
from helpers.event_models import ball, sampled, stopping
from helpers.fmi_cases import VERSIONS
from helpers.foreign_part import foreign_part
from helpers.session_models import MODELS, driven_ball
from helpers.small_models import decay, growing
from helpers.typed_part import typed_part

import cosim
from casadi_models.dae import Model
from cosim.errors import (
    FmuError,
    InitialConditionError,
    ParameterError,
    UnknownName,
    UsageError,
)

STEP = 0.01


# -- bits -----------------------------------------------------------------------------------------


@pytest.mark.quick_share(0.3)
@pytest.mark.slow_rows("step-decay-2", "step-decay-3")
@VERSIONS
@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("by", ["step", "to"])
def test_session_has_the_bits_and_events_of_a_whole_run(name, fmi, by, fmus):
    whole = cosim.simulate_fmu(
        fmus[name, fmi], interface="CoSimulation", stop_time=1.0, output_interval=STEP
    )
    with cosim.open(fmus[name, fmi], stop_time=1.0) as session:
        rows, events = [session.get(whole.names)], []
        for time in whole.time[1:]:
            events += session.advance(STEP) if by == "step" else session.advance(to=time)
            rows.append(session.get(whole.names))
            assert session.time == time
    np.testing.assert_array_equal(rows, whole.values)
    assert [(e.time, e.name) for e in events] == [(e.time, e.name) for e in whole.events]


def detours_of(subject, seed, rows=120, **options):
    """Take sessions of a subject through detours by steps and by times."""
    choose = random.Random(seed)
    push = [round(choose.uniform(-2, 2), 2) for _ in range(rows)]
    times = [(k + 1) * STEP for k in range(rows)]
    with cosim.open(subject) as session:
        expected = straight(session, push, times)
    for step in (STEP, None):
        detour(cosim.open(subject), push, expected, choose, step=step, **options)


@VERSIONS
@pytest.mark.parametrize("name", MODELS)
def test_detours_change_no_bit(name, fmi, fmus):
    detours_of(fmus[name, fmi], f"{name} {fmi}")


def test_detours_of_a_foreign_fmu_change_no_bit(tmp_path):
    detours_of(foreign_part(tmp_path, "lag"), 3, rows=60)


# -- exact values -------------------------------------------------------------------------------


def test_reading_beside_the_run_does_not_lead_to_another_solution():
    """x' = z, where z^3 - 3 z + u = 0 has the solution sqrt(3) at u = 0, and -sqrt(3)."""
    model = Model("fold", stop_time=5.0)
    x, z = model.state("x", "1", 0.0, "x"), model.algebraic("z", "1", np.sqrt(3), "z")
    model.derivative(x, z)
    model.equation(z**3 - 3 * z + model.input("u", "1", 0.0, "u"))
    with cosim.open(model.freeze()) as fold:
        fold.advance(0.1)
        fold.set(u=2.5)
        assert fold["z"] < -2  # the only solution there
        fold.set(u=0.0)
        fold.advance(0.1)
        assert fold["x"] == pytest.approx(0.2 * np.sqrt(3), rel=1e-12)  # before: 0


def test_values_read_beside_the_run_violate_nothing():
    model = Model("narrow", stop_time=5.0)
    x, u = model.state("x", "1", 1.0, "x"), model.input("u", "1", 0.0, "u")
    model.derivative(x, -x)
    model.output("sum", "1", x + u, "sum")
    model.limit(x + u < 1.5, "the sum is below 1.5")
    with cosim.open(model.freeze()) as session, cosim.open(model.freeze()) as straight:
        for one in (session, straight):
            one.advance(0.1)
        session.set(u=3.0)
        assert session["sum"] > 3
        session.set(u=0.0)
        for one in (session, straight):
            one.advance(0.1)
        assert session.invalid is None  # before: from 0.1 s, with an input that no step had
        assert session.save() == straight.save()
        session.set(u=3.0)
        session.advance(0.1)
        assert session.invalid.startswith("invalid from 0.2 s")


def test_decay_meets_its_closed_form(session):
    session.set(force=1.0)
    session.advance(to=1.0)
    assert session["x"] == pytest.approx(2 - np.exp(-0.5), rel=1e-9)  # measured 1e-11
    np.testing.assert_array_equal(session.get(["y", "x"]), [session["y"], session["x"]])
    assert session["y"] == 2 * session["x"]


def test_start_is_at_rest_and_nothing_moves_by_itself(session):
    assert (session.time, session["x"], session.advance(0), session.time) == (0.0, 1.0, (), 0.0)
    assert session.advance(to=0.0) == ()


def test_equal_steps_do_not_add_up_rounding(session):
    for _ in range(70):
        session.advance(0.1)
    assert session.time == 7.0


def test_events_are_returned_by_the_step_in_which_they_happen():
    with cosim.open(ball()) as session:
        assert session.advance(to=0.4) == ()
        (impact,) = session.advance(to=0.5)
    assert impact.name == "impact"
    assert impact.time == pytest.approx(np.sqrt(2 / 9.81), abs=1e-9)  # measured 1e-12


@pytest.mark.parametrize("beyond", [1 + 2.3e-16, 1.001, 2.0])
def test_value_set_to_a_threshold_is_not_beyond_it(beyond):
    model = Model("threshold", stop_time=1.0)
    x, u = model.state("x", "1", 0.0, "state"), model.input("u", "1", 0.0, "input")
    count = model.discrete("count", "1", 0, "events")
    model.derivative(x, u)
    model.when(u > 1, {count: count + 1}, name="above")
    with cosim.open(model.freeze()) as session:
        session.advance(0.1)
        session.set(u=1.0)
        saved = session.save()
        assert (session.advance(0.1), session["count"]) == ((), 0.0)
        session.restore(saved)
        session.set(u=beyond)
        (event,) = session.advance(0.1)
        assert (event.time, session["count"]) == (pytest.approx(0.1, abs=1e-12), 1.0)


def test_set_takes_units_vectors_and_names_and_rejects_them_as_a_whole(session):
    session.set(force="36 km/h")
    assert session["force"] == 10.0
    session.set([2])
    assert session["force"] == 2.0
    session.set({"rate": 0.25, "force": 1})
    assert session["rate"] == 0.25
    with pytest.raises(ParameterError, match="nan is not finite"):
        session.set(force=5.0, rate=float("nan"))
    assert session["force"] == 1.0


def test_reset_takes_start_values_for_once(session):
    session.advance(0.3)
    session.reset({"x": 3.0})
    assert (session.time, session["x"], session["force"]) == (0.0, 3.0, 0.0)
    session.reset(start_time=2.0)
    assert (session.time, session["x"]) == (2.0, 1.0)
    with pytest.raises(UnknownName, match="did you mean x"):
        session.reset({"X": 1.0})
    assert session.time == 2.0


def test_prepared_resets_have_the_bits_of_the_first_one():
    dae = driven_ball()
    with cosim.open(dae) as session:
        for values in ({"h": 0.5, "wind": 0.2}, {"h": 0.3, "wind": -0.2}):
            rows = []
            for _ in range(3):
                session.reset(values)
                session.advance(0.5)
                rows.append(session.get())
            np.testing.assert_array_equal(rows[1:], [rows[0]] * 2)
            with cosim.open(dae, start_values=values) as other:
                other.advance(0.5)
                np.testing.assert_array_equal(other.get(), rows[0])
        with pytest.raises(ParameterError, match="not finite"):
            session.reset({"h": float("nan"), "wind": 0.2})
        assert session.time == 0.5


@pytest.mark.slow
def test_start_values_through_outputs_and_of_calculated_states():
    with cosim.open("bicycle", start_values={"speed": "4 m/s"}) as bike:
        assert bike["speed"] == pytest.approx(4.0, abs=1e-12)
        assert bike.copy()["speed"] == bike["speed"]
        bike.reset({"phi": 0.2})
        assert (bike["phi"], bike["speed"]) == (0.2, pytest.approx(4.0, abs=1e-12))
        with pytest.raises(InitialConditionError, match="calculated"):
            bike.reset({"theta": 0.1})


def test_linear_system_is_that_of_linearize():
    expected = cosim.linearize("bar_on_frame/reduced", outputs=["theta", "M_phi"])
    with cosim.open("bar_on_frame/reduced") as bar:
        found = bar.linearize(["theta", "M_phi"])
        assert bar.states == expected.states
        assert bar.linearize().C.shape == (len(bar.outputs), len(bar.states))
    for matrix, reference in zip(
        found, (expected.A, expected.B, expected.C, expected.D), strict=True
    ):
        np.testing.assert_allclose(matrix, reference, rtol=1e-9, atol=1e-9)


@pytest.mark.slow
def test_system_of_models_runs_as_one_model():
    model = Model("follower")
    place, target = model.state("x", "m", 1.0, "place"), model.input("target", "m", 0.0, "target")
    model.derivative(place, 0.5 * (target - place))
    parts = {"first": decay(), "second": model.freeze()}
    system = cosim.couple(parts, {"second.target": "first.y"})
    with cosim.open(system, copies=1) as copies, cosim.open(system) as session:
        assert session.outputs == copies.outputs == system.dae.observed
        assert session.get().tolist() == copies.get()[:, 0].tolist()
        C = session.linearize().C
        assert C.tolist() == session.linearize(system.dae.observed).C.tolist()
    with cosim.open(system, start_values={"first.x": 2.0}) as session:
        session.set({"first.force": 1.0})
        saved = session.save()
        session.advance(to=1.0)
        x = session["second.x"]
        session.restore(saved)
        session.advance(to=1.0)
        assert session["second.x"] == x
        assert session["first.x"] == pytest.approx(2.0, abs=1e-9)  # at rest
        assert x == pytest.approx(4 - 3 * np.exp(-0.5), rel=1e-9)  # x' = (4 - x)/2 from 1


def test_linearize_rejects_samples_and_files_without_derivatives(tmp_path):
    with cosim.open(sampled()) as session, pytest.raises(UsageError, match="has samples"):
        session.linearize()
    path = foreign_part(tmp_path, "lag", providesDirectionalDerivative="false")
    with cosim.open(path) as session, pytest.raises(FmuError, match="no directional derivatives"):
        session.linearize()


def cornered():
    """Return x' = -x + u limited to 1, with |x| as output."""
    model = Model("cornered", stop_time=1.0)
    x, u = model.state("x", "1", 0.5, "state"), model.input("u", "1", 0.0, "input")
    model.derivative(x, -x + ca.fmin(ca.fmax(u, -1), 1))
    model.output("size", "1", ca.fabs(x), "size")
    return model.freeze()


def test_linear_system_is_rejected_where_it_has_two_sides(tmp_path):
    dae = cornered()
    with cosim.open(dae) as session:
        A, B, C, _ = session.linearize()
        assert (A.tolist(), B.tolist(), C.ravel().tolist()[-1]) == ([[-1]], [[1]], 1)
        session.set(u=1.0)
        with pytest.raises(InitialConditionError, match="fmin of u is exactly at 0 at 0 s"):
            session.linearize()  # before: B = 1, that of one side
        session.set(u=2.0)
        assert session.linearize().B.tolist() == [[0]]
        session.reset({"x": 0.0})
        assert session.linearize(["x"]).A.tolist() == [[-1]]
        with pytest.raises(InitialConditionError, match="fabs of x"):
            session.linearize(["size"])
    path = cosim.export_fmu(dae, tmp_path / "cornered.fmu")
    assert cosim.linearize(path, start_values={"u": 0.999}).B.tolist() == [[1]]
    assert cosim.linearize(path, start_values={"u": 1.001}).B.tolist() == [[0]]
    for values, what in (({"u": 1.0}, r"der\(x\) has .* to u"), ({"x": 0.0}, "size has .* to x")):
        with pytest.raises(FmuError, match=f"{what} beside the initial state"):
            cosim.linearize(path, start_values=values)  # before: the system of one side


# -- failures -----------------------------------------------------------------------------------


@VERSIONS
def test_failed_session_can_be_restored_and_reset(fmi, tmp_path):
    path = cosim.export_fmu(growing(), tmp_path / "growing.fmu", fmi=fmi)
    with cosim.open(path) as session:
        session.advance(0.5)
        saved = session.save()
        with pytest.raises(FmuError, match="DoStep"):
            session.advance(to=1.5)
        with pytest.raises(FmuError, match="has failed; go on with restore or reset"):
            session.get(["x"])
        session.restore(saved)
        assert session["x"] == pytest.approx(2.0, rel=1e-8)  # of 1/(1 - t)
        session.set(u=-4.0)  # x stays at 2
        session.advance(to=5.0)
        assert session["x"] == pytest.approx(2.0, abs=1e-3)
        session.reset()
        assert session["x"] == 1.0


def test_run_that_the_model_ends_says_why_and_can_go_back():
    dae = stopping()
    with cosim.open(dae) as session:
        saved = session.save()
        while session.stop is None and session.time < 10:
            session.advance(0.25)
        assert session.stop
        with pytest.raises(FmuError, match="has ended at"):
            session.advance(0.25)
        assert session.get().shape == (len(session.outputs),)
        session.restore(saved)
        assert (session.time, session.stop) == (0.0, None)


def test_fatal_error_closes_the_file_for_good(tmp_path):
    path = foreign_part(tmp_path, "lag", fault="return 4;")
    with cosim.open(path) as session:
        with pytest.raises(FmuError, match="DoStep"):
            session.advance(0.1)
        with pytest.raises(FmuError, match="fatal error; open it again"):
            session.reset()


LOST = "if (time > 0.3) return self->x = NAN, 0"


def test_state_of_a_file_from_elsewhere_that_is_not_finite_ends_the_session(tmp_path):
    path = foreign_part(tmp_path, "lag", fault=LOST)
    with cosim.open(path, start_values={"x": 1.0}) as session:
        session.advance(to=0.25)
        saved = session.save()
        session.advance(to=0.5)
        with pytest.raises(FmuError, match=r"its state x is not finite at 0\.75 s"):
            session.advance(to=0.75)
        session.restore(saved)
        assert session["x"] == pytest.approx(exp(-0.25), abs=1e-8)


def test_copy_whose_state_is_not_finite_fails_alone(tmp_path):
    path = foreign_part(tmp_path, "lag", fault=f"if (self->u > 0) {{ {LOST}; }}")
    with cosim.open(path, copies=2, start_values={"x": 1.0, "u": [0.0, 1.0]}) as copies:
        for _ in range(3):
            copies.advance(0.25)
        assert list(copies.reasons) == [1]
        assert "its state x is not finite at 0.75 s" in copies.reasons[1]
        np.testing.assert_allclose(copies["x"], [exp(-0.75), np.nan], atol=1e-8)


@pytest.mark.parametrize("kind", ["file", "system"])
def test_value_that_is_not_finite_is_named(kind, tmp_path):
    path = foreign_part(tmp_path, "lag", fault="if (time > 0.3) return self->u = NAN, 0")
    model = path if kind == "file" else cosim.couple({"a": path}, {})
    rate = "der(x)" if kind == "file" else "a.der(x)"
    with cosim.open(model) as session:
        session.advance(0.4)
        session.advance(0.4)
        assert session.get().tolist() == [0.0]
        with pytest.raises(FmuError, match=r"der\(x\) is not finite at 0\.8 s; leave it out"):
            session.get([rate])


ANSWER = """    *event = *ends = *early = false;
    return *last = time + size, (void)no_rollback, 0;"""


@pytest.mark.parametrize("writes", ["*ends = true, *last = time + size", "*early = true"])
def test_answer_of_a_step_is_not_that_of_an_earlier_one(writes, tmp_path):
    """The file writes its end or early return only, and no falsehood."""
    path = typed_part(tmp_path, fault=(ANSWER, f"    if (time > 0.35) {writes}; return 0;"))
    with cosim.open(path) as session:
        session.advance(0.2)
        saved = session.save()
        session.advance(0.2)
        if "ends" in writes:
            session.advance(0.2)
            assert (session.time, session.stop) == (0.2 * 3, "the FMU ends the run")
        else:
            with pytest.raises(FmuError, match="returned early"):
                session.advance(0.2)
        session.restore(saved)
        session.advance(to=0.3)  # before: it ended at 0.6 s again, or returned early again
        assert (session.time, session.stop) == (0.3, None)


def test_end_without_a_time_is_that_of_the_step(tmp_path):
    path = typed_part(tmp_path, fault=(ANSWER, "    if (time > 0.35) *ends = true; return 0;"))
    with cosim.open(path) as session:
        for _ in range(3):
            session.advance(0.2)
        assert (session.time, session.stop) == (0.2 * 3, "the FMU ends the run")  # before: 0 s
    for master in ("fmpy", "c"):
        run = cosim.simulate_fmu(path, output_interval=0.2, master=master)
        assert (run.stats["stop_time"], run.time[-1]) == (0.2 * 3, 0.2 * 3)


def test_status_that_is_none_of_the_fmi_ends_the_session(tmp_path):
    path = typed_part(tmp_path, fault=(ANSWER, "    return -1;"))
    with cosim.open(path) as session, pytest.raises(FmuError, match="status -1"):
        session.advance(0.2)  # before: it went on


def test_session_that_nobody_closes_is_freed_with_its_states(tmp_path):
    session = cosim.open(foreign_part(tmp_path, "lag", canSerializeFMUstate="false"))
    session.set(u=1.0)
    session.restore(session.save())
    seen, freed = ref(session), []
    session._stack.callback(freed.append, True)
    del session
    gc.collect()
    assert (seen(), freed) == (None, [True])


def test_closed_session_rejects_every_call(session):
    saved = session.save()
    session.close()
    session.close()
    calls = (session.save, session.copy, session.reset, session.linearize, session.get,
             lambda: session.advance(0.1), lambda: session.set(force=1.0),
             lambda: session.restore(saved), lambda: session["x"])  # fmt: skip
    for call in calls:
        with pytest.raises(FmuError, match="session is closed; open it again"):
            call()
    assert "closed" in repr(session)


def test_system_of_models_is_one_model_also_from_a_file(tmp_path):
    toml = tmp_path / "shafts.toml"
    toml.write_text("[parts]\na = 'crank_shaft'\n[start_values]\n'a.omega' = 10.0\n")
    with cosim.open(toml) as session:
        session.advance(to=1.0)  # alpha is 10 rad/s2
        assert session["a.omega"] == pytest.approx(20.0, abs=1e-9)
    with pytest.raises(UsageError, match="macro_step is for systems with FMUs as parts"):
        cosim.open(toml, macro_step=0.01)


def test_elements_of_arrays_are_inputs_outputs_and_states(tmp_path):
    """x' = u + A x with A[1,2] = 2 and u = (0, 1) from (0, 1): x = (2 t + t^2, 1 + t)."""
    path = typed_part(tmp_path)
    start = {"A[1,2]": 2.0, "x[2]": 1.0}
    with cosim.open(path, start_values=start) as session:
        assert session.inputs[:2] == ("u[1]", "u[2]")
        assert session.outputs[:2] == ("y[1]", "y[2]")
        assert session.states == ("x[1]", "x[2]")
        session.set({"u[2]": 5.0, "u[1]": 0.0})
        session.set({"u[2]": 1.0})
        session.advance(1.0)
        found = session.get(["y[2]", "y[1]", "u[2]", "u[1]", "A[1,2]"])
        np.testing.assert_allclose(found, [2, 3, 1, 0, 2], rtol=1e-7)
        session.set({"u[1]": 7.0})
        assert session.get(["u[1]", "u[2]"]).tolist() == [7, 1]
        with pytest.raises(UsageError, match="n gives sizes of arrays"):
            session.reset({"n": 3})
        session.reset()
        assert session.get(["x[1]", "x[2]"]).tolist() == [0, 1]
