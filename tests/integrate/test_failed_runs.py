"""Runs that end early: what was computed is kept, and it is said where and why."""

import copy
import os
import pickle
import re
import select
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pkgutil import resolve_name

import casadi as ca
import numpy as np
import pytest
from helpers.event_models import ball
from helpers.oscillators import (
    INTERPRETED,
    WAYS,
    bad_output,
    blow_up,
    emptying,
    oscillator,
    singular,
)

import cosim
from casadi_models.dae import Model
from cosim.api import simulate
from cosim.errors import InitialConditionError, Interrupted, SolverError
from cosim.integrate.call import INTERRUPTED
from cosim.integrate.location import Piece
from cosim.integrate.nominal import scaled_call
from cosim.integrate.solvers import SOLVERS
from cosim.model.inputs import InputSeries

EVERY_WAY = pytest.mark.parametrize(("solver", "compiled"), WAYS)
END_OF_LEVEL = 2 * (1 - 0.1 * np.log(11))  # s; see `emptying`


def failure(dae, **options):
    with pytest.raises(SolverError) as caught:
        simulate(dae, **options)
    return caught.value


# -- the computed part ----------------------------------------------------------------------------


@pytest.mark.slow_rows("erk-True", "rosenbrock-True")
@EVERY_WAY
def test_run_into_a_pole_keeps_what_came_before(solver, compiled):
    error = failure(blow_up(), solver=solver, output_interval=0.04, compiled=compiled)
    run = error.partial
    # erk and rosenbrock can land on the pole itself, and rk4 goes two steps beyond: all is finite
    assert 0.959 < run.time[-1] < 1.1
    good = run.time < 0.9
    assert good.sum() == 23
    exact = 1 / (1 - run.time[good])
    np.testing.assert_allclose(run["x"][good], exact, rtol=1e-2)  # measured 4e-3 for rk4, else 2e-6
    assert run["calm"].tolist() == [1.0] * len(run)


@pytest.mark.slow_rows("erk-True", "rosenbrock-True")
@EVERY_WAY
def test_run_out_of_the_domain_stops_before_it(solver, compiled):
    error = failure(emptying(), solver=solver, output_interval=0.05, compiled=compiled)
    assert error.partial.time[-1] == pytest.approx(1.5)
    assert 1.5 < END_OF_LEVEL < 1.55


@pytest.mark.slow_rows("dop853")
@pytest.mark.parametrize("solver", ["cvodes", "dop853"])
def test_run_of_many_steps_says_that_closer_output_times_allow_more(solver):
    """A spring of 80,000 rad/s, whose 25,000 swings have more steps than one interval allows."""
    fast = Model("fast", stop_time=2.0, output_interval=2.0)
    x, v = fast.state("x", "m", 1.0, "place"), fast.state("v", "m/s", 0.0, "speed", nominal=8e4)
    fast.derivative(x, v)
    fast.derivative(v, -(8e4**2) * x)
    said = str(failure(fast.freeze(), solver=solver, compiled=True))
    assert said.endswith("or closer output times (for 100,000 steps from one to the next)")
    assert "closer output times" not in str(failure(blow_up(), solver=solver, compiled=True))


CASES = [
    *((blow_up, solver, False) for solver in INTERPRETED),
    *((emptying, solver, True) for solver in SOLVERS),
    *((singular, solver, False) for solver in ("idas", "rosenbrock")),
    *((bad_output, solver, False) for solver in ("cvodes", "idas", "erk")),
]


@pytest.mark.quick_share(0.3)
@pytest.mark.slow_rows("emptying-erk-True", "singular-rosenbrock-False")
@pytest.mark.parametrize(("build", "solver", "compiled"), CASES)
def test_computed_part_agrees_with_a_run_that_was_to_stop_there(build, solver, compiled):
    """But for the last outputs, near the singularity, which the solver approaches otherwise."""
    options = {"solver": solver, "output_interval": 0.05, "compiled": compiled}
    partial = failure(build(), **options).partial
    stopped = simulate(build(), stop_time=partial.time[-2], **options)
    assert stopped.complete
    assert partial.time[:-1].tobytes() == stopped.time.tobytes()
    early = np.flatnonzero(partial.time < partial.time[-1] - 0.1)
    assert early.size > 5
    np.testing.assert_allclose(partial.values[early], stopped.values[early], rtol=1e-5, atol=1e-7)


def test_outputs_of_the_kept_part_are_those_asked_for():
    error = failure(bad_output(), outputs=["root"], compiled=False)
    assert error.partial.names == ("root",)
    np.testing.assert_allclose(error.partial["root"] ** 2, 1 - error.partial.time, atol=1e-9)


