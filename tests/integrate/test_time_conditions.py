"""Conditions of time alone that are not linear in time: every switch is found, also by FMUs.

The state of each model is the integral of a value while its condition holds.
"""

from math import asin, atan, atanh, exp, log, pi, sqrt

import casadi as ca
import numpy as np
import pytest

import cosim
from casadi_models.dae import Model
from casadi_models.dae.hybrid import hybrid
from cosim.model.switching import Argument, switch_times

NATIVE = ["dop853", "cvodes"]
FMUS = ["ModelExchange 2", "CoSimulation 2", "CoSimulation 3"]
WAYS = [*NATIVE, *FMUS]


def integral(condition, stop_time, value=1.0):
    model = Model("integral", stop_time=stop_time)
    y = model.state("y", "1", 0.0, "integral")
    a = model.parameter("a", "1", 1.0, "factor")
    model.derivative(y, ca.if_else(condition(model.t, a), value, 0))
    return model.freeze()


# name: condition, stop time, value while it holds, integral, number of switches
CASES = {
    "pulses at 50 Hz": (
        lambda t, a: ca.sin(100 * pi * a * t) > 0.99,
        10.0, 1.0, 5 * (pi - 2 * asin(0.99)) / pi, 1000,
    ),
    "square": (lambda t, a: (t - pi * a) ** 2 < 1e-6, 10.0, 1000.0, 2.0, 2),
    "thin square": (lambda t, a: (t - a) ** 2 < 1e-12, 10.0, 1e6, 2.0, 2),
    "Gaussian": (
        lambda t, a: ca.exp(-(((t - 3) / 1e-6) ** 2)) > a / 2,
        10.0, 1e6, 2 * sqrt(log(2)), 2,
    ),
    "1 kHz": (lambda t, a: ca.sin(2000 * pi * (t + 1e-5 * a)) > 0, 1.0, 1.0, 0.5, 2000),
    "chirp": (
        lambda t, a: ca.sin(200 * a * t**2) > 0,
        sqrt(200 * pi / 200), 1.0,
        sum(sqrt((2 * k + 1) * pi / 200) - sqrt(2 * k * pi / 200) for k in range(100)), 199,
    ),
    "touching by value": (lambda t, a: ca.sin(t) > a, 10.0, 1.0, 0.0, 0),
    "touching by curvature": (lambda t, a: ca.sin(t) + ca.cos(t) > sqrt(2) * a, 10.0, 1.0, 0.0, 0),
    "touching flatly": (lambda t, a: (a - ca.sin(t)) ** 2 >= 0, 10.0, 1.0, 10.0, 0),
    "nearly touching": (
        lambda t, a: ca.sin(t) + ca.cos(t) > a * sqrt(2) * (1 - 5e-11), 10.0, 1.0, 4e-5, 4,
    ),
    "poles": (lambda t, a: ca.tan(t) > 5 * a, 10.0, 1.0, 3 * (pi / 2 - atan(5)), 6),
    "pole at an output": (lambda t, a: 1 / (t - 2 * a) > 0, 10.0, 1.0, 8.0, 1),
    "floor": (lambda t, a: ca.floor(2 * ca.sin(3 * a * t)) > 0, 10.0, 1.0, 10 * pi / 9, 10),
    "logarithm": (lambda t, a: ca.log(t) > a, 10.0, 1.0, 10 - exp(1), 1),
    "power": (lambda t, a: (t + 0.5) ** (3 * a) > 8, 10.0, 1.0, 8.5, 1),
    "step": (lambda t, a: ca.tanh((t - 3) * 1e6) > a / 2, 10.0, 1.0, 7 - 1e-6 * atanh(0.5), 1),
    "both": (
        lambda t, a: ca.logic_and(ca.sin(t) > 0, ca.cos(t - pi / 2) > a / 2),
        9.0, 1.0, 4 * pi / 3, 6,
    ),
}  # fmt: skip


def ran(dae, way, folder):
    if " " not in way:
        return cosim.simulate(dae, solver=way)
    interface, fmi = way.split()
    path = cosim.export_fmu(dae, folder / "model.fmu", fmi=int(fmi))
    return cosim.simulate_fmu(path, interface=interface)


# rounding of the times of switches; measured 5e-10 of 1e6 times the time, 1e-14 else
def error_of(case):
    *_, value, _, count = CASES[case]
    return 1e-9 + 4e-16 * count * value


@pytest.mark.quick_share(0.3)
@pytest.mark.slow_rows(
    "pulses at 50 Hz-dop853",
    "pulses at 50 Hz-cvodes",
    "square-dop853",
    "square-cvodes",
    "thin square-dop853",
    "thin square-cvodes",
    "Gaussian-dop853",
    "1 kHz-dop853",
    "1 kHz-cvodes",
    "chirp-dop853",
    "chirp-cvodes",
    "touching by value-dop853",
    "touching flatly-dop853",
    "floor-dop853",
    "floor-cvodes",
    "both-dop853",
    "power-dop853",
)
@pytest.mark.parametrize("way", NATIVE)
@pytest.mark.parametrize("case", CASES)
def test_every_switch_is_found_at_its_time(case, way):
    condition, stop_time, value, exact, count = CASES[case]
    run = cosim.simulate(integral(condition, stop_time, value), solver=way)
    assert run.final["y"] == pytest.approx(exact, abs=error_of(case))
    if case != "both":  # which switch at the same time
        assert len(run.events) == pytest.approx(count, abs=1)  # one may be at the end


