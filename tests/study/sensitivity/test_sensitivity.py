"""Sensitivities: closed forms, calculated initial values, and the check by finite differences."""

import json

import casadi as ca
import numpy as np
import pytest
from helpers.oscillators import K, oscillator

import cosim
from casadi_models.dae import Model
from casadi_models.dae.variational import variational
from cosim.cli.main import main
from cosim.errors import InitialConditionError, SolverError, UnknownName, UsageError
from cosim.model.inputs import InputSeries
from cosim.model.values import assign
from cosim.study.sensitivity.sensitivity import (
    SensitivityTarget,
    sensitivity,
    start_slopes,
)

SHORT = {"stop_time": 1.0, "output_interval": 0.1}


@pytest.mark.slow
@pytest.mark.parametrize("formulation", ["driven", "multipliers"])
def test_derivative_of_the_crank_angle_by_alpha_is_half_the_square_of_time(formulation):
    dae = cosim.load(f"crank_shaft/{formulation}")
    found = sensitivity(
        dae, outputs=["phi"], with_respect_to=["alpha", "omega", "density"], **SHORT
    )
    time = found.run.time
    # phi = phi0 + omega t + alpha t^2 / 2; measured 2e-16
    np.testing.assert_allclose(found["phi", "alpha"], time**2 / 2, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found["phi", "omega"], time, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found["phi", "density"], 0, rtol=0, atol=1e-12)
    assert found.check.scaled < 1e-9


def test_parameter_that_is_named_twice_has_one_derivative():
    dae = cosim.load("crank_shaft")
    names = ["alpha", "omega", "alpha"]
    found = sensitivity(dae, outputs=["phi"], with_respect_to=names, check=False, **SHORT)
    assert [target.name for target in found.targets] == ["alpha", "omega"]
    np.testing.assert_allclose(found.values[-1], [[0.5, 1.0]], rtol=1e-12)  # of t^2 / 2 and t
    assert repr(found) == "crank_shaft/driven: phi by alpha, omega; not checked"


@pytest.mark.slow_rows("False-erk", "False-rosenbrock", "True-rosenbrock")
@pytest.mark.parametrize(
    ("algebraic", "solver"),
    [
        *((False, solver) for solver in ("dop853", "erk", "rosenbrock", "cvodes")),
        *((True, solver) for solver in ("dop853", "rosenbrock", "idas")),
    ],
)
def test_derivatives_of_an_oscillator_are_the_closed_form(algebraic, solver):
    dae = oscillator(algebraic=algebraic).dae
    found = sensitivity(
        dae, outputs=["x"], with_respect_to=["k", "x", "v"], solver=solver, check=False, **SHORT
    )
    w, t, x0, v0 = np.sqrt(K), found.run.time, dae.x_start[0], dae.x_start[1]
    drive = 1 / (K - 1)
    by_k = (
        -(drive**2) * np.sin(t)
        - x0 * t * np.sin(w * t) / (2 * w)
        + drive**2 / w * np.sin(w * t)
        + (v0 - drive) * (t * np.cos(w * t) / w - np.sin(w * t) / w**2) / (2 * w)
    )
    expected = {"k": by_k, "x": np.cos(w * t), "v": np.sin(w * t) / w}
    for name, values in expected.items():
        np.testing.assert_allclose(found["x", name], values, rtol=0, atol=2e-6)


@pytest.mark.parametrize("name", ["w", "rF", "lambda", "phi", "delta", "phi_dot"])
def test_calculated_initial_values_of_the_bicycle_are_differentiated(name):
    dae = cosim.load("bicycle/independent")
    target = SensitivityTarget.of(dae, name)
    values = assign(dae, {"delta": 0.1, "phi": 0.2})
    found = start_slopes(dae, 0.0, values, [target])[:, 0]
    value = {"delta": 0.1, "phi": 0.2}.get(name, target.variable.start)
    step = 1e-5 * target.size

    def start(shift):
        values = {"delta": 0.1, "phi": 0.2, name: value + shift}
        return cosim.start_vectors(dae, values)["x0"]

    central = (start(step) - start(-step)) / (2 * step)
    np.testing.assert_allclose(found, central, rtol=0, atol=1e-7)


