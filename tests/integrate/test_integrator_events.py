"""`cosim.integrator` of models with events: values, derivatives, and failures."""

import gc
import warnings

import casadi as ca
import numpy as np
import pytest
from helpers.random_models import random_model
from helpers.samples import sampled

import cosim


def ball():
    """Return a ball that bounces, with a force and an algebraic unknown."""
    model = cosim.Model("ball", stop_time=1.0, output_interval=0.01)
    h, v = model.state("h", "m", 1.0, "height"), model.state("v", "m/s", 0.0, "speed")
    g = model.parameter("g", "m/s^2", 9.81, "gravity")
    e = model.parameter("e", "1", 0.7, "restitution")
    push = model.input("push", "m/s^2", 0.0, "force by mass")
    a = model.algebraic("a", "m/s^2", 0.0, "acceleration")
    model.derivative(h, v)
    model.derivative(v, a)
    model.equation(a + g - push)
    model.when(h < 0, {v: -e * v}, name="impact")
    return model.freeze()


def after_one_impact():
    """Return a function of x0, p of the height at 1 s in closed form."""
    x0, p = ca.SX.sym("x0", 2), ca.SX.sym("p", 2)
    (h, v), (g, e) = ca.vertsplit(x0), ca.vertsplit(p)
    hit = (v + ca.sqrt(v**2 + 2 * g * h)) / g
    left = 1.0 - hit
    return ca.Function("height", [x0, p], [e * (g * hit - v) * left - g / 2 * left**2])


@pytest.mark.quick_rows("idas")
@pytest.mark.parametrize("solver", ["dop853", "idas", "rosenbrock"])
def test_value_and_derivatives_in_closed_form(solver):

    run = cosim.integrator(ball(), [0.0, 0.3, 1.0], solver=solver, relative_tolerance=1e-10)
    x0, p, u = ca.MX.sym("x0", 2), ca.MX.sym("p", 2), ca.MX.sym("u", 1, 3)
    found = run(x0=x0, p=p, u=u)
    exact = after_one_impact()
    of = found["xf"][0, -1], exact(x0, p)
    own, other = (
        ca.Function("of", [x0, p, u], [value, ca.gradient(value, x0), ca.jacobian(value, p)])
        for value in of
    )
    at = [1.0, 0.4], [9.81, 0.7], np.zeros((1, 3))
    for a, b in zip(own(*at), other(*at), strict=True):
        np.testing.assert_allclose(np.array(a).ravel(), np.array(b).ravel(), rtol=1e-7, atol=1e-8)
    slopes = ca.Function("by", [x0, p, u], [ca.jacobian(found["zf"][:, -1], ca.veccat(p, u))])
    np.testing.assert_allclose(np.array(slopes(*at)).ravel(), [-1, 0, 0, 0, 1], atol=1e-12)


@pytest.mark.slow
def test_steps_of_an_input_move_a_block_that_rests_with_friction():
    """Slides 1/(2 mu), rests, is pushed from 2.5 to 3.5 s, and slides on."""
    model = cosim.Model("block", stop_time=4.0)
    x, v = model.state("x", "m", 0.0, "place"), model.state("v", "m/s", 1.0, "speed")
    mu = model.parameter("mu", "m/s^2", 0.5, "friction by mass")
    push = model.input("push", "m/s^2", 0.0, "force by mass")
    model.derivative(x, v)
    model.derivative(v, push - mu * ca.sign(v))
    dae = model.freeze()
    run = cosim.integrator(dae, np.linspace(0, 4, 9), solver="dop853", relative_tolerance=1e-9)
    p, u = ca.MX.sym("p"), ca.MX.sym("u", 1, 9)
    place = run(x0=[0.0, 1.0], p=p, u=u)["xf"][0, -1]
    f = ca.Function("f", [p, u], [place, ca.jacobian(place, p), ca.jacobian(place, u)])
    pushed = np.where((np.arange(9) == 6) | (np.arange(9) == 7), 1.0, 0.0)[None]
    value, by_mu, by_push = f(0.5, pushed)
    assert float(value) == pytest.approx(1.4375, abs=1e-9)
    assert float(by_mu) == pytest.approx(-3.125, abs=1e-7)
    # at rest, a small force does nothing: in the fifth interval, and in those of the push it does
    np.testing.assert_allclose(
        np.array(by_push)[0, [0, 5, 6, 7, 8]], [0, 0, 0.625, 0.375, 0.125], atol=1e-7
    )


@pytest.mark.slow
def test_optimization_finds_the_throw_that_bounces_to_a_height():
    run = cosim.integrator(ball(), [0.0, 1.0], solver="dop853", relative_tolerance=1e-10)
    speed = ca.MX.sym("speed")
    height = run(x0=ca.vertcat(1.0, speed), p=[9.81, 0.7])["xf"][0, -1]
    problem = {"x": speed, "f": (height - 0.5) ** 2}
    quiet = {"ipopt.print_level": 0, "print_time": 0, "ipopt.sb": "yes"}
    options = {"ipopt.hessian_approximation": "limited-memory", **quiet}
    found = ca.nlpsol("throw", "ipopt", problem, options)(x0=0.0)
    assert float(after_one_impact()([1.0, float(found["x"])], [9.81, 0.7])) == pytest.approx(
        0.5, abs=1e-6
    )