@pytest.mark.slow
@pytest.mark.parametrize("way", ["CoSimulation 2", "CoSimulation 3", "ModelExchange 2"])
def test_an_fmu_finds_all_of_them_in_one_model(way, tmp_path):
    model = Model("integrals", stop_time=max(case[1] for case in CASES.values()))
    a, names = model.parameter("a", "1", 1.0, "factor"), {}
    for i, (case, (condition, stop_time, value, exact, _)) in enumerate(CASES.items()):
        y = model.state(f"y{i}", "1", 0.0, case)
        n = model.discrete(f"n{i}", "1", 0.0, f"{case}: how often it begins to hold")
        holds = ca.logic_and(condition(model.t, a), model.t < stop_time)
        model.derivative(y, ca.if_else(holds, value, 0))
        model.when(holds, {n: n + 1}, name=case)
        names[case] = i, exact
    run = ran(model.freeze(), way, tmp_path)
    for case, (i, exact) in names.items():
        assert run.final[f"y{i}"] == pytest.approx(exact, abs=error_of(case)), case
        if case != "both":  # as natively: one may be at the end
            assert 2 * run.final[f"n{i}"] == pytest.approx(CASES[case][-1], abs=1), case


@pytest.mark.quick_rows("dop853")
@pytest.mark.parametrize("way", ["dop853", "ModelExchange 2", "ModelExchange 3", "CoSimulation 3"])
def test_switches_follow_parameters_and_other_ends_of_the_run(way, tmp_path):
    dae, more = integral(lambda t, a: ca.sin(100 * pi * a * t) > 0.99, 1.0), {"a": 2.0}
    if way == "dop853":
        run = cosim.simulate(dae, solver=way, start_values=more, stop_time=2.0)
    else:
        interface, fmi = way.split()
        path = cosim.export_fmu(dae, tmp_path / "model.fmu", fmi=int(fmi))
        run = cosim.simulate_fmu(path, interface=interface, start_values=more, stop_time=2.0)
    assert len(run.events) == 400
    assert run.final["y"] == pytest.approx(2 * (pi - 2 * asin(0.99)) / (2 * pi), abs=1e-12)


@pytest.mark.slow
def test_a_jump_is_found_where_no_bounds_are_known(tmp_path):
    """`atan2` falls from pi to -pi: by samples."""
    dae = integral(lambda t, a: ca.atan2(ca.sin(t), a * ca.cos(t) / 2) > pi / 2, 6.0)
    for way in WAYS:
        run = ran(dae, way, tmp_path)
        assert run.final["y"] == pytest.approx(pi / 2, abs=1e-9), way


@pytest.mark.slow_rows("ModelExchange 2", "CoSimulation 3")
@pytest.mark.parametrize("way", WAYS)
def test_an_angle_falls_though_its_rate_is_constant(way, tmp_path):
    dae = integral(lambda t, a: ca.atan2(ca.sin(t), ca.cos(t)) > a, 10.0)
    assert ran(dae, way, tmp_path).final["y"] == pytest.approx(2 * (pi - 1), abs=1e-9)


@pytest.mark.parametrize("case", CASES)
def test_switches_of_an_input_of_an_fmu_are_found_at_their_times(case):
    condition, stop_time, value, exact, count = CASES[case]
    dae = integral(lambda t, _: condition(t, 1.0), stop_time, value)
    found = switch_times(dae, 0.0, stop_time)
    if case not in ("both", "floor"):  # which switches more often than its condition
        assert len(found[1:]) == pytest.approx(count, abs=1)  # one may be at the end
    ends = np.unique([0.0, *found, stop_time])
    middles = (ends[:-1] + ends[1:]) / 2
    rates = ca.Function("rate", [dae.t], [dae.ode])(middles[None])
    assert float(rates @ np.diff(ends)) == pytest.approx(exact, abs=error_of(case))


def test_relations_that_switch_at_the_same_time_do_so_once():
    def condition(t, _):
        return ca.logic_and(ca.sin(100 * pi * t) > 0, ca.cos(100 * pi * t - pi / 2) > 0)

    found = switch_times(integral(condition, 1.0), 0.0, 1.0)
    np.testing.assert_allclose(found, np.arange(len(found)) / 100, rtol=0, atol=1e-15)
    assert len(found) in (100, 101)  # one may be at the end


def test_a_condition_begins_to_hold_where_its_argument_gets_a_value():
    found = switch_times(integral(lambda t, _: ca.sqrt(t - 0.3) > -1, 1.0), 0.0, 1.0)
    np.testing.assert_allclose(found, [0.0, 0.3], rtol=1e-15)


def test_search_takes_parts_and_not_samples():
    """Switches at 20 kHz cost as many parts each as those at 50 Hz do."""
    counts = []
    for frequency, end in ((50, 1.0), (20_000, 0.1)):
        system = hybrid(integral(lambda t, _, f=frequency: ca.sin(2 * pi * f * t) > 0.3, 1.0))
        search = Argument(system, 0, np.array([0.0, end]), np.ones((1, 1)))
        switches = search.switches()
        assert len(switches) == 2 * frequency * end
        counts.append(search.parts().shape[1] / len(switches))
    assert counts[1] < 6  # measured 2.6
    assert abs(counts[1] - counts[0]) < 1  # measured 0.06
