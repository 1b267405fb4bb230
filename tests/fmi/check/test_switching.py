"""FMUs with events: sound ones have no findings; a fault at an event is found."""

import pytest
from helpers.wrapped import wrapped

import cosim
from cosim.fmi.check.check import examine
from cosim.fmi.check.finding import WRONG
from cosim.fmi.check.isolated import TRIALS, try_apart
from cosim.fmi.check.trials.start import defaults, initialization, start
from cosim.fmi.check.trials.steps import steps
from cosim.fmi.check.trials.switching import switching


def ball():
    model = cosim.Model("ball", stop_time=1.5)
    h, v = model.state("h", "m", 1.0, "height"), model.state("v", "m/s", 0.0, "speed")
    model.derivative(h, v)
    model.derivative(v, -9.81)
    model.when(h < 0, {v: -0.7 * v})
    return model.freeze()


def sampled():
    """A plant whose force is sampled; the first sample is at the start."""
    model = cosim.Model("sampled", stop_time=2.0)
    x, u = model.state("x", "1", 1.0, "x"), model.discrete("u", "1", 0.0, "force")
    model.derivative(x, -x + u)
    model.every(0.05, {u: -2 * x})
    model.output("y", "1", x**2, "square")
    return model.freeze()


def relay():
    model = cosim.Model("relay", stop_time=2.0)
    x, on = model.state("x", "1", 0.5, "x"), model.discrete("on", "1", 1.0, "on")
    model.derivative(x, on - x)
    model.when(x > 0.8, {on: 0})
    model.when(x < 0.3, {on: 1})
    return model.freeze()


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("build", [ball, sampled, relay])
def test_own_files_with_events_have_no_finding(build, fmi, tmp_path):
    path = cosim.export_fmu(build(), tmp_path / "own.fmu", fmi=fmi)
    answer = try_apart(path, timeout=24, trials=(start, defaults, initialization, switching))
    assert [*examine(path), *answer.findings] == []
    assert any(text.startswith("switching (CoSimulation)") for text in answer.passed)


@pytest.mark.slow
def test_messages_of_an_own_file_about_its_events_are_no_memory_that_it_loses(tmp_path):
    path = cosim.export_fmu(sampled(), tmp_path / "own.fmu", fmi=3)
    assert try_apart(path, timeout=48, trials=(start, steps)).findings == []


FAULTS = {
    "constant indicators": (
        ball,
        {"fmi2GetEventIndicators": "fmi2Status s = CALL; for (size_t i = 0; i < n; ++i) z[i] = 1; "
         "return s;"},
    ),
    "a sample that is 1 ms late": (
        sampled,
        {"fmi2NewDiscreteStates": "fmi2Status s = CALL; info->nextEventTime += 1e-3; return s;"},
    ),
    "a jump that is not reported": (
        ball,
        {"fmi2NewDiscreteStates": "fmi2Status s = CALL; "
         "info->valuesOfContinuousStatesChanged = fmi2False; return s;"},
    ),
    "a rebound that is 10 % too slow": (
        ball,
        {"fmi2NewDiscreteStates": "double x[2]; fmi2Status s = CALL; "
         "if (info->valuesOfContinuousStatesChanged) { fmi2GetContinuousStates(c, x, 2); "
         "x[1] *= 0.9; fmi2SetContinuousStates(c, x, 2); } return s;"},
    ),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_fault_at_an_event_is_found(fault, tmp_path):
    build, bodies = FAULTS[fault]
    path = wrapped(tmp_path, {}, build(), **bodies)
    answer = try_apart(path, timeout=24, trials=(start, switching))
    assert [(f.level, f.rule) for f in answer.findings] == [(WRONG, "switching")]
    assert switching in TRIALS