@pytest.mark.slow
def test_all_derivatives_of_the_bicycle_agree_with_finite_differences():
    dae = cosim.load("bicycle/independent")
    found = sensitivity(dae, stop_time=1.0, output_interval=0.25)
    assert len(found.targets) == 26
    assert found.check.scaled < 1e-6  # measured 4e-8


def test_variational_equations_do_not_change_the_run_of_the_model():
    dae = cosim.load("bar_on_frame/two_body")
    both = variational(dae)
    assert both.states[: len(dae.states)] == dae.states
    assert len(both.states) == 2 * len(dae.states)
    assert len(both.algebraics) == 2 * len(dae.algebraics)


@pytest.mark.slow
def test_constant_input_is_accepted_and_an_input_series_is_rejected():
    dae = cosim.load("bar_on_frame/reduced")
    found = sensitivity(dae, outputs=["theta"], with_respect_to=["T2"], **SHORT)
    assert found["theta", "T2"][-1] == pytest.approx(-1.4744, abs=1e-4)  # independent value
    series = InputSeries(("T2",), np.array([0.0, 1.0]), np.zeros((2, 1)))
    with pytest.raises(UsageError, match="T2 follows a time series"):
        sensitivity(dae, outputs=["theta"], with_respect_to=["T2"], inputs=series, **SHORT)


@pytest.mark.slow
def test_derivative_by_a_parameter_without_influence_is_zero():
    dae = cosim.load("bar_on_frame/reduced")
    found = sensitivity(dae, outputs=["Omega"], with_respect_to=["m", "Omega_dot"], **SHORT)
    assert not found["Omega", "m"].any()
    np.testing.assert_allclose(found["Omega", "Omega_dot"], found.run.time, rtol=0, atol=1e-12)


def test_disagreement_of_the_two_methods_is_an_error(monkeypatch):
    from cosim.study.sensitivity import sensitivity as module

    original = module.differences
    monkeypatch.setattr(module, "differences", lambda *a: original(*a) * 1.001)
    with pytest.raises(SolverError, match=r"d phi / d alpha at 1 s is 0\.5 by dop853"):
        sensitivity(cosim.load("crank_shaft"), outputs=["phi"], with_respect_to=["alpha"], **SHORT)


@pytest.mark.slow
def test_parameter_at_its_bound_is_varied_to_one_side():
    dae = cosim.load("bar_on_frame/reduced")  # frame_inertia is 1, its largest value
    found = sensitivity(dae, outputs=["M_phi"], with_respect_to=["frame_inertia"], **SHORT)
    assert found.check.scaled < 1e-8
    assert found["M_phi", "frame_inertia"].all()


@pytest.mark.parametrize(
    ("options", "error", "text"),
    [
        ({"with_respect_to": ["aplha"]}, UnknownName, "did you mean alpha"),
        ({"outputs": ["phii"]}, UnknownName, "did you mean phi"),
        ({"with_respect_to": []}, UsageError, "give a list of names"),
        ({"solver": "ode4"}, UsageError, "ode4 has no error control; choose another solver"),
        ({"solver": cosim.solvers.Dop853()}, UsageError, "give the name of a solver"),
    ],
)
def test_unknown_names_and_solvers_are_rejected(options, error, text):
    with pytest.raises(error, match=text):
        sensitivity(cosim.load("crank_shaft"), **options)


def test_calculated_initial_value_is_rejected_with_its_causes():
    with pytest.raises(InitialConditionError, match="start of theta is calculated"):
        sensitivity(cosim.load("bicycle"), with_respect_to=["theta"])


