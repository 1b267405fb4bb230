"""Parts as other tools write them: what they return is checked, and a failing part is named."""

import math
import os
import subprocess
import sys

import numpy as np
import pytest
from helpers.foreign_part import foreign_part

import cosim
from cosim.coupling.files import read_system
from cosim.errors import FmuError, SolverError, UnknownName, UsageError

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="it compiles for linux64")
TIMES = {"stop_time": 1.0, "output_interval": 0.01}
WAYS = [
    {"method": "jacobi", "macro_step": 0.01},
    {"method": "gauss_seidel", "macro_step": 0.01},
    {"method": "extrapolated", "macro_step": 0.01},
    {"method": "iterated", "macro_step": 0.01},
    {"method": "extrapolated", "accuracy": 1e-4},
    {"method": "iterated", "accuracy": 1e-4},
]
EVERY_WAY = pytest.mark.parametrize("way", WAYS, ids=lambda way: "-".join(map(str, way.values())))
LOOP = {"motor.u": "load.y", "load.u": "motor.y"}


def two_lags(motor, load, wires=LOOP, **options):
    """Couple two lags, x' = u - x, in a loop; from 1 and 0, motor.x(1) = (1 + exp(-2))/2."""
    start = {"motor.x": 1.0}
    parts = {"motor": motor, "load": load}
    return cosim.couple(parts, wires, start_values=start, **TIMES, **options)


@pytest.mark.quick_share(0.3)
@EVERY_WAY
@pytest.mark.parametrize("wires", [LOOP, {"load.u": "motor.y"}, {}], ids=len)
@pytest.mark.parametrize("value", ["NAN", "INFINITY"])
def test_value_that_is_not_finite_ends_the_run_with_the_part_and_its_output(
    way, wires, value, tmp_path
):
    bad = foreign_part(tmp_path, "lag", fault=f"if (time > 0.4) self->x = {value}")
    system = two_lags(bad, foreign_part(tmp_path, "lag"), wires)
    with pytest.raises(SolverError, match=r"part 'motor': .*\by is not finite") as caught:
        system.simulate(**way)
    assert np.isfinite(caught.value.partial.values).all()
    assert caught.value.partial.time[-1] == pytest.approx(0.4, abs=0.02)


@pytest.mark.quick_share(0.3)
@EVERY_WAY
def test_state_that_is_not_finite_ends_the_run_where_nothing_shows_it(way, tmp_path):
    bad = foreign_part(tmp_path, "lag", fault="if (time > 0.4) self->x = NAN")
    system = two_lags(bad, foreign_part(tmp_path, "lag"), {})
    with pytest.raises(SolverError, match=r"part 'motor': its state x is not finite"):
        system.simulate(**way, outputs=["load.y"])


@pytest.mark.parametrize("master", ["fmpy", "c"])
def test_state_that_is_not_finite_ends_the_run_of_the_fmu_alone(master, tmp_path):
    bad = foreign_part(tmp_path, "lag", fault="if (time > 0.4) self->x = NAN")
    with pytest.raises(FmuError, match="its state x is not finite at the end of the run"):
        cosim.simulate_fmu(bad, outputs=["u"], master=master)


@EVERY_WAY
def test_output_derivatives_that_are_not_finite_count_as_none(way, tmp_path):
    motor, load = (foreign_part(tmp_path, "lag", divides=True) for _ in range(2))
    run = two_lags(motor, load).simulate(**way)
    bound = 5e-3 if way["method"] in ("jacobi", "gauss_seidel") else 1e-4  # 3.4e-3; 7e-6
    assert run.final["motor.y"] == pytest.approx((1 + math.exp(-2)) / 2, abs=bound)


@pytest.mark.quick_share(0.3)
@EVERY_WAY
@pytest.mark.parametrize(("status", "word"), [(2, "discard"), (3, "error"), (4, "fatal")])
def test_part_that_fails_is_named_with_its_status(way, status, word, tmp_path):
    bad = foreign_part(tmp_path, "lag", fault=f"if (time > 0.4) return {status}")
    system = two_lags(bad, foreign_part(tmp_path, "lag"))
    words = rf"part 'motor' failed after .*fmi2DoStep returned {status} \({word}\)"
    with pytest.raises(SolverError, match=words):
        system.simulate(**way)


