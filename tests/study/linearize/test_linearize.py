"""Linear systems: closed forms, published speeds of the bicycle, FMU against model."""

import json

import casadi as ca
import numpy as np
import pytest
from helpers.bicycle_oracles import CAPSIZE_SPEED, WEAVE_FREQUENCY, WEAVE_SPEED
from helpers.fmu_files import set_attributes, with_description

import cosim
from casadi_models.dae import Model
from casadi_models.mechanics import kane
from casadi_models.mechanics.mechanism import mechanism
from cosim.cli.main import main
from cosim.errors import InitialConditionError, ParameterError, UnknownName, UsageError
from cosim.study.linearize.linearize import linearize
from cosim.study.linearize.local import influence
from cosim.study.linearize.spectrum import blocks, without_influence

UPRIGHT = {"phi_dot": 0.0}


def test_unstable_equilibrium_of_the_bar_has_the_eigenvalues_of_the_closed_form():
    dae = cosim.load("bar_on_frame/reduced")
    linear = linearize(dae, at="equilibrium", start_values={"Omega_dot": 0.0})
    assert linear.x[0] == pytest.approx(np.pi / 2, abs=1e-9)
    assert "equilibrium" in linear.point
    assert linear.steadiness == "steady, moving on: phi"
    # theta'' = Omega^2 theta - b / I theta' near 90 deg
    values = {v.name: v.start for v in dae.parameters}
    damping = values["b"] / (values["m"] * values["length"] ** 2 / 12)
    roots = np.roots([1, damping, -((2 * np.pi) ** 2)])
    found = [m.value for m in linear.modes if "theta" in m.states]
    np.testing.assert_allclose(sorted(found, key=np.real), sorted(roots), rtol=1e-12)
    assert repr(linear).startswith("bar_on_frame/reduced at ")


@pytest.mark.slow_rows("multipliers")
@pytest.mark.parametrize("formulation", ["independent", "multipliers"])
def test_weave_and_capsize_of_the_bicycle_are_the_published_speeds(formulation):
    dae = cosim.load(f"bicycle/{formulation}")
    values = np.linspace(-10, -24, 8)
    sweep = linearize(dae, along={"thetaR_dot": values}, start_values=UPRIGHT, outputs=["speed"])
    capsize, weave = sweep.crossings
    assert capsize.outputs["speed"] == pytest.approx(CAPSIZE_SPEED, abs=1e-9)  # 1.4e-11
    assert weave.outputs["speed"] == pytest.approx(WEAVE_SPEED, abs=1e-9)  # 1.7e-12
    assert weave.frequency == pytest.approx(WEAVE_FREQUENCY, abs=1e-9)
    assert capsize.frequency == 0
    assert (weave.unstable, capsize.unstable) == ("above", "below")  # thetaR_dot is negative
    is_minimal = formulation == "independent"  # drift decays with real eigenvalues of its own
    assert (weave.mode, capsize.mode) == ("weave", "capsize" if is_minimal else "real")
    assert sorted(filter(None, sweep.modes)) == (
        ["capsize", "castering", "weave", "weave"] if is_minimal else ["weave", "weave"]
    )


@pytest.mark.slow_rows("bicycle/multipliers-3")
@pytest.mark.parametrize(("model", "fmi"), [("bicycle/independent", 2), ("bicycle/multipliers", 3)])
def test_fmu_has_the_eigenvalues_of_its_model(tmp_path, model, fmi):
    dae = cosim.load(model)
    path = cosim.export_fmu(dae, tmp_path / "bicycle.fmu", fmi=fmi)
    bare = linearize(path, start_values=UPRIGHT)
    graph = linearize(dae, start_values=UPRIGHT, outputs=bare.outputs)
    assert bare.states == graph.states
    assert bare.inputs == graph.inputs
    for name in "ABCD":
        own, other = getattr(graph, name), getattr(bare, name)
        np.testing.assert_allclose(other, own, rtol=1e-10, atol=1e-11 * np.abs(own).max())
    found, expected = (_simple(linear.eigenvalues) for linear in (bare, graph))
    assert len(found) == len(expected) >= 4
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)


