"""DaeBuilder models of every feature: right on both backends, or refused by name.

The ones that are marked are examples of CasADi's own documentation (class DaeBuilder), with numbers
where those leave them out.
"""

import math

import casadi as ca
import pytest
from helpers.accepted_builders import (
    ACCEPTED,
    any_unit,
    bounds_and_nominals,
    calculated_start,
    matrix_of_parameters,
    rate_and_unknown_in_equations,
    root_of_cubic,
)
from helpers.refused_builders import REFUSED
from helpers.samples import sampled

import cosim
from cosim.errors import CosimError, UsageError


def test_table_has_30_models():
    assert len(ACCEPTED) + len(REFUSED) >= 30


OPTIONS = {"stop_time": 1.0, "relative_tolerance": 1e-9}


@pytest.mark.parametrize("name", ACCEPTED)
def test_accepted_model_is_right(name):
    builder, exact = ACCEPTED[name]
    dae = cosim.from_dae_builder(builder())
    run = cosim.simulate(dae, solver="rosenbrock", compiled=False, **OPTIONS)
    for variable, value in exact.items():
        assert run[variable][-1] == pytest.approx(value, abs=1e-6)


QUICK = (
    "switch",
    "calculated_start",
    "structured_names",
    "matrix_of_parameters",
    "any_unit",
    "quadrature",
)


@pytest.mark.quick_share(0.3)
@pytest.mark.slow_rows("switch")
@pytest.mark.parametrize("name", sampled(ACCEPTED, QUICK))
def test_accepted_model_is_right_in_an_fmu(name, tmp_path):
    builder, exact = ACCEPTED[name]
    dae = cosim.from_dae_builder(builder())
    path = cosim.export_fmu(dae, tmp_path / "m.fmu")
    run = cosim.simulate_fmu(path, interface="CoSimulation", output_interval=0.1, **OPTIONS)
    start = cosim.simulate(dae, stop_time=0.1, output_interval=0.1, compiled=False)
    for variable in run.names:
        assert run[variable][0] == pytest.approx(start[variable][0], abs=1e-12)
    for variable, value in exact.items():
        assert run[variable][-1] == pytest.approx(value, abs=1e-6)


@pytest.mark.slow_rows("circle")
@pytest.mark.parametrize("name", REFUSED)
def test_refused_model_is_refused_in_one_sentence(name):
    builder, reason = REFUSED[name]
    with pytest.raises(UsageError, match=reason) as caught:
        cosim.from_dae_builder(builder())
    assert "\n" not in str(caught.value)
    assert isinstance(caught.value, CosimError)


def test_rate_and_unknown_satisfy_their_equations():
    run = cosim.simulate(
        cosim.from_dae_builder(rate_and_unknown_in_equations()),
        solver="rosenbrock",
        compiled=False,
        **OPTIONS,
    )
    assert run["z"][-1] == pytest.approx(root_of_cubic(run["x"][-1]), abs=1e-7)
    # x' = -z with x = z^3 + z: 3 z^2/2 + ln z falls as t
    fall = [1.5 * z**2 + math.log(z) for z in run["z"][[0, -1]]]
    assert fall[0] - fall[1] == pytest.approx(1.0, abs=1e-6)


def test_facts_come_along():
    dae = cosim.from_dae_builder(bounds_and_nominals())
    x = dae.variable("x")
    assert (x.minimum, x.maximum, x.nominal, x.meaning) == (-5, 5, 2, "place")
    assert "unit 'furlong/fortnight' is unknown here: factor 1" in (
        cosim.from_dae_builder(any_unit()).variable("x").meaning
    )
    matrix = cosim.from_dae_builder(matrix_of_parameters())
    assert {v.name: v.start for v in matrix.parameters} == {
        "A_1_1": 1, "A_1_2": 2, "A_1_3": 3, "A_2_1": 4, "A_2_2": 5, "A_2_3": 6
    }  # fmt: skip


def test_calculated_start_follows_its_parameter():
    dae = cosim.from_dae_builder(calculated_start())
    run = cosim.simulate(dae, stop_time=0.01, start_values={"p": 5.0}, compiled=False)
    assert run["x"][0] == 10.0


def test_builder_that_holds_an_fmu_is_refused_and_so_is_what_it_creates(tmp_path):
    path = cosim.export_fmu(cosim.from_dae_builder(ACCEPTED["dependent"][0]()), tmp_path / "m.fmu")
    imported = ca.DaeBuilder("imported", str(path))
    with pytest.raises(UsageError, match="it holds an FMU, whose equations lie in its library"):
        cosim.from_dae_builder(imported)
    x = ca.MX.sym("x", len(imported.x()))
    law = imported.create("law", ["x"], ["ode"])
    with pytest.raises(UsageError, match="calls 'law', of type FmuFunction: an FMU has no eq"):
        cosim.from_casadi({"x": x, "ode": law(x)})