def test_part_that_rejects_an_iterate_gets_a_shorter_step(tmp_path):
    """The load rises to (1 - exp(-2))/2 = 0.432; predictions that the motor rejects are above."""
    beyond = "if (fabs(self->u) > 0.501 || fabs(self->u + self->slope * size) > 0.501) return 3"
    system = two_lags(foreign_part(tmp_path, "lag", fault=beyond), foreign_part(tmp_path, "lag"))
    run = system.simulate(accuracy=1e-4)
    assert run.final["motor.y"] == pytest.approx((1 + math.exp(-2)) / 2, abs=1e-4)


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize(
    ("fault", "limit", "words"),
    [
        ("abort()", "60", "part 'motor' crashed (SIGABRT)"),
        ("exit(3)", "60", "part 'motor' ended the process with exit code 3"),
        pytest.param(
            *("for (volatile int i = 0;; i = 1) {}", "10", "part 'motor' was being called"),
            marks=pytest.mark.slow,
        ),
    ],
    ids=["crash", "exit", "hang"],
)
def test_part_that_ends_or_stops_its_process_is_named(fault, limit, words, tmp_path):
    bad = foreign_part(tmp_path, "lag", fault=f"if (time > 0.4) {fault}")
    toml = tmp_path / "pair.toml"
    toml.write_text(
        f"stop_time = 1.0\n[parts]\nmotor = '{bad}'\nload = '{foreign_part(tmp_path, 'lag')}'\n"
        "[connections]\n'load.u' = 'motor.y'\n'motor.u' = 'load.y'\n"
    )
    call = [sys.executable, "-m", "cosim", "simulate", str(toml), "--trust", "--timeout", limit]
    done = subprocess.run(call, capture_output=True, text=True, check=False, timeout=90)
    assert done.returncode == 1
    assert words in done.stderr


@pytest.mark.parametrize("grid", [1e-12, 1e-9, 1e-7, 1e-6, 1e-5])
def test_parts_that_round_their_results_stay_at_rest(grid, tmp_path):
    """At rest v = 0 and y = -10; no force within the limits moves the mass by 7.4 in a second."""
    parts = {n: foreign_part(tmp_path, n, grid=grid) for n in ("controller", "plant")}
    wires = {"controller.u": "plant.y", "plant.u": "controller.y"}
    system = cosim.couple(parts, wires, stop_time=2.0, output_interval=0.01)
    run = system.simulate(method="iterated", macro_step=0.01)
    assert np.abs(run["plant.y"]).max() < 0.075  # measured 0.0711 with each
    assert run.final["plant.y"] == pytest.approx(0, abs=3 * grid)


def test_accuracy_below_the_noise_of_a_part_is_an_error_that_names_it(tmp_path):
    """The load rounds its results to 1e-4, which keeps the motor from its motion in short steps."""
    motor, load = foreign_part(tmp_path, "lag"), foreign_part(tmp_path, "lag", grid=1e-4)
    for accuracy in (1e-4, 1e-6, 1e-10):
        with pytest.raises(SolverError, match=r"part 'load' .* noise of about 0.0001 of their"):
            two_lags(motor, load).simulate(accuracy=accuracy)
    run = two_lags(motor, load).simulate(accuracy=1e-2)
    assert run.final["motor.y"] == pytest.approx((1 + math.exp(-2)) / 2, abs=1e-2)


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("abilities", [{}, {"canGetAndSetFMUstate": "false"}], ids=["", "fixed"])
@pytest.mark.parametrize("grid", [0.05, 0.3, 1.0])
def test_outputs_that_rounding_freezes_in_short_steps_are_an_error(grid, abilities, tmp_path):
    """Every run of the series gives 1 and 0 for 0.57 and 0.43; before, with estimates of 1e-6."""
    parts = [foreign_part(tmp_path, "lag", grid=grid, **abilities) for _ in range(2)]
    for accuracy in (1e-2, 1e-5):
        with pytest.raises(SolverError, match=r"\.y is constant in \d+ macro steps, and moves"):
            two_lags(*parts).simulate(accuracy=accuracy)


