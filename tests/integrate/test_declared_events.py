"""Conditions that could never become true, and periods that are none, are rejected."""

import casadi as ca
import pytest

import cosim
from casadi_models.dae import Model
from cosim.api import execute, requested
from cosim.backend import Backend
from cosim.errors import CosimError, UsageError


def clock(condition):
    model = Model("clock", stop_time=1.0)
    x, n = model.state("x", "1", 0.0, "x"), model.discrete("n", "1", 0.0, "number")
    model.derivative(x, 1)
    model.when(condition(x, n, model.t), {n: n + 1}, name="now")
    return model.freeze()


@pytest.mark.parametrize(
    ("condition", "reason"),
    [
        (lambda x, n, t: True, "is always true"),
        (lambda x, n, t: ca.SX(1) < 0, "is always false"),
        (lambda x, n, t: x - 0.5, r"has no comparison; write one, e\.g\. \(x-0\.5\) > 0"),
        (lambda x, n, t: x == 0.5, "has only == of continuous variables"),
        (lambda x, n, t: ca.logic_and(n == 0, t != 1), "has only == of continuous variables"),
    ],
)
def test_a_condition_that_cannot_become_true_is_rejected(condition, reason):
    with pytest.raises(ValueError, match=f"clock: condition of 'now' {reason}"):
        clock(condition)
    model = Model("ending")
    x, n = model.state("x", "1", 0.0, "x"), model.state("n", "1", 0.0, "n")
    with pytest.raises(ValueError, match=f"condition of 'stop' {reason}"):
        model.stop(condition(x, n, model.t), "the end")


def test_equalities_of_what_only_events_change_are_conditions():
    assert cosim.simulate(clock(lambda x, n, t: ca.floor(10 * x) == 3)).final["n"] == 1
    model = Model("chain", stop_time=1.0)
    n, m = model.discrete("n", "1", 0.0, "n"), model.discrete("m", "1", 0.0, "m")
    model.every(0.1, {n: n + 1}, offset=0.1)
    model.when(n == 3, {m: model.t})
    assert cosim.simulate(model.freeze()).final["m"] == pytest.approx(0.3, abs=1e-12)


def sampling(period):
    model = Model("sampling", stop_time=1.0)
    x, u = model.state("x", "1", 0.0, "x"), model.input("u", "1", 0.0, "input")
    n, T = model.discrete("n", "1", 0.0, "samples"), model.parameter("T", "s", 0.25, "period")
    model.derivative(x, 1)
    model.every(period(x, u, T, model.t), {n: n + 1}, name="sample")
    return model.freeze()


@pytest.mark.parametrize("period", [lambda x, u, T, t: x + 1, lambda x, u, T, t: T + u])
def test_a_period_that_varies_is_rejected(period):
    with pytest.raises(ValueError, match="'sample' is no constant; only parameters may stand"):
        sampling(period)


@pytest.mark.slow_rows("1-fmu-me", "2-fmu-me", "2-fmu-cs")
@pytest.mark.parametrize("backend", ["native", "fmu-me", "fmu-cs"])
@pytest.mark.parametrize("factor", [1, 2])
def test_a_parameter_as_period_is_positive(backend, factor):
    dae = sampling(lambda x, u, T, t: factor * T if factor > 1 else T)
    run = execute(requested(dae, start_values={"T": 0.25 / factor}), Backend(backend))
    if backend == "native":
        assert run.final["n"] == 5
    words = r"T = .* out of its range" if factor == 1 else "'sample' gives .* no finite value"
    for value in (0.0, -0.25):
        with pytest.raises(CosimError, match=words):
            execute(requested(dae, start_values={"T": value}), Backend(backend))


def test_stop_that_is_true_at_the_start_is_rejected():
    model = Model("ending")
    model.derivative(model.state("x", "1", 0.0, "x"), 1)
    model.stop(model.t > -1, "always")
    with pytest.raises(UsageError, match="stop 'always' is true at the start already"):
        cosim.simulate(model.freeze())


@pytest.mark.slow_rows("cvodes")
@pytest.mark.parametrize("solver", ["cvodes", "dop853"])
def test_events_may_have_equal_names(solver):
    model = Model("samplers", stop_time=0.95)
    x = model.state("x", "1", 0.0, "x")
    a, b = (model.discrete(name, "1", 0, name) for name in "ab")
    model.derivative(x, 1)
    model.every(0.1, {a: a + 1})
    model.every(0.1, {b: b + 1}, offset=0.05)
    model.when(x > 0.52, {a: a + 100}, name="hit")
    model.when(x > 0.72, {b: b + 100}, name="hit")
    run = cosim.simulate(model.freeze(), solver=solver)
    assert (run.final["a"], run.final["b"]) == (110, 110)


def test_samples_of_a_short_run_are_no_zeno():
    model = Model("fast", stop_time=1e-9, output_interval=1e-11)
    x, n = model.state("x", "1", 0.0, "x"), model.discrete("n", "1", 0, "n")
    model.derivative(x, 1.0)
    model.every(0.9e-10, {n: n + 1})
    for solver in ("cvodes", "dop853"):
        assert cosim.simulate(model.freeze(), solver=solver).final["n"] == 12