def _simple(values):
    """Leave out zeros and the double root of the closing constraints, known to half the digits."""
    return np.sort_complex([v for v in values if abs(v) > 1e-6 and abs(v + 1) > 1e-6])


def test_matrices_agree_with_finite_differences_of_the_model():
    dae = cosim.load("bar_on_frame/two_body")
    linear = linearize(dae, outputs=["M_phi"])

    def output(shift):
        starts = {"Omega": 2 * np.pi + shift}
        return cosim.simulate(dae, start_values=starts, stop_time=0.0, outputs=["M_phi"])["M_phi"]

    # the frame's bodies follow calculated initial values, so that only the input is compared
    torque = [
        cosim.simulate(dae, start_values={"T2": t}, stop_time=0.0, outputs=["M_phi"])["M_phi"][0]
        for t in (-1e-3, 1e-3)
    ]
    column = linear.inputs.index("T2")
    assert linear.D[0, column] == pytest.approx((torque[1] - torque[0]) / 2e-3, abs=1e-9)
    assert output(0.0)[0] == linear.y[0]


def test_formulations_have_the_same_nonzero_eigenvalues():
    found = []
    for formulation in ("reduced", "multipliers"):
        linear = linearize(cosim.load(f"disk_two_bars/{formulation}"), at="equilibrium")
        found.append([value for value in linear.eigenvalues if abs(value) > 1e-6])
    np.testing.assert_allclose(found[0], found[1], rtol=1e-9)
    assert len(found[0]) == 4


def test_linearization_at_a_time_uses_the_state_of_the_run():
    dae = cosim.load("bar_on_frame/reduced")
    linear = linearize(dae, at=0.5)
    run = cosim.simulate(dae, stop_time=0.5, output_interval=0.5)
    assert linear.x[0] == run["theta"][-1]
    assert linear.steadiness.startswith("not steady")


def test_command_linearizes_a_scene_with_its_series(capsys):
    assert main(["linearize", "bicycle_steer_kick", "--at", "1.2", "--json"]) == 0
    (found,) = json.loads(capsys.readouterr().out)
    assert found["u"] == [2.0, 0.0, 0.0]
    assert found["x"][found["states"].index("delta")] != 0  # without the kick it runs straight


def test_scene_is_linearized_with_its_start_time_and_solver(tmp_path, capsys):
    """One long step of rk4 differs from what other solvers give."""
    (tmp_path / "late.py").write_text(
        "from casadi_models.dae import Model\n"
        "def build():\n"
        "    m = Model('late', stop_time=1.0)\n"
        "    x = m.state('x', '1', 1.0, 'x')\n"
        "    m.derivative(x, 2 - 3 * x**2)\n"
        "    m.output('y', '1', m.t * x, 'product')\n"
        "    return m.freeze()\n"
    )
    scene = tmp_path / "late.toml"
    scene.write_text(
        'model = "late.py:build"\n[run]\nstart_time = 2.0\nstop_time = 3.0\n'
        'solver = "rk4"\nstep_size = 0.5\n'
    )
    assert main(["linearize", str(scene), "--json"]) == 0
    (found,) = json.loads(capsys.readouterr().out)
    assert (found["time"], found["C"]) == (2.0, [[2.0]])
    assert main(["linearize", str(scene), "--at", "2.5", "--json"]) == 0
    (found,) = json.loads(capsys.readouterr().out)

    def rate(x):
        return 2 - 3 * x**2

    k1 = rate(1.0)
    k2 = rate(1 + 0.25 * k1)
    k3 = rate(1 + 0.25 * k2)
    k4 = rate(1 + 0.5 * k3)
    assert found["x"] == pytest.approx([1 + 0.5 * (k1 + 2 * k2 + 2 * k3 + k4) / 6], rel=1e-14)


def test_time_after_the_end_of_a_run_is_rejected():
    model = Model("falling")
    x = model.state("x", "m", 0.0, "place")
    model.derivative(x, 1 + 0 * x)
    model.output("y", "m", x**2, "square")
    model.stop(x > 0.5, "x is large")
    dae = model.freeze()
    assert linearize(dae, at=0.25).C[0, 0] == pytest.approx(0.5, rel=1e-9)
    with pytest.raises(ParameterError, match=r"at = 1 s is after .* at 0.5 s, where x is large"):
        linearize(dae, at=1.0)