def test_ranking_begins_with_the_largest_weight_and_csv_reads_back(tmp_path):
    dae = cosim.load("bar_on_frame/reduced")
    found = sensitivity(dae, outputs=["theta"], with_respect_to=["b", "m", "length"], **SHORT)
    weights = [row["weight"] for row in found.ranking()]
    assert weights == sorted(weights, reverse=True)
    path = tmp_path / "d.csv"
    found.to_csv(path)
    table = np.genfromtxt(path, delimiter=",", names=True)
    np.testing.assert_array_equal(table["d_theta_d_b"], found["theta", "b"])


def test_command_writes_table_file_and_figure(tmp_path, capsys):
    csv, figure = tmp_path / "d.csv", tmp_path / "d.png"
    options = ["--outputs", "phi", "--by", "alpha,omega", "--stop-time", "1"]
    assert (
        main(["sensitivity", "crank_shaft", *options, "-o", str(csv), "--figure", str(figure)]) == 0
    )
    printed = capsys.readouterr()
    assert printed.out.splitlines()[0].split()[:3] == ["output", "by", "weight"]
    assert "differences of dop853 at 1e-12" in printed.err
    assert csv.read_text().startswith("time,d_phi_d_alpha,d_phi_d_omega\n")
    assert figure.stat().st_size > 1000
    assert main(["sensitivity", "crank_shaft", *options, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["check"]["bound"] == 1e-5
    assert {row["by"] for row in facts["derivatives"]} == {"alpha", "omega"}


@pytest.mark.slow
def test_derivatives_of_a_relay_jump_at_its_events():
    model = Model("relay", stop_time=5.0)
    x = model.state("x", "1", 0.0, "level")
    on = model.discrete("on", "1", 1.0, "whether it heats")
    k = model.parameter("k", "1", 2.0, "strength")
    model.derivative(x, -x + k * on)
    model.when(x > 1.2, {on: 0}, name="off")
    model.when(x < 0.8, {on: 1}, name="on")
    dae = model.freeze()
    found = cosim.sensitivity(dae, outputs=["x"], with_respect_to=["k"])  # checks itself
    step = 1e-5
    exact = {"solver": "dop853", "relative_tolerance": 1e-12}
    ends = [cosim.simulate(dae, start_values={"k": 2 + s}, **exact) for s in (step, -step)]
    assert len(ends[0].events) == 11
    slope = (ends[0].final["x"] - ends[1].final["x"]) / (2 * step)
    assert found["x", "k"][-1] == pytest.approx(slope, rel=1e-6)


def test_derivative_by_the_time_of_the_only_switch_is_the_jump():
    model = Model("switch", stop_time=2.0)
    x, p = model.state("x", "1", 0.0, "x"), model.parameter("p", "s", 1.0, "time of the switch")
    model.derivative(x, ca.if_else(model.t < p, 0, 1))
    found = cosim.sensitivity(model.freeze(), with_respect_to=["p"])
    assert found["x", "p"][-1] == pytest.approx(-1.0, abs=1e-12)


def test_derivative_by_a_switch_of_nanoseconds_is_checked():
    model = Model("fast", stop_time=2e-9, output_interval=1e-10)
    x, p = model.state("x", "1", 0.0, "x"), model.parameter("p", "s", 1.05e-9, "time of the switch")
    model.derivative(x, ca.if_else(model.t < p, 0, 1e9))
    found = cosim.sensitivity(model.freeze(), with_respect_to=["p"])
    assert found["x", "p"][-1] == pytest.approx(-1e9, rel=1e-9)


def test_derivatives_of_a_sampled_loop_are_checked_at_its_samples_too():
    """With E = exp(-a T), x(n T) = (E - k (1 - E)/a)^n x(0)."""
    model = Model("sampled", stop_time=0.6)
    x, u = model.state("x", "1", 1.0, "x"), model.discrete("u", "1", 0.0, "control")
    k = model.parameter("k", "1", 2.0, "gain")
    model.derivative(x, u - x)
    model.every(0.1, {u: -k * x})
    found = cosim.sensitivity(model.freeze(), with_respect_to=["x", "k"], output_interval=0.1)
    n, E = np.arange(7), np.exp(-0.1)
    factor = E - 2 * (1 - E)
    np.testing.assert_allclose(found["x", "x"], factor**n, rtol=0, atol=1e-9)
    slope = n * factor ** (n - 1) * (E - 1)
    np.testing.assert_allclose(found["x", "k"], slope, rtol=0, atol=1e-9)


def resting_blocks():
    """Two blocks that their springs cannot move."""
    model = Model("blocks", stop_time=0.1)
    force = model.parameter("force", "N", 1.0, "sliding friction")
    for i in (1, 2):
        x = model.state(f"x_{i}", "m", 0.5, "place")
        v = model.state(f"v_{i}", "m/s", 0.0, "speed")
        model.derivative(x, v)
        model.derivative(v, -x - force * ca.sign(v))
        model.output(f"friction_{i}", "N", force * ca.sign(v), "friction")
    return model.freeze()


@pytest.mark.slow_rows("dop853")
@pytest.mark.parametrize("solver", ["dop853", "erk"])
def test_friction_at_rest_takes_up_a_small_speed_at_once(solver):
    dae, by = resting_blocks(), ["v_1", "v_2", "x_1", "force"]
    names = ["x_1", "v_1", "x_2", "v_2"]
    found = sensitivity(dae, outputs=names, with_respect_to=by, solver=solver, check=False)
    after = found.values[1:]
    np.testing.assert_array_equal(after[:, 0], np.tile([0, 0, 1, 0], (len(after), 1)))
    np.testing.assert_array_equal(after[:, [1, 2, 3]], 0)
    np.testing.assert_array_equal(found.values[0, :, 0], [0, 1, 0, 0])


def test_derivatives_of_friction_at_rest_are_rejected():
    with pytest.raises(SolverError, match="no derivatives of outputs that hold it are known"):
        sensitivity(resting_blocks(), outputs=["friction_1"], with_respect_to=["x_1"], check=False)


@pytest.mark.slow
def test_finite_differences_at_few_times_are_no_check():
    model = Model("counter", stop_time=1.0)
    x, n = model.state("x", "m", 0.0, "place"), model.discrete("n", "1", 0.0, "number")
    model.derivative(x, 1)
    model.when(x > 0, {n: n + 1}, name="passage")
    with pytest.raises(SolverError, match="times only, as a small change of a value leads to"):
        sensitivity(model.freeze(), outputs=["n"], with_respect_to=["x"])


@pytest.mark.slow
def test_run_that_a_stop_ends_is_differentiated_up_to_it():
    model = Model("wall", stop_time=2.0, output_interval=0.05)
    x, speed = model.state("x", "m", 0.0, "place"), model.parameter("speed", "m/s", 1.0, "speed")
    model.derivative(x, speed)
    model.stop(x > 0.777, "the wall is reached")
    found = sensitivity(model.freeze())
    assert found.run.time[-1] == pytest.approx(0.75)
    np.testing.assert_allclose(found["x", "speed"], found.run.time, atol=1e-12)
    assert found.check is not None


@pytest.mark.slow_rows("<lambda>")
@pytest.mark.parametrize("extreme", [ca.fmax, lambda a, b: -ca.fmin(-a, -b)])
def test_kinks_of_nonlinear_algebraic_equations_are_differentiated(extreme):
    model = Model("buffer", stop_time=2.0, output_interval=0.05)
    x, v = model.state("x", "m", 0.3, "place"), model.state("v", "m/s", 1.0, "speed")
    z, k = model.algebraic("z", "m/s2", 0.0, "acceleration"), model.parameter("k", "1/s2", 9.0, "k")
    model.derivative(x, v)
    model.derivative(v, z)
    model.equation(z + 0.1 * z**3 + k * x + 30 * extreme(x - 0.4, 0))
    found = sensitivity(model.freeze(), outputs=["x"], with_respect_to=["k"])  # checks itself
    assert found["x", "k"][-1] == pytest.approx(0.065553, abs=1e-6)


@pytest.mark.slow_rows("given0")
@pytest.mark.parametrize("given", [{}, {"speed": 5.0, "steer_torque": 0.1}])
def test_derivative_by_the_speed_of_the_bicycle_is_that_of_runs_with_other_speeds(given):
    options = {"outputs": ["phi"], "stop_time": 1.0, "output_interval": 0.5}
    by = ["speed", "thetaR_dot", "zGB"]
    found = sensitivity("bicycle", with_respect_to=by, start_values=given, check=False, **options)
    assert [target.name for target in found.targets] == by
    speed, step = found.targets[0].nominal, 1e-3
    assert speed == pytest.approx(given.get("speed", 4.59999999))
    after, before = (
        cosim.simulate(
            "bicycle",
            start_values={**given, "speed": speed + shift},
            relative_tolerance=1e-11,
            **options,
        )["phi"]
        for shift in (step, -step)
    )
    expected = (after - before) / (2 * step)
    np.testing.assert_allclose(found["phi", "speed"], expected, rtol=1e-5)  # measured 3e-7
    np.testing.assert_allclose(found["phi", "thetaR_dot"], -0.3 * found["phi", "speed"], rtol=1e-12)


def test_steps_of_differences_are_of_the_size_of_the_value_in_the_run():
    """Of x = t sin(1 / p), at a thousandth of the model's own p."""
    x, p = ca.SX.sym("x"), ca.SX.sym("p")
    dae = cosim.from_casadi({"x": x, "p": p, "ode": ca.sin(1 / p)}, start_values={"p": 1.0})
    found = sensitivity(dae, start_values={"p": 1e-3}, **SHORT)
    np.testing.assert_allclose(found["x", "p"], -1e6 * np.cos(1e3) * found.run.time, rtol=1e-9)
    assert found.targets[0].nominal == 1e-3


@pytest.mark.parametrize("second", [1.0, 1e-9])
def test_differences_around_events_are_compared_whatever_the_time_scale(second):
    """Of a fall from 1 m that ends at sqrt(2 / g): the speed there is -sqrt(2 g)."""
    model = Model("fall", stop_time=second, output_interval=0.01 * second)
    h, v = model.state("h", "m", 1.0, "height"), model.state("v", "m/s", 0.0, "speed")
    g = model.parameter("g", "m/s^2", 9.81 / second**2, "gravity")
    model.derivative(h, v)
    model.derivative(v, -g)
    model.when(h < 0, {v: -v}, name="impact")
    found = sensitivity(model.freeze(), outputs=["v"], with_respect_to=["g"])
    exact = (np.sqrt(2 / 9.81) - 1) * second  # v = 2 sqrt(2 g) - g t
    assert found["v", "g"][-1] == pytest.approx(exact, rel=1e-6)


def test_order_of_events_at_one_time_matters_for_a_small_state_too():
    """What begins at the later one of two events depends on one or the other."""
    model = Model("two", stop_time=1.0, output_interval=0.1)
    a, b = (model.state(name, "m", 1.0, "way") for name in "ab")
    c, d = (model.state(name, "1", 0.0, "whether it has ended") for name in "cd")
    y = model.state("y", "m", 0.0, "what follows", nominal=1e-9)
    p, q = (model.parameter(name, "m/s", 2.0, "speed") for name in "pq")
    for state, rate in ((a, -p), (b, -q), (c, 0), (d, 0), (y, 1e-9 * c * d)):
        model.derivative(state, rate)
    model.when(a < 0, {c: 1.0}, name="first")
    model.when(b < 0, {d: 1.0}, name="second")
    with pytest.raises(SolverError, match=r"first, second at 0\.5 s happen at one time"):
        sensitivity(model.freeze(), outputs=["y"], check=False)


@pytest.mark.parametrize(
    ("name", "bounds"),
    [("k", (0.99995, 1.00005)), ("k", (0.99999, 2.0)), ("k", (0.0, 1.0)), ("e", (0.0, 1e-5))],
)
def test_check_stays_within_narrow_bounds(name, bounds):
    model = cosim.Model("narrow", stop_time=1.0)
    x, own = model.state("x", "1", 1.0, "state"), {"minimum": bounds[0], "maximum": bounds[1]}
    k = model.parameter("k", "1/s", 1.0, "rate", **(own if name == "k" else {}))
    e = model.parameter("e", "1/s", 0.0, "more", **(own if name == "e" else {}))
    model.derivative(x, -(k + e) * x)
    found = cosim.sensitivity(model.freeze(), with_respect_to=[name])
    assert found["x", name][-1] == pytest.approx(-np.exp(-1), rel=1e-7)
    assert found.check.scaled < 1e-6  # measured 5e-8


@pytest.mark.parametrize("nominal", [None, 1e-12])
def test_outputs_too_small_for_the_check_are_noted(nominal):
    model = cosim.Model("small")
    x, k = model.state("x", "m", 1e-10, "x"), model.parameter("k", "1/s", 1.0, "k")
    model.derivative(x, -k * x)
    size = {} if nominal is None else {"nominal": nominal}
    model.output("y", "m", x / 100, "y", **size)
    check = cosim.sensitivity(model.freeze(), outputs=["y"], with_respect_to=["k"]).check
    note = "the bound is more than all derivatives of y (at most 4e-13), with the nominal value 1"
    assert (note in str(check)) == (nominal is None)


@pytest.mark.parametrize(
    ("condition", "right", "is_moved"),
    [
        (lambda x, t, k: x >= 1, -0.5, True),  # y = k t^2/2, reset of x at 1/k: y(1) = 1 - 1/(2k)
        (lambda x, t, k: t * k >= 1, -0.5, True),
        (lambda x, t, k: t >= 1, 0.5, False),
    ],
)
@pytest.mark.parametrize("stop_time", [1.0, 1.5])
def test_derivatives_at_the_time_of_an_event_that_moves_are_called_one_sided(
    condition, right, is_moved, stop_time
):
    model = Model("m", stop_time=2.0)
    k = model.parameter("k", "1/s", 1.0, "rate")
    x, y = model.state("x", "1", 0.0, "ramp"), model.state("y", "s", 0.0, "its integral")
    model.derivative(x, k)
    model.derivative(y, x)
    model.when(condition(x, model.t, k), {x: 0.0 * x}, name="reset")
    found = sensitivity(model.freeze(), with_respect_to=["k"], stop_time=stop_time)
    at_event = found["y", "k"][np.searchsorted(found.run.time, 1.0 - 1e-9)]
    assert at_event == pytest.approx(right, abs=1e-9)
    assert ("one-sided, those after an event, at 1 s (reset)" in found.check.note) is is_moved


@pytest.mark.parametrize("solver", ["dop853", "cvodes", "idas"])
@pytest.mark.parametrize("width", [1e-1, 1e-3, 1e-4])
def test_steps_of_differences_are_small_beside_a_narrow_bump(solver, width):
    """v' = k exp(-((x - place) / width)^2) / width - v with x = t; v is in closed form."""
    x, v, k, place = (ca.SX.sym(name) for name in ("x", "v", "k", "place"))
    law = k * ca.exp(-(((x - place) / width) ** 2)) / width - v
    equations = {"x": ca.vertcat(x, v), "p": ca.vertcat(k, place), "ode": ca.vertcat(1, law)}
    dae = cosim.from_casadi(equations, start_values={"k": 2, "place": 1}, name="bump")
    found = sensitivity(dae, outputs=["v"], solver=solver, stop_time=2, output_interval=0.1)
    exact = np.sqrt(np.pi) * np.exp(width**2 / 4 - 1)
    assert found["v", "k"][-1] == pytest.approx(exact, rel=1e-6)  # measured 2e-7
    most = np.abs(found["v", "place"]).max()  # where the bump is, before: an error
    assert found["v", "place"][-1] == pytest.approx(2 * exact, abs=1e-6 * most)
    assert found.check.scaled < 1e-5