def test_kept_part_is_labeled_and_tells_what_it_took():
    run = failure(emptying(), compiled=False).partial
    assert not run.complete
    assert run.status.startswith("stopped after 1.52 s: CV_")
    assert run.stats["steps"] > 10
    assert run.stats["solver"] == "cvodes"


# -- where and why --------------------------------------------------------------------------------


@pytest.mark.slow_rows(
    "erk-True-step size too small at t = 1\\\\.52\\\\d*, h = \\\\S+",
    "rosenbrock-True-step size too small at t = 1\\\\.52\\\\d*, h = \\\\S+",
)
@pytest.mark.parametrize(
    ("solver", "compiled", "why"),
    [
        ("cvodes", False, r"CV_\w+ \(At t = 1\.52\d*\b.*"),
        ("cvodes", True, r"CV_\w+ \(At t = 1\.52\d*\b.*"),
        ("cvodes_adams", False, r"CV_\w+ \(At t = 1\.52\d*\b.*"),
        ("idas", False, r"IDA_\w+ \(At t = 1\.52\d*\b.*"),
        ("erk", False, "step size too small, or too many steps"),
        ("erk", True, r"step size too small at t = 1\.52\d*, h = \S+"),
        ("rosenbrock", True, r"step size too small at t = 1\.52\d*, h = \S+"),
        ("rk4", False, "h is not a number after the step from 1.52 s|a state is not finite"),
    ],
)
def test_message_says_model_solver_time_cause_and_tolerance(solver, compiled, why):
    message = str(failure(emptying(), solver=solver, compiled=compiled))
    assert message.startswith(f"emptying: {solver} stopped after 1.52 s: ")
    assert "\n" not in message
    assert re.search(why, message), message
    settings = "rtol 1e-08, atol 1e-10" if SOLVERS[solver].adaptive else "step: output interval"
    assert f"({settings}); look for a singularity near that state" in message


@pytest.mark.parametrize("solver", ["cvodes", "idas", "erk"])
def test_output_that_is_no_number_is_named_with_its_time(solver):
    message = str(failure(bad_output(), solver=solver, compiled=False))
    # x(1) = 0 but for rounding
    assert re.search(r"stopped after (1|0\.99) s: root is not finite at (1|1\.01) s", message)


@pytest.mark.slow_rows("erk-True", "rosenbrock-True")
@EVERY_WAY
def test_right_hand_side_without_a_value_at_the_start_is_said(solver, compiled):
    model = Model("nowhere")
    x = model.state("x", "1", -1.0, "x")
    model.derivative(x, ca.sqrt(x))
    error = failure(model.freeze(), solver=solver, compiled=compiled)
    assert "nowhere: " in str(error)
    assert len(error.partial) <= 1
    assert "stopped after 0 s" in str(error) or "stopped after the start" in str(error)


def test_output_without_a_value_at_the_start_leaves_nothing():
    model = Model("nowhere")
    x = model.state("x", "1", -1.0, "x")
    model.derivative(x, 0)
    model.output("root", "1", ca.sqrt(x), "root")
    error = failure(model.freeze(), compiled=False)
    assert "stopped after the start: root is not finite at 0 s" in str(error)
    assert len(error.partial) == 0


def test_singular_start_is_refused_before_the_run():
    with pytest.raises(InitialConditionError, match="no solution at the start"):
        simulate(singular(), start_values={"x": 0.0})


@pytest.mark.parametrize("solver", ["cvodes", "idas"])
def test_failure_prints_nothing_beside_its_message(solver, capfd):
    failure(emptying(), solver=solver, compiled=False)
    assert capfd.readouterr() == ("", "")


def test_vanishing_steps_of_adams_do_not_pass_for_success():
    """Without a smallest step CVODES returned a stale state at 1.53 s, beyond the end."""
    run = failure(emptying(), solver="cvodes_adams", compiled=False).partial
    assert run.time[-1] == pytest.approx(1.52)


# -- after a failure ------------------------------------------------------------------------------