def test_model_of_one_state_without_outputs_has_empty_rows():
    model = Model("alone", stop_time=1.0)
    x = model.state("x", "1", 2.0, "x")
    model.derivative(x, 1 - 3 * x)
    found = linearize(model.freeze())
    assert (found.A.tolist(), found.rates.tolist()) == ([[-3.0]], [-5.0])
    assert (found.C.shape, found.D.shape, found.y.shape) == ((0, 1), (0, 0), (0,))
    assert len(found.rows()) == 1


def test_inputs_have_the_values_of_their_series_at_the_time():
    """x' = u - x with u = 2 t."""
    model = Model("driven", stop_time=2.0)
    x, u = model.state("x", "1", 1.0, "x"), model.input("u", "1", 0.0, "u")
    model.derivative(x, u - x)
    model.output("y", "1", u * x, "product")
    dae = model.freeze()
    series = cosim.InputSeries(("u",), np.array([0.0, 2.0]), np.array([[0.0], [4.0]]))
    found = linearize(dae, at=1.0, inputs=series)
    assert found.x[0] == pytest.approx(3 / np.e, rel=1e-6)  # 2 t - 2 + 3 exp(-t)
    assert found.u[0] == 2.0
    np.testing.assert_array_equal(found.C, [[2.0]])
    assert found.rates[0] == pytest.approx(2 - 3 / np.e, rel=1e-6)
    with pytest.raises(UsageError, match="u follows a time series"):
        linearize(dae, inputs=series, along={"u": [0.0, 1.0]})


def test_cyclic_states_influence_only_each_other():
    dae = cosim.load("bicycle/independent")
    names = [dae.states[i].name for i in without_influence(influence(dae))]
    assert names == ["thetaR", "psi", "thetaF", "xP", "yP"]


def test_blocks_are_groups_of_states_that_influence_each_other():
    pattern = np.array([[0, 1, 0, 0], [1, 0, 1, 0], [0, 0, 0, 1], [0, 0, 0, 0]])
    assert blocks(pattern) == ((0, 1), (2,), (3,))


def test_missing_equilibrium_is_an_error_that_names_the_state():
    with pytest.raises(InitialConditionError, match="Omega cannot come to rest"):
        linearize(cosim.load("bar_on_frame/reduced"), at="equilibrium")


@pytest.mark.parametrize(
    ("options", "error", "text"),
    [
        ({"at": "equilibrum"}, UnknownName, "did you mean equilibrium"),
        ({"outputs": ["phii"]}, UnknownName, "did you mean phi"),
        ({"start_values": {"alphaa": 1.0}}, UnknownName, "did you mean alpha"),
    ],
)
def test_unknown_names_are_rejected(options, error, text):
    with pytest.raises(error, match=text):
        linearize(cosim.load("crank_shaft"), **options)


def test_values_along_a_parameter_must_be_monotonic():
    with pytest.raises(ParameterError, match="increasing or decreasing"):
        linearize(cosim.load("crank_shaft"), along={"alpha": [1.0, 3.0, 2.0]})


def test_a_value_beside_values_along_the_same_parameter_is_rejected(tmp_path, capsys):
    values = {"start_values": {"b": 4.0}, "along": {"b": [0.1, 0.2]}}
    with pytest.raises(UsageError, match="b is in start_values and in along; give it once"):
        linearize("bar_on_frame", **values)
    scene = tmp_path / "s.toml"
    scene.write_text('model = "bar_on_frame"\n[parameters]\nb = 4.0\n')
    along = ["--along", "b=0.1:0.2:2", "--outputs", "theta"]
    assert main(["linearize", str(scene), *along]) == 0  # its own value gives way
    assert main(["linearize", str(scene), *along, "-p", "b=3"]) == 2
    assert "b is in start_values and in along" in capsys.readouterr().err


