"""What a run records does not depend on how it is evaluated, nor on what else is asked for."""

import casadi as ca
import numpy as np
import pytest

import cosim
from casadi_models.dae import Model
from cosim.api import simulate
from cosim.errors import SolverError
from cosim.integrate import outputs

FEW = ["fz_Q", "phi", "energy"]


@pytest.fixture(scope="module")
def bicycle():
    return cosim.load("bicycle")


@pytest.fixture(scope="module")
def everything(bicycle):
    return simulate(bicycle, solver="dop853", stop_time=4.0, start_values={"phi_dot": 4.0})


def again(dae, **options):
    return simulate(dae, solver="dop853", stop_time=4.0, start_values={"phi_dot": 4.0}, **options)


@pytest.mark.slow
def test_lanes_give_the_bits_of_scalar_code(bicycle, everything, monkeypatch):
    monkeypatch.setattr(outputs, "_lane_library", lambda *_, **__: None)
    scalar = again(bicycle)
    assert everything.stats["invalid"] == scalar.stats["invalid"]  # a wheel lifts
    np.testing.assert_array_equal(everything.values, scalar.values)


@pytest.mark.slow_rows("outputs")
@pytest.mark.parametrize("names", [FEW, ["phi", "delta"]], ids=["outputs", "states only"])
def test_a_few_names_have_the_numbers_and_the_limits_of_all(bicycle, everything, names):
    few = again(bicycle, outputs=names)
    np.testing.assert_array_equal(few.values, everything.select(names).values)
    assert few.stats["invalid"] == everything.stats["invalid"]


def pole(limit=1.505):
    """Declare x' = 1 with an output that has no number from x = 1 on, and a limit."""
    model = Model("pole", stop_time=2.0)
    x = model.state("x", "1", 0.0, "x")
    model.derivative(x, 1.0)
    model.output("root", "1", ca.sqrt(1 - x), "real until x = 1")
    model.output("fine", "1", 2 * x, "always real")
    model.limit(limit - x, "x is small")
    return model.freeze()


@pytest.mark.slow_rows("True")
@pytest.mark.parametrize("compiled", [True, False])
def test_only_what_is_recorded_has_to_be_a_number(compiled):
    options = {"solver": "dop853" if compiled else "erk", "compiled": compiled}
    with pytest.raises(SolverError, match=r"root is not finite at 1(\.01)? s"):
        simulate(pole(), **options)
    run = simulate(pole(), outputs=["fine"], **options)
    assert run.complete
    assert run.stats["invalid"] == ["invalid from 1.505 s: not fulfilled: x is small"]


def test_ignored_limits_are_not_evaluated(bicycle, everything, monkeypatch):
    monkeypatch.setattr(outputs, "lane_outputs", lambda *_, **__: pytest.fail("evaluated"))
    run = again(bicycle, outputs=["phi"], on_invalid="ignore")
    assert "invalid" not in run.stats
    np.testing.assert_array_equal(run["phi"], everything["phi"])