def test_outputs_that_rest_are_no_error(tmp_path):
    """x' = 1 - x from 0; the holder has one value with any step."""
    parts = foreign_part(tmp_path, "lag"), foreign_part(tmp_path, "holder")
    start = {"motor.x": 0.0, "load.x": 1.0}
    run = two_lags(*parts).simulate(accuracy=1e-6, start_values=start)
    assert run.final["motor.y"] == pytest.approx(1 - math.exp(-1), abs=1e-6)
    assert run["load.y"].tolist() == [1.0] * len(run)


OWN = "if (fabs(size - 0.02) > 1e-9) return 3"  # as files of others that take no other step


@pytest.mark.parametrize(
    "way",
    [
        {"accuracy": 0.1},
        {"method": "extrapolated", "accuracy": 0.1},
        {"macro_step": 0.02},
        {"macro_step": 0.1, "output_interval": 0.1},
        {"macro_step": 0.02, "method": "jacobi"},
    ],
    ids=str,
)
def test_part_gets_no_other_step_than_its_own(way, tmp_path):
    facts = {"fault": OWN, "step_size": 0.02, "canHandleVariableCommunicationStepSize": "false"}
    motor, load = foreign_part(tmp_path, "lag", **facts), foreign_part(tmp_path, "lag")
    run = two_lags(motor, load).simulate(**{"output_interval": 0.02} | way)
    bound = 1e-2 if way.get("method") == "jacobi" else 2e-3  # measured 6.8e-3; 7e-4
    assert run.final["motor.y"] == pytest.approx((1 + math.exp(-2)) / 2, abs=bound)


@pytest.mark.parametrize(
    ("ways", "words"),
    [
        ({"macro_step": 0.02, "output_interval": 0.03}, "output_interval = 0.03 s is no multiple"),
        ({"accuracy": 1e-2, "output_interval": 0.03}, "output_interval = 0.03 s is no multiple"),
        ({"accuracy": 1e-2, "stop_time": 1.01}, "the span of the run = 1.01 s is no multiple"),
    ],
    ids=str,
)
def test_times_that_do_not_fit_the_only_step_of_a_part_are_rejected(ways, words, tmp_path):
    motor = foreign_part(
        tmp_path, "lag", step_size=0.02, canHandleVariableCommunicationStepSize="false"
    )
    system = two_lags(motor, foreign_part(tmp_path, "lag"))
    with pytest.raises(UsageError, match=rf"{words}.*part 'motor'"):
        system.simulate(**{"output_interval": 0.02, "macro_step": None} | ways)


def test_accuracy_that_the_only_step_of_a_part_does_not_allow_is_an_error(tmp_path):
    motor = foreign_part(
        tmp_path, "lag", step_size=0.02, canHandleVariableCommunicationStepSize="false"
    )
    system = two_lags(motor, foreign_part(tmp_path, "lag"))
    with pytest.raises(SolverError, match="the steps of motor have a fixed length") as caught:
        system.simulate(accuracy=1e-12, output_interval=0.02)
    assert len(caught.value.partial) == 51
    run = system.simulate(output_interval=0.02)
    assert "the steps of motor have a fixed length" in run.stats["note"]
    assert "error_estimate" not in run.stats


def test_a_fixed_step_that_is_too_long_hides_no_other_note(tmp_path):
    fixed = {"canHandleVariableCommunicationStepSize": "false", "canInterpolateInputs": "false"}
    motor = foreign_part(tmp_path, "lag", step_size=0.02, **fixed)
    run = two_lags(motor, foreign_part(tmp_path, "lag")).simulate(output_interval=0.02)
    assert "motor holds its inputs within its only step, 0.02 s" in run.stats["note"]
    assert "the steps of motor have a fixed length" in run.stats["note"]