def test_function_outlives_its_name():
    run = cosim.integrator(ball(), [0.0, 1.0], solver="dop853", derivatives=False)
    x0 = ca.MX.sym("x0", 2)
    within = ca.Function("within", [x0], [run(x0=x0, p=[9.81, 0.7])["xf"][0, -1]])
    del run
    gc.collect()
    exact = after_one_impact()([1.0, 0.0], [9.81, 0.7])
    assert float(within([1.0, 0.0])) == pytest.approx(float(exact), abs=1e-6)


def test_run_that_a_stop_ends_has_no_result():
    model = cosim.Model("riser", stop_time=2.0)
    h = model.state("h", "m", 0.0, "height")
    model.derivative(h, 1.0)
    model.stop(h > 1, "at the top")
    run = cosim.integrator(model.freeze(), [0.0, 2.0])
    with pytest.raises(RuntimeError, match="a run to 2 s fails: 'at the top' ends it at 1 s"):
        run(x0=0.0)


@pytest.mark.parametrize("solver", ["dop853", "rosenbrock"])
def test_other_steps_of_an_input_compile_nothing(solver):
    model = cosim.Model("cart", stop_time=2.0, output_interval=0.1)
    v = model.state("v", "m/s", 0.0, "speed")
    push = model.input("push", "m/s^2", 0.0, "force by mass")
    model.derivative(v, push - v)
    dae = model.freeze()
    for k, height in enumerate((1.0, 3.0)):
        steps = cosim.InputSeries(("push",), [0, 1, 1, 2], [[0], [0], [height], [height]])
        run = cosim.simulate(dae, inputs=steps, solver=solver, relative_tolerance=1e-9)
        assert run.final["v"] == pytest.approx(height * (1 - np.exp(-1)), rel=1e-7)
        assert not k or "compile_time" not in run.stats


@pytest.mark.slow_rows("dop853")
@pytest.mark.parametrize("solver", ["dop853", "idas"])
def test_each_column_moves_what_rests_on_a_belt_that_the_input_drives(solver):
    """The place is the sum of speed times length of the intervals, equal speeds or not."""
    model = cosim.Model("belt", stop_time=4.0, output_interval=0.05)
    x, v = model.state("x", "m", 0.0, "place"), model.state("v", "m/s", 0.5, "speed")
    belt = model.input("belt", "m/s", 0.5, "speed of the belt")
    model.derivative(x, v)
    model.derivative(v, -3 * ca.sign(v - belt))
    dae = model.freeze()
    run = cosim.integrator(dae, np.arange(5.0), solver=solver, relative_tolerance=1e-9)
    u = ca.MX.sym("u", 1, 5)
    end = run(x0=[0.0, 0.5], u=u)["xf"][:, -1]
    by = ca.Function("by", [u], [ca.jacobian(end, u)])
    for apart in (0.0, 1e-9):
        found = np.array(by(0.5 + apart * np.array([[0, 0, 0, 1, 0]])))
        np.testing.assert_allclose(found, [[0, 1, 1, 1, 1], [0, 0, 0, 0, 1]], rtol=0, atol=1e-6)


@pytest.mark.slow_rows("1e-14-dop853", "1e-14-erk", "1e-14-cvodes")
@pytest.mark.parametrize("solver", ["dop853", "cvodes", "erk"])
@pytest.mark.parametrize("size", [1e-14, 1e-6])
def test_derivatives_by_tiny_numbers_are_as_accurate_as_others(size, solver):
    model = cosim.Model("driven", stop_time=2.0, output_interval=0.1)
    x, y = model.state("x", "1", 0.0, "what is driven"), model.state("y", "1", 0.0, "clock")
    count = model.discrete("count", "1", 0.0, "number")
    p = model.parameter("p", "1", 0.0, "amplitude")
    model.derivative(x, p * ca.sin(25 * model.t) * ca.exp(model.t) - 0.3 * x)
    model.derivative(y, 1.0)
    model.when(y > 0.77, {count: count + 1})
    run = cosim.integrator(model.freeze(), [0.0, 2.0], solver=solver, relative_tolerance=1e-8)
    number = ca.MX.sym("p")
    end = run(x0=[0.0, 0.0, 0.0], p=number)["xf"][0, -1]
    by = ca.Function("by", [number], [ca.jacobian(end, number)])
    # of scipy's DOP853 at 1e-12
    assert float(by(size)) == pytest.approx(-0.2665667639767548, abs=1e-6)