def test_fmu_is_linearized_at_its_initial_state_only(tmp_path):
    path = cosim.export_fmu(cosim.load("crank_shaft/driven"), tmp_path / "crank.fmu")
    with pytest.raises(UsageError, match="linearized at its initial state"):
        linearize(path, at=1.0)
    with pytest.raises(UnknownName, match="did you mean alpha"):
        linearize(path, start_values={"alphaa": 1.0})


def test_fmu_of_a_steep_law_without_slope_has_a_linear_system(tmp_path):
    """The slopes of 1e6 x^2 and 1e9 |x|^1.5 are 0 at 0, although they are large beside it."""
    model = Model("steep", stop_time=1.0)
    x, y = model.state("x", "1", 0.0, "state"), model.state("y", "1", 0.0, "state")
    model.derivative(x, 1e6 * x**2)
    model.derivative(y, -1e9 * ca.fabs(y) ** 1.5)
    found = linearize(cosim.export_fmu(model.freeze(), tmp_path / "steep.fmu"))
    assert found.A.tolist() == [[0, 0], [0, 0]]


@pytest.mark.parametrize("fmi", [2, 3])
def test_fmu_whose_inputs_and_outputs_act_by_time_has_the_system_of_its_start(fmi, tmp_path):
    model = Model("timed", stop_time=10.0)
    x, u = model.state("x", "1", 0.5, "state"), model.input("u", "1", 0.0, "input")
    model.derivative(x, (1 + model.t) * u - x)
    model.output("y", "1", ca.cos(model.t) * x, "output")
    path = cosim.export_fmu(model.freeze(), tmp_path / "timed.fmu", fmi=fmi)
    found = linearize(path, outputs=["y"])
    assert (found.A.item(), found.B.item(), found.C.item(), found.D.item()) == (-1, 1, 1, 0)


def test_equilibrium_is_that_at_the_start_time():
    model = Model("ramp", stop_time=10.0)
    x, y = model.state("x", "1", 0.0, "switched"), model.state("y", "1", 0.0, "driven")
    model.derivative(x, ca.if_else(model.t > 3, 2.0, 1.0) - x)
    model.derivative(y, model.t - y)
    found = linearize(model.freeze(), at="equilibrium", start_time=5.0)
    assert found.x == pytest.approx([2.0, 5.0], abs=1e-10)
    assert found.is_steady


def test_fmu_is_linearized_at_its_own_start_time(tmp_path):
    model = Model("timed", stop_time=10.0)
    x, u = model.state("x", "1", 0.5, "state"), model.input("u", "1", 0.0, "input")
    model.derivative(x, (1 + model.t) * u - x)
    model.output("y", "1", ca.cos(model.t) * x, "output")
    path = cosim.export_fmu(model.freeze(), tmp_path / "timed.fmu")
    edit = set_attributes("DefaultExperiment", startTime="2", stopTime="3")
    found = linearize(with_description(path, tmp_path / "late.fmu", edit), outputs=["y"])
    assert (found.time, found.B.item()) == (2.0, 3.0)
    assert found.C.item() == pytest.approx(np.cos(2.0))


def test_fmu_with_structured_names_has_each_variable_once(tmp_path):
    dae = cosim.load("crank_shaft/driven")
    path = cosim.export_fmu(dae, tmp_path / "crank.fmu", names="structured")
    outputs = cosim.linearize(path).outputs
    assert len(outputs) == len(set(outputs)) == len(dae.output_variables) + len(dae.states)


def test_command_does_not_run_an_untrusted_fmu(tmp_path, monkeypatch):
    path = cosim.export_fmu(cosim.load("crank_shaft/driven"), tmp_path / "crank.fmu")
    monkeypatch.setenv("COSIM_TRUST", "known")
    monkeypatch.setattr("cosim.fmi.trust.is_trusted", lambda _: False)
    assert main(["linearize", str(path)]) == 1
    assert main(["linearize", str(path), "--trust", "--outputs", "T"]) == 0


