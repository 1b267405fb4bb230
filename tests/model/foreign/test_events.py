"""Events of CasADi's integrators and of DaeBuilder become events of the model."""

import casadi as ca
import numpy as np
import pytest

import cosim
from cosim.errors import UsageError

G = 9.81
FIRST = np.sqrt(2 / G)
IMPACTS = FIRST + np.concatenate(([0.0], np.cumsum(2 * FIRST * 0.7 ** np.arange(1, 4))))


def builder():
    found = ca.DaeBuilder("ball")
    h, v = (found.add(name, {"start": start}) for name, start in (("h", 1.0), ("v", 0.0)))
    found.eq(found.der(h), v)
    found.eq(found.der(v), -G)
    found.when(h < 0, [found.reinit("v", -0.7 * v)])
    return found


def mapping(kind):
    x, index, t = kind.sym("x", 2), kind.sym("index"), kind.sym("t")
    none = kind.sym("none", 0)
    jump = ca.vertcat(x[0], -0.7 * x[1])
    given = [index, t, x, none, none, none]
    transition = ca.Function("transition", given, [jump, none], {"allow_duplicate_io_names": True})
    laws = {"x": x, "t": t, "ode": ca.vertcat(x[1], -G), "zero": x[0]}
    return laws | {"transition": transition}


@pytest.mark.slow_rows("SX")
@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
def test_zero_and_transition_of_an_integrator_are_events(kind):
    dae = cosim.from_casadi(mapping(kind), {"x": [1.0, 0.0]}, stop_time=2.0)
    run = cosim.simulate(dae, solver="dop853", relative_tolerance=1e-10)
    times = [event.time for event in run.events]
    np.testing.assert_allclose(times, IMPACTS, rtol=0, atol=1e-12)
    assert {event.name for event in run.events} == {"event 1"}


def test_when_of_a_dae_builder_is_an_event():
    dae = cosim.from_dae_builder(builder())
    run = cosim.simulate(dae, solver="dop853", stop_time=2.0, relative_tolerance=1e-10)
    times = [event.time for event in run.events]
    np.testing.assert_allclose(times, IMPACTS, rtol=0, atol=1e-12)
    assert run.events[0].after["v"] == pytest.approx(-0.7 * run.events[0].before["v"])


def test_transition_with_other_inputs_is_rejected():
    x = ca.SX.sym("x", 2)
    few = ca.Function("transition", [ca.SX.sym("index"), x], [x])
    laws = {"x": x, "ode": ca.vertcat(x[1], -9.81), "zero": x[0], "transition": few}
    with pytest.raises(UsageError, match="'transition' needs the inputs index, t, x, z, p, u"):
        cosim.from_casadi(laws)


@pytest.mark.parametrize("missing", ["zero", "transition"])
def test_half_of_an_event_is_rejected(missing):
    system = {key: value for key, value in mapping(ca.SX).items() if key != missing}
    with pytest.raises(UsageError, match="give 'zero' and the Function 'transition' together"):
        cosim.from_casadi(system, {"x": [1.0, 0.0]})