def test_abilities_that_are_switched_off_are_not_used(tmp_path):
    motor, load = foreign_part(tmp_path, "lag"), foreign_part(tmp_path, "lag")
    full = two_lags(motor, load).simulate(macro_step=0.01)
    assert full.stats["order"] == {"motor": "linear inputs", "load": "linear inputs"}
    text = "no rates, no interpolation, no rollback, no directional derivatives, no event mode"
    run = two_lags(motor, load, abilities={"motor": text}).simulate(macro_step=0.005)
    assert run.stats["order"]["motor"] == (
        "constant inputs, output derivatives from values, one step without repetition: it cannot "
        "restore its state"
    )
    exact = (1 + math.exp(-2)) / 2  # the rates of the load are differences, half a step late
    assert run.final["motor.y"] == pytest.approx(exact, abs=1e-4)  # measured 4.5e-5
    toml = tmp_path / "pair.toml"
    toml.write_text(
        f"[parts]\nmotor = '{motor}'\nload = '{load}'\n[connections]\n'load.u' = 'motor.y'\n"
        "[abilities]\nmotor = 'no rates'\n"
    )
    order = read_system(toml).simulate(macro_step=0.01).stats["order"]
    assert order["motor"] == "linear inputs, output derivatives from values"


@pytest.mark.parametrize(
    ("abilities", "kind", "words"),
    [
        ({"motor": "no rate"}, UnknownName, "no ability to switch off 'no rate'"),
        ({"motors": "no rates"}, UnknownName, "no part 'motors'"),
        ({"motor": 1}, UsageError, "abilities of part 'motor'"),
        ("no rates", UsageError, "abilities"),
    ],
    ids=str,
)
def test_wrong_abilities_are_rejected(abilities, kind, words):
    with pytest.raises(kind, match=words):
        cosim.couple({"motor": "crank_shaft"}, {}, abilities=abilities)


def test_part_for_scheduled_execution_only_is_rejected_with_the_remedy(tmp_path):
    path = foreign_part(tmp_path, "lag", interface="ScheduledExecution")
    words = r"for scheduled execution only.*export it for co-simulation or model exchange"
    with pytest.raises(UsageError, match=words):
        cosim.couple({"motor": path}, {})


NO_ROLLBACK = {"canGetAndSetFMUstate": "false"}


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("accuracy", [1e-2, 1e-4])
@pytest.mark.parametrize("other", [{}, NO_ROLLBACK], ids=["rollback", "none"])
def test_noise_of_parts_without_rollback_is_no_accuracy(other, accuracy, tmp_path):
    """In short steps the load rests, and two runs agree on it: 0.2 off before, estimate 8e-10."""
    motor = foreign_part(tmp_path, "lag", **NO_ROLLBACK)
    load = foreign_part(tmp_path, "lag", grid=1e-4, **other)
    words = "motor, which cannot restore a state, (may round results|adds up to)"
    with pytest.raises(SolverError, match=words) as caught:
        two_lags(motor, load).simulate(accuracy=accuracy)
    assert caught.value.partial.stats["macro_steps"] < 100_000


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("accuracy", [1e-1, 1e-2])
@pytest.mark.parametrize("rates", ["1", "0"])
@pytest.mark.parametrize("grid", [1e-3, 1e-4])
def test_noise_of_parts_without_rollback_adds_up_with_their_steps(grid, rates, accuracy, tmp_path):
    """Runs had agreed on a load that rests at times: 0.13 off, with an estimate of 0.0064."""
    lacking = {**NO_ROLLBACK, "maxOutputDerivativeOrder": rates}
    motor, load = (foreign_part(tmp_path, "lag", grid=grid, **lacking) for _ in range(2))
    system = two_lags(motor, load)
    if accuracy <= 100 * grid:
        with pytest.raises(SolverError, match="cannot restore a state, adds up to"):
            system.simulate(accuracy=accuracy)
        return
    run = system.simulate(accuracy=accuracy)
    error = abs(run.final["motor.y"] - (1 + math.exp(-2)) / 2)
    assert error <= run.stats["error_estimate"] <= accuracy