@pytest.mark.quick_share(0.3)
@pytest.mark.slow_rows("dop853-True", "rosenbrock-True")
@pytest.mark.parametrize("has_events", [False, True])
@pytest.mark.parametrize("solver", ["dop853", "idas", "rosenbrock"])
def test_unknowns_belong_to_the_interval_that_ends(solver, has_events):
    """0 = a - w + x, x' = a with w = 1, 2, 3: a is exp(-t) and jumps with w; w at the start: 1."""
    model = cosim.Model("follower", stop_time=3.0)
    x = model.state("x", "1", 0.0, "what follows")
    a, w = model.algebraic("a", "1", 0.0, "rate"), model.input("w", "1", 0.0, "what leads")
    model.derivative(x, a)
    model.equation(a - w + x)
    if has_events:
        count = model.discrete("count", "1", 0.0, "number")
        model.when(x > 50, {count: count + 1})
    run = cosim.integrator(model.freeze(), np.arange(4.0), solver=solver, relative_tolerance=1e-9)
    u = ca.MX.sym("u", 1, 4)
    unknown = run(x0=0.0 if not has_events else [0.0, 0.0], u=u)["zf"]
    both = ca.Function("both", [u], [unknown, ca.jacobian(unknown[1], u)])
    found, slope = both(np.array([[7.0, 1.0, 2.0, 3.0]]))
    e = np.exp(-np.arange(4.0))
    exact = [1, e[1], e[2] + e[1], e[3] + e[2] + e[1]]
    np.testing.assert_allclose(np.array(found).ravel(), exact, rtol=0, atol=1e-7)
    np.testing.assert_allclose(np.array(slope).ravel(), [0, e[1], 0, 0], rtol=0, atol=1e-7)


def test_stop_at_the_last_time_is_no_failure():
    model = cosim.Model("riser", stop_time=2.0)
    h = model.state("h", "m", 0.0, "height")
    model.derivative(h, 1.0)
    model.stop(model.t >= 1, "at the top")
    run = cosim.integrator(model.freeze(), [0.0, 1.0])
    assert float(run(x0=0.0)["xf"][0, -1]) == pytest.approx(1.0)


@pytest.mark.slow
@pytest.mark.parametrize("first", sampled(range(0, 40, 10), (), [0]))
def test_jacobians_of_random_models_with_relations_are_differences(first):
    """Every one is right, or the run is rejected."""
    right = [is_difference(random_model(seed)) for seed in range(first, first + 10)]
    assert sum(right) >= 7  # of seeds 0 to 25, 22


def is_difference(dae):
    """Return whether the derivatives by x0 and p are known; they are differences of runs then."""
    stop = dae.experiment.stop_time
    run = cosim.integrator(dae, [0.0, stop / 2, stop], solver="dop853", relative_tolerance=1e-10)
    given = {name: ca.DM(value) for name, value in cosim.start_vectors(dae).items()}
    given["u"] = ca.repmat(given["u"], 1, 3)
    try:
        found = run(**given)
        slopes = run.jacobian()(*(given[k] for k in ("x0", "z0", "p", "u")), *found.values())
    except RuntimeError:  # of CasADi, with the message of ours
        return False

    def moved(name, k, step):
        shift = ca.DM.zeros(given[name].shape)
        shift[k] = step
        return ca.vec(run(**given | {name: given[name] + shift})["xf"])

    for name, slope in (("x0", slopes[0]), ("p", slopes[2])):
        for k in range(given[name].numel()):
            step = 2.5e-6 * max(1.0, abs(float(given[name][k])))
            apart = (moved(name, k, step) - moved(name, k, -step)) / (2 * step)
            np.testing.assert_allclose(np.array(slope[:, k]), np.array(apart), rtol=1e-3, atol=1e-3)
    return True


def test_short_changes_are_seen_by_a_model_with_events():
    """A bump of the force adds an energy of 100 * 1e-3 * sqrt(pi)."""
    x, v = ca.SX.sym("x"), ca.SX.sym("v")
    force = 100 * ca.exp(-(((x - 2) / 1e-3) ** 2)) + ca.if_else(x > 9, 1.0, 0.0)
    system = {"x": ca.vertcat(x, v), "ode": ca.vertcat(v, force)}
    dae = cosim.from_casadi(system, start_values={"v": 1.0})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run = cosim.integrator(dae, [0.0, 4.0], derivatives=False)
    last = float(run(**cosim.start_vectors(dae))["xf"][1, -1])
    assert last == pytest.approx(np.sqrt(1 + 0.2 * np.sqrt(np.pi)), rel=1e-6)


def test_factory_makes_the_jacobian_of_a_model_with_events():
    run = cosim.integrator(ball(), [0.0, 1.0], solver="dop853")
    found = run.factory("f", ["x0", "p"], ["jac:xf:p"])(x0=[1.0, 0.0], p=[9.81, 0.7])
    exact = after_one_impact().factory("f", ["i0", "i1"], ["jac:o0:i1"])([1.0, 0.0], [9.81, 0.7])
    np.testing.assert_allclose(found["jac_xf_p"][2, :], exact, rtol=1e-6)


def test_second_derivatives_with_events_name_the_remedy():
    run = cosim.integrator(ball(), [0.0, 1.0], solver="dop853")
    x0 = ca.MX.sym("x0", 2)
    with pytest.raises(RuntimeError, match="hessian_approximation_to_limited_memory"):
        ca.hessian(run(x0=x0, p=[9.81, 0.7])["xf"][0, -1], x0)