@pytest.mark.parametrize("solver", ["cvodes", "idas", "erk", "rosenbrock"])
def test_integrator_after_a_failure_equals_a_fresh_one(solver):
    model = Model("maybe")
    x = model.state("x", "1", 1.0, "x")
    p = model.parameter("p", "1", 1.0, "p")
    model.derivative(x, p * ca.sqrt(x))
    dae, grid = model.freeze(), [0, 0.5, 1]
    used, fresh = (cosim.integrator(dae, grid, solver=solver, compiled=False) for _ in "12")
    good = np.array(used(x0=1, p=1)["xf"])
    with pytest.raises(RuntimeError):
        used(x0=1, p=-10)
    assert np.array(used(x0=1, p=1)["xf"]).tobytes() == good.tobytes()
    assert np.array(fresh(x0=1, p=1)["xf"]).tobytes() == good.tobytes()


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize(
    ("solver", "compiled"),
    [
        ("cvodes", False),
        ("cvodes", True),
        ("idas", True),
        ("erk", False),
        ("erk", True),
        ("dop853", True),
    ],
)
def test_interrupt_reaches_a_run_within_a_second(solver, compiled):
    dae = oscillator().dae
    killed = []

    def interrupt():
        killed.append(time.monotonic())
        os.kill(os.getpid(), signal.SIGINT)

    def run_for_long(stop_time):
        # 2e6 rad in steps of about 0.1 rad: some 1e7 steps
        options = {"start_values": {"k": 1e6}, "output_interval": stop_time / 4000}
        return simulate(dae, solver=solver, stop_time=stop_time, compiled=compiled, **options)

    run_for_long(0.01)  # so that nothing is left to compile
    timer = threading.Timer(0.7, interrupt)
    timer.start()
    try:
        with pytest.raises(Interrupted) as caught:
            run_for_long(2e3)
    finally:
        timer.cancel()
    assert time.monotonic() - killed[0] < 5  # measured 0.01 to 0.1
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    partial, short = caught.value.partial, run_for_long(0.01)  # the next one is not concerned
    assert re.fullmatch(r"stopped after .* s: interrupted", partial.status)
    assert 1 <= len(partial) < 4001
    assert np.isfinite(partial.values).all()
    np.testing.assert_array_equal(partial.values[0], short.values[0])


@pytest.mark.parametrize(
    "place",
    [
        "kernel.Kernel.happen",
        "kernel.Kernel.search",
        "location.Piece.watched",
        "location.scaled_call",
        "events.records_of",
    ],
)
def test_interrupt_between_events_keeps_what_was_computed(place, monkeypatch):
    dae, calls = ball(), []
    whole = simulate(dae, solver="cvodes")
    module, _, name = f"cosim.integrate.{place}".rpartition(".")
    owner = resolve_name(module)
    function = getattr(owner, name)

    def interrupted(*args, **options):
        calls.append(name)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return function(*args, **options)

    monkeypatch.setattr(owner, name, interrupted)
    with pytest.raises(Interrupted) as caught:
        simulate(dae, solver="cvodes")
    partial = caught.value.partial
    assert 0 < partial.time[-1] < whole.time[-1]
    np.testing.assert_array_equal(partial.values, whole.values[: len(partial)])


@pytest.mark.parametrize("failure", [KeyboardInterrupt, ZeroDivisionError])
def test_nothing_runs_after_a_fresh_run_that_fails(failure, monkeypatch):
    calls = []

    def failed(piece, k, t):
        calls.append(t)
        raise failure

    monkeypatch.setattr("cosim.integrate.location.Piece.state_at", failed)
    with pytest.raises(Interrupted if failure is KeyboardInterrupt else failure):
        simulate(ball(), solver="cvodes")
    assert len(calls) == 1


def test_interrupt_ends_a_run_whose_input_comes_to_rest_after_an_event(monkeypatch):
    model = Model("relay", stop_time=2.0, output_interval=0.05)
    clock = model.state("clock", "s", 0.0, "time since the start")
    count = model.state("x", "s", 0.0, "how long u is at its level")
    level = model.discrete("level", "1", 5.0, "level of u")
    u = model.input("u", "1", 0.0, "input")
    model.derivative(clock, 1)
    model.derivative(count, ca.if_else(u >= level, 1, 0))
    model.when(clock > 0.35, {level: 1.0})
    dae = model.freeze()
    inputs = InputSeries(("u",), [0, 1, 2], [[0], [1], [1]])
    assert abs(simulate(dae, solver="dop853", inputs=inputs).final["x"] - 1) < 1e-6
    calls = []

    def interrupted(*args, **options):
        reached = scaled_call(*args, **options)
        calls.append(reached)
        return replace(reached, reason=INTERRUPTED) if len(calls) == 1 else reached

    monkeypatch.setattr("cosim.integrate.location.scaled_call", interrupted)
    with pytest.raises(Interrupted):
        simulate(dae, solver="dop853", inputs=inputs)
    assert len(calls) == 1
    assert len(calls[0].events) == 1