def test_noise_that_is_found_late_ends_the_run_soon():
    """At 1e9 s, time is known to 1.2e-7 s; 3,595,105 macro steps in 67 s before."""
    parts = {}
    for name, start in (("motor", 1.0), ("load", 0.0)):
        model = cosim.Model(name, stop_time=1.0)
        x, u = model.state("y", "1", start, "state"), model.input("u", "1", 0.0, "input")
        model.derivative(x, u - x)
        parts[name] = model.freeze()
    system = cosim.couple(parts, LOOP)
    times = {"start_time": 1e9, "stop_time": 1e9 + 3, "output_interval": 0.03}
    run = system.simulate(accuracy=1e-5, **times)
    error = np.abs(run["motor.y"] - (1 + np.exp(-2 * (run.time - 1e9))) / 2).max()
    assert error < run.stats["error_estimate"] < 1e-5  # measured 4e-8
    with pytest.raises(SolverError, match=r"part '.*' returns outputs with a noise of") as caught:
        system.simulate(accuracy=1e-6, **times)
    assert caught.value.partial.stats["macro_steps"] < 10_000


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("method", ["jacobi", "gauss_seidel", "extrapolated", "iterated"])
@pytest.mark.parametrize("step", [0.1, 0.04])
def test_discrete_outputs_are_constant_within_macro_steps(step, method, tmp_path):
    """h(0.1 n) = 1.5^n in both; 1e-13 with iterated before, and 1.5^(2 n) with gauss_seidel."""
    sample = (
        "if (floor((time + size) / 0.1 + 1e-6) > floor(time / 0.1 + 1e-6)) "
        "self->x = 1.5 * (self->u + self->slope * size)"
    )
    motor, load = (
        foreign_part(tmp_path, "holder", fault=sample, varies="discrete") for _ in range(2)
    )
    system = cosim.couple(
        {"motor": motor, "load": load},
        LOOP,
        start_values={"motor.x": 1.0, "load.x": 1.0},
        stop_time=1.0,
        output_interval=0.2,
    )
    run = system.simulate(method=method, macro_step=step)
    np.testing.assert_allclose(run["motor.y"], 1.5 ** np.round(run.time / 0.1), rtol=1e-12)
    np.testing.assert_allclose(run["load.y"], 1.5 ** np.round(run.time / 0.1), rtol=1e-12)


def clock():
    model = cosim.Model("clock", stop_time=1.0)
    s = model.state("s", "1", 0.0, "time")
    model.derivative(s, 1.0)
    model.output("y", "1", 1.0 * s, "time")
    return model.freeze()


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("saves", ["true", "false"])
@pytest.mark.parametrize("interval", [0.25, 0.05])
def test_fixed_steps_that_hold_inputs_follow_the_accuracy_unless_the_file_names_them(
    saves, interval, tmp_path
):
    kept = {"canGetAndSetFMUstate": saves, "canSerializeFMUstate": saves}
    kept |= dict.fromkeys(
        ("canHandleVariableCommunicationStepSize", "canInterpolateInputs"), "false"
    )
    runs = {
        step: cosim.couple(
            {"lag": foreign_part(tmp_path, "lag", step_size=step, **kept), "clock": clock()},
            {"lag.u": "clock.y"},
        ).simulate(stop_time=1.0, output_interval=interval)
        for step in (None, 0.05)
    }
    errors = {step: abs(run.final["lag.y"] - math.exp(-1)) for step, run in runs.items()}
    note = "lag holds its inputs within its only step, 0.05 s: no estimate has what this causes"
    assert errors[None] < runs[None].stats["error_estimate"] < 1e-6  # measured 3e-8; 3.3e-3 at 0.25
    assert errors[0.05] == pytest.approx(1.3e-4, rel=0.1)  # h^2/12 (1 - 1/e)
    assert note in runs[0.05].stats["note"]
    assert "holds its inputs" not in runs[None].stats.get("note", "")
