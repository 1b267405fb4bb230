"""Starts that follow from the start time and from inputs, on every backend that calculates them."""

import re

import fmpy
import numpy as np
import pytest
from casadi import SX
from helpers.fmi_cases import INTERFACES, VERSIONS
from helpers.small_models import late
from scipy.optimize import brentq

import cosim
from casadi_models.dae import Model
from cosim.errors import UsageError

SPAN = {"start_time": 0.25, "stop_time": 1.0}


def starts(u, v=0.5, k=2.0, t=0.25):
    """Return x and w where a run begins, by bracketing."""
    x = 2 * u + t * v
    return x, brentq(lambda w: w**3 + w - u * x - t - v - k, 0, 10, xtol=1e-15)


@pytest.fixture(scope="module")
def fmus(tmp_path_factory):
    folder = tmp_path_factory.mktemp("late")
    return {v: cosim.export_fmu(late(), folder / f"late{v}.fmu", fmi=v) for v in (2, 3)}


@pytest.mark.parametrize("inputs", [{"u": "1 + t"}, cosim.InputSeries(("u",), [0, 2], [[1], [3]])])
def test_run_starts_where_its_laws_say(inputs):
    run = cosim.simulate(late(), inputs=inputs, **SPAN)
    assert (run["x"][0], run["w"][0]) == pytest.approx(starts(1.25), abs=1e-13)
    given = cosim.simulate(late(), start_values={"u": 0.75, "v": 1.0, "k": 3.0}, **SPAN)
    assert (given["x"][0], given["w"][0]) == pytest.approx(starts(0.75, 1.0, 3.0), abs=1e-13)


@pytest.mark.slow_rows("2-ModelExchange")
@INTERFACES
@VERSIONS
def test_fmu_starts_where_its_laws_say(fmi, interface, fmus):
    ways = {"interface": interface, **SPAN, "inputs": {"u": "1 + t"}}
    run = cosim.simulate_fmu(fmus[fmi], start_values={"v": 1.0, "k": 3.0}, **ways)
    assert (run["x"][0], run["w"][0]) == pytest.approx(starts(1.25, 1.0, 3.0), abs=1e-13)


@INTERFACES
def test_plain_fmpy_starts_it_where_its_laws_say(interface, fmus):
    samples = np.array([(0.0, 1.0), (2.0, 3.0)], dtype=[("time", float), ("u", float)])
    asked = {"fmi_type": interface, "input": samples, "output": ["x", "w"]}
    run = fmpy.simulate_fmu(str(fmus[2]), **SPAN, **asked)
    assert (run["x"][0], run["w"][0]) == pytest.approx(starts(1.25), abs=1e-13)


def test_initial_unknowns_depend_on_time_and_inputs(fmus):
    text = fmpy.read_model_description(str(fmus[2]))
    names = [v.name for v in text.modelVariables]
    unknowns = {u.variable.name: {v.name for v in u.dependencies} for u in text.initialUnknowns}
    assert unknowns["x"] == {"time", "v", "u"}
    assert unknowns["w"] == unknowns["y"] == {"time", "v", "u", "k"}
    assert "time" in names


def test_many_runs_start_each_with_its_own_inputs():
    found = cosim.simulate_many(late(), {"u": [0.5, 1.0, 2.0]}, outputs=["x", "w"], **SPAN)
    assert found.stats.get("lanes", 1)
    for i, u in enumerate((0.5, 1.0, 2.0)):
        run = found.run(i)
        assert (run["x"][0], run["w"][0]) == pytest.approx(starts(u), abs=1e-12)


def test_derivatives_by_inputs_begin_with_those_of_the_start():
    found = cosim.sensitivity(late(), outputs=["x", "w"], with_respect_to=["u", "v"], **SPAN)
    x, w = starts(0.5)
    by_u = (0.5 * 2 + x) / (3 * w**2 + 1)
    assert found["x", "u"][0] == pytest.approx(2.0, abs=1e-12)
    assert found["x", "v"][0] == pytest.approx(0.25, abs=1e-12)
    assert found["w", "u"][0] == pytest.approx(by_u, abs=1e-12)


def test_part_of_a_model_keeps_what_its_starts_follow_from():
    small = cosim.reduce(late(), ["w"])
    assert [v.name for v in small.inputs] == ["u"]
    run = cosim.simulate(small, start_values={"u": 0.75}, **SPAN)
    assert run["w"][0] == pytest.approx(starts(0.75)[1], abs=1e-13)


def test_input_that_follows_a_state_without_start_is_refused():
    told = re.escape("late: u: start (law of x) needs 'w', which no rule before it settles")
    with pytest.raises(UsageError, match=told):
        cosim.simulate(late(), inputs={"u": "w"}, **SPAN)


# -- invariants -----------------------------------------------------------------------------------


def follower():
    """Return x' = 1.1, which only its invariant makes follow the input: x = u + t."""
    model = Model("follower", stop_time=1.0)
    x, u = model.state("x", "m", 0.0, "place"), model.input("u", "m", 0.5, "ahead")
    model.derivative(x, SX(1.1))
    model.start(x, u + model.t, "it follows")
    model.invariant("lag", x, x - u - model.t, "it follows")
    return model.freeze()


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize("solver", [{"solver": "dop853"}, {"solver": "rk4", "step_size": 0.05}])
@pytest.mark.parametrize(
    ("inputs", "law"),
    [
        (None, lambda t: 0.5 + 0 * t),
        ({"u": "sin(t)"}, np.sin),
        (cosim.InputSeries(("u",), [0, 1], [[0], [2]]), lambda t: 2 * t),
    ],
)
def test_projection_ends_where_time_and_inputs_say(inputs, law, solver):
    run = cosim.simulate(follower(), inputs=inputs, drift_control="projection", **SPAN, **solver)
    np.testing.assert_allclose(run["x"], law(run.time) + run.time, rtol=0, atol=1e-13)