def test_interrupt_of_a_closer_look_at_an_interval_ends_the_run(monkeypatch):
    model = Model("dips", stop_time=11.0, output_interval=1.1)
    x, v = model.state("x", "m", 1.0, "position"), model.state("v", "m/s", 0.0, "speed")
    count = model.discrete("count", "1", 0.0, "times that x was low")
    model.derivative(ca.vertcat(x, v), ca.vertcat(v, -x))
    model.when(x < -0.9999, {count: count + 1})
    dae = model.freeze()
    assert simulate(dae, solver="cvodes").final["count"] == 2
    within, closer = Piece.within, []

    def interrupted(problem, *args, **options):
        reached = scaled_call(problem, *args, **options)
        return replace(reached, reason=INTERRUPTED) if closer else reached

    def noted(piece, k):
        closer.append(k)
        return within(piece, k)

    monkeypatch.setattr("cosim.integrate.location.scaled_call", interrupted)
    monkeypatch.setattr(Piece, "within", noted)
    with pytest.raises(Interrupted):
        simulate(dae, solver="cvodes")
    assert len(closer) == 1


def test_interrupted_command_writes_what_it_has(tmp_path):
    file = tmp_path / "run.csv"
    call = [
        sys.executable,
        "-m",
        "cosim",
        "simulate",
        "double_pendulum",
        "--backend",
        "native-interpreted",
    ]
    call += ["--stop-time", "20000", "--output-interval", "0.5", "--output-file", str(file)]
    ours, terminal = os.openpty()
    process = subprocess.Popen(call, stderr=terminal)
    os.close(terminal)
    wait_for(ours, rb"solving: \d+ %")  # some of some ten seconds
    process.send_signal(signal.SIGINT)
    wait_for(ours, b"interrupted")
    assert process.wait(timeout=60) == 130
    table = np.loadtxt(file, delimiter=",", skiprows=1)
    assert 1 < len(table) < 40001


def wait_for(terminal, told):
    """Read what a terminal shows until a pattern of words."""
    text = b""
    while not re.search(told, text):
        assert select.select([terminal], [], [], 60)[0], text
        text += os.read(terminal, 4096)


@pytest.mark.parametrize("solver", ["cvodes", "idas", "erk", "rosenbrock", "rk4"])
def test_equation_without_a_value_at_the_start_is_named(solver):
    model = Model("pole", stop_time=1.0)
    x, v = model.state("x", "m", 0.0, "position"), model.state("v", "m/s", 0.0, "speed")
    model.derivative(x, 1)
    model.derivative(v, v / x)
    with pytest.raises(SolverError, match="the derivative of v is not a number at the start"):
        cosim.simulate(model.freeze(), solver=solver, compiled=False)


def test_an_interrupted_run_passes_to_another_process():
    stopped = Interrupted("m: interrupted", {"t": 0.5})
    for known in (copy.copy(stopped), pickle.loads(pickle.dumps(stopped))):
        assert (str(known), known.partial) == ("m: interrupted", {"t": 0.5})


@pytest.mark.parametrize("solver", ["rk4", "ode8"])
@pytest.mark.parametrize("output_interval", [0.1, 10.0])
def test_a_state_that_grows_without_bound_is_told_where_it_does(solver, output_interval):
    """x' = x^2 is 1 / (1 - t) from 1; no output time is near."""
    x = ca.SX.sym("x")
    dae = cosim.from_casadi({"x": x, "ode": x * x}, {"x": 1.0}, stop_time=10.0)
    times = {"step_size": 0.01, "output_interval": output_interval}
    with pytest.raises(SolverError, match=r"not finite at t = 1(\.0\d)?, h = 0\.01"):
        cosim.simulate(dae, solver=solver, **times)


@pytest.mark.parametrize("solver", ["dop853", "cvodes"])
def test_events_without_end_are_a_failure_before_memory_is_full(monkeypatch, solver):
    monkeypatch.setattr("cosim.integrate.events._MOST_INSTANTS", 20)
    model = Model("saw", stop_time=60.0, output_interval=1.0)
    x, speed = model.state("x", "1", 0.0, "place"), model.state("speed", "1", 1.0, "speed")
    model.derivative(x, speed)
    model.derivative(speed, speed)  # before: about e^60 events, and no memory left
    model.when(x > 0.5, {x: 0.0}, name="tooth")
    with pytest.raises(
        SolverError, match="more than 20 instants with events; stop earlier"
    ) as failed:
        cosim.simulate(model.freeze(), solver=solver)
    assert 2 <= failed.value.partial.time[-1] < 8  # events of a whole piece are counted
