"""The solver of a page, in node: its numbers are those of the native FMU."""

import re
from importlib.util import find_spec

import numpy as np
import pytest
from helpers import event_models
from helpers.live_pages import NODE, computed
from helpers.samples import sampled

import casadi_models
import cosim

LIVE = [name for name in casadi_models.CATALOG if "/" in name]
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(NODE is None, reason="no node here: apt-get install nodejs"),
    pytest.mark.skipif(find_spec("ziglang") is None, reason="no ziglang here"),
]


@pytest.mark.parametrize("name", sampled(LIVE, (), LIVE[::2]))
def test_run_of_a_page_is_that_of_the_fmu(name, tmp_path):
    dae = cosim.load(name)
    found = computed(dae, {}, tmp_path)
    fmu = cosim.export_fmu(dae, tmp_path / "x.fmu")
    run = cosim.simulate_fmu(fmu, interface="CoSimulation", outputs=found["names"])
    np.testing.assert_array_equal(found["time"], run.time)
    for column, values in zip(found["names"], found["values"], strict=True):
        size = max(np.abs(run[column]).max(), run.column(column).nominal)
        # the same bits, but for inverse functions at the start: 8e-14
        np.testing.assert_allclose(values, run[column], rtol=0, atol=1e-12 * size, err_msg=column)


def test_page_says_which_limit_the_run_leaves(tmp_path):
    found = computed(cosim.load("bicycle"), {"phi_dot": 4.0}, tmp_path)
    assert "the rear wheel would lift off" in found["reasons"]


def test_page_says_each_limit_once_and_why_the_run_ends(tmp_path):
    found = computed(cosim.load("bicycle"), {"phi_dot": -2.5}, tmp_path)
    facts = [re.sub(r"^from time \S+ on ", "", reason) for reason in found["reasons"]]
    assert len(facts) == len(set(facts)) > 1
    assert "came no further than" in facts[-1]


def test_page_says_the_first_violation_of_a_run_with_many(tmp_path):
    dae = cosim.load("bicycle")
    found = computed(dae, {"speed": 2.0}, tmp_path)  # its last step violates a limit 1000 times
    run = cosim.simulate(dae, start_values={"speed": 2.0}, stop_time=0.91, outputs=["fz_P"])
    assert found["invalid_from"] == pytest.approx(run.stats["invalid"][0].time, abs=1e-4)
    assert "came no further than" in found["reasons"][-1]


def test_page_tells_events_with_their_times(tmp_path):
    found = computed(event_models.ball(), {}, tmp_path)
    first = np.sqrt(2 / 9.81)
    time, name = found["events"][0]
    assert (time, name) == (pytest.approx(first, abs=1e-9), "impact")
    assert found["reasons"] == []


def test_page_says_why_a_run_cannot_start(tmp_path):
    found = computed(cosim.load("bicycle"), {"mB": -1.0}, tmp_path)
    assert found["time"] == []
    assert "mB" in " ".join(found["reasons"])


@pytest.mark.parametrize(
    ("start", "size", "expected"), [(0.0, 1.0, 2.0), (-5.0, 1.0, 2.0), (3e-9, 1e-9, 2e-9)]
)
def test_start_value_of_an_output_is_reached_from_any_start(start, size, expected, tmp_path):
    model = cosim.Model("shifted", stop_time=1.0)
    v = model.state("v", "m/s", start, "speed")
    model.derivative(v, 0)
    model.output("flow", "m/s", 5 * size + v + (v / size) ** 3 * size / 10, "speed past a belt")
    model.start_through(v, "flow")
    found = computed(model.freeze(), {"flow": 7.8 * size}, tmp_path)
    [[v, *_]] = [x for name, x in zip(found["names"], found["values"], strict=True) if name == "v"]
    assert v == pytest.approx(expected, rel=1e-9)


def test_start_value_of_an_output_is_reached_as_in_a_simulation(tmp_path):
    dae = cosim.load("bicycle")
    found = computed(dae, {"speed": 3.5, "rR": 0.32}, tmp_path)
    run = cosim.simulate(dae, start_values={"speed": 3.5, "rR": 0.32})
    for name in ("speed", "thetaR_dot", "phi"):
        values = found["values"][found["names"].index(name)]
        size = max(np.abs(run[name]).max(), run.column(name).nominal)
        assert values[0] == pytest.approx(run[name][0], rel=1e-12, abs=1e-12)
        # errors of both solvers, which the growing weave amplifies: measured 2.2e-6
        np.testing.assert_allclose(values, run[name], rtol=0, atol=1e-5 * size)