@pytest.mark.slow
def test_command_shows_modes_and_crossings(tmp_path, capsys):
    assert main(["linearize", "crank_shaft", "--outputs", "T"]) == 0
    assert "crank_shaft/driven at its initial state" in capsys.readouterr().out
    figure, csv = tmp_path / "e.png", tmp_path / "e.csv"
    words = ["--along", "thetaR_dot=-10:-24:8", "-p", "phi_dot=0", "--outputs", "speed"]
    files = ["-o", str(csv), "--figure", str(figure)]
    assert main(["linearize", "bicycle", *words, *files]) == 0
    shown = capsys.readouterr().out
    assert "6.024262015" in shown
    assert "4.292382536" in shown
    assert figure.stat().st_size > 1000
    assert len(csv.read_text().splitlines()) == 9
    assert main(["linearize", "crank_shaft", "--at", "0.5,1", "--json"]) == 0
    assert [p["time"] for p in json.loads(capsys.readouterr().out)] == [0.5, 1.0]


@pytest.mark.parametrize("words", [["--along", "alpha"], ["--at", "soon"], ["--figure", "x.png"]])
def test_command_rejects_invalid_options(words):
    assert main(["linearize", "crank_shaft", *words]) == 2


@pytest.mark.slow
def test_crossing_at_an_unsteady_state_is_no_critical_speed():
    along = {"along": {"thetaR_dot": [-13.0, -15.0]}, "outputs": ["speed"]}
    with pytest.raises(InitialConditionError, match=r"not steady: .* not for a limit of stability"):
        linearize("bicycle", **along)  # its roll rate is 0.5 rad/s; 4.27 m/s was reported
    (weave,) = linearize("bicycle", at="equilibrium", **along).crossings
    assert weave.outputs["speed"] == pytest.approx(WEAVE_SPEED, rel=1e-10)


def block(place=0.5, speed=0.0):
    """A block on a rough table, held by a spring and pulled by a force."""
    model = Model("block", stop_time=2.0)
    x, v = model.state("x", "m", place, "place"), model.state("v", "m/s", speed, "speed")
    force = model.input("force", "N", 0.0, "force")
    model.derivative(x, v)
    model.derivative(v, force - x - ca.sign(v))
    model.output("friction", "N", ca.sign(v), "friction")
    return model.freeze()


@pytest.mark.parametrize(
    ("dae", "at"), [(block(), "start"), (block(), "equilibrium"), (block(0.5, 0.3), 1.9)]
)
def test_block_that_sticks_is_steady_and_its_friction_balances_what_pulls_it(dae, at):
    linear = linearize(dae, at=at)
    assert linear.is_steady
    np.testing.assert_array_equal(linear.A, [[0, 1], [0, 0]])
    np.testing.assert_array_equal(linear.B, [[0], [0]])
    np.testing.assert_array_equal(linear.C, [[-1, 0]])
    np.testing.assert_array_equal(linear.D, [[1]])


def test_block_that_slides_has_the_eigenvalues_of_its_spring():
    linear = linearize(block(0.5, 0.3))
    np.testing.assert_allclose(sorted(linear.eigenvalues, key=np.imag), [-1j, 1j])
    assert not linear.is_steady


@pytest.mark.parametrize(
    ("law", "slope"),
    [(ca.fabs, None), (lambda x: ca.fmax(0, -x), None), (lambda x: x * ca.fabs(x), 0.0)],
)
def test_state_at_a_kink_is_rejected(law, slope):
    model = Model("spring")
    x, v = model.state("x", "m", 0.0, "place"), model.state("v", "m/s", 0.3, "speed")
    model.derivative(x, v)
    model.derivative(v, -law(x))
    if slope is None:
        with pytest.raises(InitialConditionError, match=r"exactly at 0 .* another one"):
            linearize(model.freeze())
    else:
        np.testing.assert_array_equal(linearize(model.freeze()).A, [[0, 1], [slope, 0]])


@pytest.mark.parametrize(("start", "ends"), [(0.0, False), (1e-3, True), (1.0, True), (9.0, True)])
def test_slope_that_is_not_finite_at_the_start_is_named(start, ends):
    """An empty tank, x' = 1 - sqrt(x), has no derivative; a full one finds x = 1."""
    x = ca.SX.sym("x")
    tank = cosim.from_casadi({"x": x, "ode": 1 - ca.sqrt(x)}, {"x": start}, name="tank")
    if ends:
        assert linearize(tank, at="equilibrium").x[0] == pytest.approx(1, rel=1e-10)
    else:
        with pytest.raises(InitialConditionError, match="x_dot has no finite derivative"):
            linearize(tank, at="equilibrium")


@pytest.mark.parametrize("span", [1e-9, 1.0, 1e12])
@pytest.mark.parametrize("size", [1e-9, 1e9])
def test_rest_does_not_depend_on_the_time_scale(span, size):
    model = Model("tank", stop_time=span)
    level = model.state("level", "m", 0.0, "level", nominal=size)
    model.derivative(level, size / span * (1 - (level / size) ** 3 - level / size))
    dae = model.freeze()
    root = np.roots([1, 0, 1, -1]).real.max()
    found = cosim.linearize(dae, at="equilibrium")
    assert found.x / size == pytest.approx([root], rel=1e-12)
    assert found.steadiness == "at rest"
    assert found.A[0, 0] * span == pytest.approx(-3 * root**2 - 1, rel=1e-12)
    assert cosim.linearize(dae).steadiness.startswith("not steady: level changes by")


def test_rates_that_are_rounding_errors_of_large_forces_are_a_rest():
    model = Model("scales", stop_time=1.0)
    x = model.state("x", "m", 1.0, "displacement")
    v = model.state("v", "m/s", 0.0, "speed", nominal=1e-6)
    load = model.parameter("load", "m/s2", 2.7997274192541552, "load")
    k = model.parameter("k", "1", 3.1085649907520086e-06, "stiffness")
    model.derivative(x, v)
    model.derivative(v, load * (1 + k * (x - 0.3) + k * x**3) - load * (1 + 0.1 * k))
    found = cosim.linearize(model.freeze(), at="equilibrium")
    assert found.x[0] + found.x[0] ** 3 == pytest.approx(0.4, abs=1e-9)


@pytest.mark.parametrize("free", [("q1",), None], ids=["eliminated", "multipliers"])
@pytest.mark.parametrize("size", [1e-9, 1.0, 1e3])
def test_hanging_linkage_of_any_size_is_found_at_rest(size, free):
    """Virtual work of its weight, along its one motion, is zero."""
    model = Model("linkage", stop_time=1.0)
    starts = {"q1": 1.0, "q2": 0.3, "q3": 1.2}
    q = ca.vertcat(*(model.state(name, "rad", x, "angle") for name, x in starts.items()))
    u, lengths = ca.SX.sym("u", 3), np.array([1.0, 2.0, 1.7]) * size
    bars = [a * ca.vertcat(ca.cos(q[i]), ca.sin(q[i])) for i, a in enumerate(lengths)]
    right = ca.DM([1.8 * size, 0])
    centers = [bars[0] / 2, bars[0] + bars[1] / 2, right + bars[2] / 2]
    inertias, loads = [], []
    for i, center in enumerate(centers):
        velocity = ca.jtimes(center, q, u)
        inertias.append(kane.InertialTerm(velocity, velocity))
        inertias.append(kane.InertialTerm(u[i], lengths[i] ** 2 / 12 * u[i]))
        loads.append(kane.Load(velocity, ca.vertcat(0, -9.81)))
    loop = bars[0] + bars[1] - right - bars[2]
    independent = None if free is None else q[0]
    mechanism(model, q, u, inertias, loads, {"loop": loop}, independent=independent)
    found = cosim.linearize(model.freeze(), at="equilibrium", outputs=["q1"])
    height = sum(center[1] for center in centers)
    law = [loop, ca.jacobian(loop, q), ca.jacobian(height, q)]
    gap, slopes, weights = (np.array(v) / size for v in ca.Function("law", [q], law)(found.x[:3]))
    motion = np.linalg.svd(slopes)[2][-1]
    assert np.abs(gap).max() < 1e-9
    assert abs(weights @ motion).max() < 1e-9
