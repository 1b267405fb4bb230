"""Scenes: what a file says reaches the run, and what is wrong in it is named with its line."""

from math import pi
from pathlib import Path

import numpy as np
import pytest

import cosim
from cosim.api import execute
from cosim.errors import (
    InitialConditionError,
    ParameterError,
    UnknownName,
    UsageError,
)
from cosim.model.solver import Tolerance
from cosim.scene import find_scene, shipped_scenes
from cosim.scene.scene import run_settings
from cosim.scene.scene_file import read_scene
from cosim.scene.variants import in_formulation, variant, with_solver

GOOD = """\
title = "Bar"
model = "bar_on_frame/reduced"
outputs = ["theta", "M_phi"]

[parameters]
b = "0.04 ft.lbf.s/rad"
length = 0.5

[start]
theta = "30 deg"

[inputs]
T2 = 0.01

[run]
stop_time = 2
output_interval = 0.02
solver = "erk"
relative_tolerance = 1e-9
absolute_tolerance = 1e-11

[[figures]]
title = "Angle"
panels = [["theta"], ["M_phi"]]
labels = ["angle", "torque"]
"""


@pytest.fixture
def write(tmp_path):
    """Return a function that writes a scene."""

    def write(text, name="scene.toml"):
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write


@pytest.mark.slow
def test_everything_in_a_scene_reaches_the_run(write):
    run = cosim.run_scene(read_scene(write(GOOD)))
    same = cosim.simulate(
        cosim.load("bar_on_frame/reduced"),
        stop_time=2,
        output_interval=0.02,
        solver="erk",
        relative_tolerance=1e-9,
        absolute_tolerance=1e-11,
        start_values={"b": 0.04 * 1.3558179483314004, "length": 0.5, "theta": pi / 6, "T2": 0.01},
    )
    assert run.names == ("theta", "M_phi")
    assert run.stats["solver"] == "erk"
    assert len(run) == 101
    for name in run.names:
        # other steps, since phi is gone; measured 1.5 rtol
        np.testing.assert_allclose(run[name], same[name], rtol=0, atol=20e-9)


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["fmu-me", "fmu-cs"])
def test_everything_in_a_scene_reaches_the_fmu(write, backend):
    scene = read_scene(write(GOOD))
    run, again = cosim.run_scene(scene), cosim.run_scene(scene, backend)
    assert again.names == run.names
    assert cosim.compare(run, again, bound=1e-6).agrees  # measured 3e-8 ME at rtol 1e-9


def test_scene_without_outputs_runs_the_full_model(write):
    run = cosim.run_scene(read_scene(write('model = "crank_shaft"\n[run]\nstop_time = 0.1\n')))
    assert set(run.names) == set(cosim.load("crank_shaft").observed)


def test_outputs_of_a_scene_reduce_its_model(write):
    scene = read_scene(write('model = "bar_on_frame"\noutputs = ["theta"]\n'))
    dae = scene.request.reduced().dae
    assert {v.name for v in dae.states} == {"theta", "theta_dot", "Omega"}
    assert any(line.startswith("states: 4 -> 3") for line in dae.report)


def test_values_of_a_scene_are_the_starts_of_its_fmu(write, tmp_path):
    from fmpy import read_model_description

    path = cosim.export_fmu(
        read_scene(write(GOOD)).request.reduced().configured(), tmp_path / "bar.fmu"
    )
    description = read_model_description(str(path))
    starts = {v.name: v.start for v in description.modelVariables}
    assert float(starts["length"]) == 0.5
    assert float(starts["theta"]) == pi / 6
    assert float(starts["T2"]) == 0.01
    assert float(description.defaultExperiment.stopTime) == 2
    assert float(description.defaultExperiment.stepSize) == 0.02


@pytest.mark.parametrize(("start", "stop"), [(-3.0, -1.0), (-2.0, 0.0), (0.0, 2.0), (5.0, 7.0)])
def test_model_is_shown_with_a_run_as_long_as_that_of_the_scene(start, stop):
    request = cosim.requested("crank_shaft", start_time=start, stop_time=stop)
    assert request.configured().experiment.stop_time == 2.0


def test_model_itself_is_left_as_it_was(write):
    scene = read_scene(write(GOOD))
    scene.request.configured()
    assert scene.dae.variable("length").start == 0.3048
    assert scene.dae.experiment.stop_time == 10


def test_byte_order_mark_crlf_comments_and_inline_tables_are_read(write):
    text = '\ufeff# bar\r\nmodel = "bar_on_frame" # first\r\nstart = {theta = "1 rad"}\r\n'
    assert read_scene(write(text)).request.values == {"theta": 1.0}


def test_dotted_keys_are_read(write):
    scene = read_scene(write('model = "crank_shaft"\nrun.stop_time = 1.5\n'))
    assert scene.request.times == cosim.Times(stop=1.5)


def test_user_model_is_found_in_the_folder_of_its_scene(write):
    write(
        "from casadi_models.dae import Model\n"
        "def build():\n"
        "    model = Model('decay', stop_time=1.0)\n"
        "    x = model.state('x', 'm', 1.0, 'what decays')\n"
        "    model.derivative(x, -x)\n"
        "    return model.freeze()\n",
        "mine.py",
    )
    run = cosim.run_scene(read_scene(write('model = "mine.py:build"\n')))
    assert run["x"][-1] == pytest.approx(np.exp(-1), rel=1e-7)


def test_input_series_is_found_in_the_folder_of_its_scene(write):
    write("time,steer_torque\n0,0\n1,1\n", "kick.csv")
    text = 'model = "bicycle"\n[inputs]\nfile = "kick.csv"\nroll_torque = 2\n'
    scene = read_scene(write(text))
    assert scene.request.inputs.names == ("steer_torque",)
    assert scene.request.values == {"roll_torque": 2.0}


def test_series_of_an_input_that_a_reduction_drops_does_no_harm(write):
    write("time,steer_torque\n0,0\n1,1\n", "kick.csv")
    text = 'model = "bicycle"\noutputs = ["zP"]\n[inputs]\nfile = "kick.csv"\n'
    run = cosim.run_scene(read_scene(write(text + "[run]\nstop_time = 0.1\n")))
    assert np.abs(run["zP"]).max() == 0


def test_bare_name_is_looked_up_among_the_shipped_scenes(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert find_scene("bar_theta.toml") in shipped_scenes()
    own = tmp_path / "bar_theta.toml"
    own.write_text("")
    assert find_scene("bar_theta.toml").resolve() == own


def test_unknown_scene_is_answered_with_the_nearest(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UnknownName, match=r"'bar_thta.toml'; did you mean bar_theta.toml"):
        read_scene("bar_thta.toml")


def test_missing_file_in_a_folder_is_named(tmp_path):
    with pytest.raises(UsageError, match=r"cannot read .*none.toml: No such file"):
        read_scene(tmp_path / "none.toml")


@pytest.mark.parametrize(
    ("old", "new", "error", "message"),
    [
        pytest.param("stop_time = 2", "stop_tme = 2", UnknownName,
                     r"line 16: \[run\] has no key 'stop_tme'; did you mean stop_time", id="key"),
        pytest.param('outputs = ["theta"', 'stop_time = 1\noutputs = ["theta"', UnknownName,
                     r"line 3: stop_time belongs under \[run\]", id="time"),
        pytest.param("[start]", "[strt]", UnknownName,
                     r"line 9: a scene has no key 'strt'; did you mean start", id="table"),
        pytest.param('labels = ["angle", "torque"]', 'label = ["x"]', UnknownName,
                     r"line 25: \[figures\] has no key 'label'; did you mean labels", id="figure"),
        pytest.param('"bar_on_frame/reduced"', '"bar_on_fram"', UnknownName,
                     r"line 2: .* no model 'bar_on_fram'; did you mean bar_on_frame", id="model"),
        pytest.param("bar_on_frame/reduced", "bar_on_frame/reducd", UnknownName,
                     r"line 2: .* no formulation 'reducd'; did you mean reduced", id="formulation"),
        pytest.param("bar_on_frame/reduced", "mine.py:build", UnknownName,
                     r"line 2: .*mine\.py is not a file", id="user model"),
        pytest.param("length = 0.5", "lenght = 0.5", UnknownName,
                     r"line 7: .* no parameter 'lenght'; did you mean length", id="parameter"),
        pytest.param("theta = ", "thta = ", UnknownName,
                     r"line 10: .* no state 'thta'; did you mean theta", id="state"),
        pytest.param("T2 =", "T3 =", UnknownName,
                     r"line 13: .* no input 'T3'; did you mean T2", id="input"),
        pytest.param("length = 0.5", "theta = 0.5", UsageError,
                     r"line 7: theta belongs under \[start\], not under \[parameters\]",
                     id="wrong table"),
        pytest.param("T2 =", "M_phi =", UsageError,
                     r"line 13: M_phi is a result of .* cannot be set", id="result as input"),
        pytest.param('"erk"', '"ekr"', UnknownName,
                     r"line 18: cosim has no solver 'ekr'; did you mean erk", id="solver"),
        pytest.param('["theta", "M_phi"]', '["theta", "M_ph"]', UnknownName,
                     r"line 3: .* no output 'M_ph'; did you mean M_phi", id="output"),
        pytest.param('["theta", "M_phi"]', '["theta", "frame_v1"]', UnknownName,
                     r"line 3: bar_on_frame/reduced does not compute 'frame_v1'; "
                     r"bar_on_frame/two_body does", id="output of another formulation"),
        pytest.param('["M_phi"]]', '["M_ph"]]', UnknownName,
                     r"line 24: .* no output 'M_ph'", id="variable of a figure"),
        pytest.param('["M_phi"]]', '["phi"]]', UsageError,
                     r"line 24: 'phi' is drawn but not computed; add it to outputs",
                     id="not computed"),
        pytest.param('[["theta"], ["M_phi"]]', '[["theta", "M_phi"]]', UsageError,
                     r"1 panels|line 25: 2 labels for 1 panels", id="labels"),
        pytest.param('[["theta"], ["M_phi"]]\nlabels = ["angle", "torque"]',
                     '[["theta", "M_phi"]]', UsageError,
                     r"line 24: theta \[rad\] and M_phi \[N.m\] share a panel", id="mixed units"),
        pytest.param('"torque"]', '"torque"]\nlegends = [["a", "b"], ["c"]]', UsageError,
                     r"line 26: 2 names for the 1 curves theta", id="legend"),
        pytest.param('title = "Angle"\n', "", UsageError,
                     r"line 22: the figure has no title", id="untitled"),
        pytest.param('["M_phi"]]', "[]]", UsageError,
                     r"line 24: a panel has no variable", id="empty panel"),
        pytest.param('["M_phi"]]', '"M_phi"]', ParameterError,
                     r"line 24: 'M_phi' does not fit; write a list of lists", id="flat panels"),
        pytest.param('["theta", "M_phi"]', "[]", UsageError,
                     r"line 3: no output is named", id="no output"),
        pytest.param('["theta", "M_phi"]', '["theta", "theta"]', UsageError,
                     r"line 3: 'theta' is named twice", id="output twice"),
        pytest.param('["theta", "M_phi"]', '"theta"', ParameterError,
                     r"line 3: 'theta' does not fit; write a list of texts", id="output as text"),
        pytest.param('"30 deg"', '"30 dge"', ParameterError,
                     r"line 10: theta = 30 dge: unit 'dge' is unknown", id="unit"),
        pytest.param('"30 deg"', '"30 lbf"', ParameterError,
                     r"line 10: .*'lbf' cannot be converted to 'rad'", id="kind of unit"),
        pytest.param('"30 deg"', '"30,5 deg"', ParameterError,
                     r"line 10: theta = 30,5 deg: write a decimal point", id="comma in a text"),
        pytest.param('"30 deg"', "30,5", UsageError, r"line 10, column 11: ", id="comma"),
        pytest.param('"30 deg"', "true", ParameterError,
                     r"line 10: .*True is not a real number", id="truth value"),
        pytest.param('"30 deg"', "[1, 2]", ParameterError,
                     r"line 10: .*\[1, 2\] is not a real number", id="list as number"),
        pytest.param('"30 deg"', "nan", ParameterError, r"line 10: .*nan is not finite", id="nan"),
        pytest.param("length = 0.5", "length = -0.5", ParameterError,
                     r"line 7: .*length = -0.5 m is out of its range", id="bounds"),
        pytest.param("length = 0.5", "length = 0.5\nlength = 0.6", UsageError,
                     r"line 8, column 13: Cannot overwrite a value", id="key twice"),
        pytest.param("[inputs]", "[start]", UsageError,
                     r"line 12, column 7: Cannot declare \('start',\) twice", id="table twice"),
        pytest.param("stop_time = 2", 'stop_time = "2 s"', ParameterError,
                     r"line 16: run: stop_time = '2 s' is not a real number", id="time as text"),
        pytest.param("output_interval = 0.02", "output_interval = 0", ParameterError,
                     r"line 17: .*output_interval = 0(\.0)? is not positive", id="interval"),
        pytest.param("stop_time = 2", "stop_time = 2\nstart_time = 3", ParameterError,
                     r"line 16: stop_time = 2 s lies before start_time = 3 s", id="backward"),
        pytest.param("= 1e-9", "= 1", ParameterError,
                     r"line 19: relative_tolerance = 1 is not within", id="tolerance"),
        pytest.param("= 1e-11", "= -1e-11", ParameterError,
                     r"line 20: absolute_tolerance = -1e-11 is negative", id="negative tolerance"),
        pytest.param("T2 = 0.01", 'file = "none.csv"', UsageError,
                     r"line 13: cannot read .*none\.csv", id="no such series"),
        pytest.param("T2 = 0.01", "file = 1", ParameterError,
                     r'line 13: 1 does not fit; write file = "TEXT"', id="file as number"),
        pytest.param('title = "Bar"', "title = 1", ParameterError,
                     r'line 1: 1 does not fit; write title = "TEXT"', id="title as number"),
        pytest.param("[[figures]]", "[figures]", UsageError,
                     r"line 22: write every figure as a table", id="one figure"),
        pytest.param('model = "bar_on_frame/reduced"\n', "", UsageError,
                     r"the model is missing; write model = ", id="no model"),
        pytest.param("[inputs]\nT2", "inputs", ParameterError,
                     r"line \d+: .* does not fit; write a table \[inputs\]", id="number as table"),
    ],
)  # fmt: skip
def test_invalid_scene_is_rejected_with_file_and_line(write, old, new, error, message):
    assert GOOD.count(old) >= 1
    text = GOOD.replace(old, new, 1)
    if new == "inputs":  # a key of the file itself has to stand before its tables
        text = "inputs = 1\n" + GOOD.replace("[inputs]\nT2 = 0.01\n", "")
    path = write(text)
    with pytest.raises(error, match=message) as caught:
        read_scene(path)
    assert str(caught.value).startswith(str(path))


TWO_FIGURES = GOOD + '\n[[figures]]\ntitle = "Torque"\npanels = [\n  ["theta"],\n  ["M_ph"],\n]\n'
LONG_LIST = GOOD.replace('[["theta"], ["M_phi"]]', '[\n  ["theta"],\n  ["M_phi"]\n]')


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        pytest.param(b"title = '\xff'", UsageError, r"scene\.toml is not a UTF-8 text", id="bytes"),
        pytest.param('model = "bicycle"\n[start]\ntheta = 0.1\n', InitialConditionError,
                     r"line 3: .*theta is calculated.*phi, delta", id="calculated start"),
        pytest.param('model = "double_pendulum"\n[start]\nq1_w = 0.0\n', InitialConditionError,
                     r"line 3: .*q1_w is calculated.*psi1_0", id="start by a parameter"),
        pytest.param('model = "bicycle"\n[parameters]\nIBxx = 30.0\n', ParameterError,
                     r"scene\.toml: .* principal moments", id="inertia that no body has"),
        pytest.param('model = "crank_shaft"\noutputs = [\n  "T",\n  "fx_A",\n  "fx_C",\n]\n',
                     UnknownName, r"line 5: .*'fx_C'; did you mean .*fx_A", id="in a long list"),
        pytest.param(LONG_LIST + "equl = true\n", UnknownName,
                     r"line 29: \[figures\] has no key 'equl'", id="after a long list"),
        pytest.param(TWO_FIGURES, UnknownName, r"line 31: .*'M_ph'", id="second figure"),
    ],
)  # fmt: skip
def test_wrong_scene_is_rejected_with_its_line(write, text, error, message):
    with pytest.raises(error, match=message):
        read_scene(write(text))


def test_input_that_is_constant_and_a_series_is_rejected(write):
    write("time,T2\n0,0\n1,1\n", "torque.csv")
    text = GOOD.replace("T2 = 0.01", 'T2 = 0.01\nfile = "torque.csv"')
    with pytest.raises(UsageError, match=r"line 13: T2 is also a column of torque\.csv"):
        read_scene(write(text))


def test_scene_from_python_rejects_what_a_file_must_not_contain():
    with pytest.raises(UnknownName, match="no state, parameter or input 'lenght'"):
        cosim.requested("bar_on_frame", start_values={"lenght": 1.0})


def test_other_formulation_retains_values_and_drops_an_unusable_solver(write):
    request = in_formulation(read_scene(write(GOOD)).request, "bar_on_frame/two_body")
    assert request.solver == Tolerance(1e-9, 1e-11)
    assert execute(request.reduced()).stats["solver"] == "idas"
    assert request.configured().variable("length").start == 0.5


def test_other_formulation_without_an_output_names_one_that_has_it():
    dae = cosim.load("double_pendulum/euler_313")
    request = cosim.requested(dae, outputs=["singularity_1"])
    with pytest.raises(UnknownName, match=r"quaternion does not compute 'singularity_1'"):
        in_formulation(request, "double_pendulum/quaternion")


def test_other_formulation_without_a_start_value_is_rejected():
    dae = cosim.load("bar_on_frame/two_body")
    request = cosim.requested(dae, start_values={"frame_v1": 0.0})
    with pytest.raises(UnknownName, match=r"reduced has no settable value 'frame_v1'"):
        in_formulation(request, "bar_on_frame/reduced")


def test_variant_is_a_backend_a_solver_or_a_formulation(write):
    request = read_scene(write(GOOD)).request
    assert variant(request, "fmu-me") == (request, "fmu-me")
    assert variant(request, "rk4")[0].solver.name == "rk4"
    assert variant(request, "two_body")[0].dae.full_name == "bar_on_frame/two_body"
    with pytest.raises(UnknownName, match=r"'twobody'; did you mean two_body"):
        variant(request, "twobody")


def test_tolerances_are_dropped_with_the_adaptive_solver():
    request = with_solver(read_scene("bicycle_model_1.toml").request, "ode8")
    assert request.tolerance is None


def test_step_size_is_dropped_with_the_fixed_step_solver():
    request = cosim.requested("crank_shaft", solver="ode8", step_size=0.1)
    assert with_solver(request, "rk4").solver.step_size == 0.1
    assert with_solver(request, "erk").solver.relative_tolerance == 1e-8


@pytest.mark.parametrize(
    ("page", "begin"), [("scenes.md", ""), ("figures.md", 'model = "bicycle"\n')]
)
def test_scene_in_the_documentation_is_valid(write, page, begin):
    text = (Path(__file__).parents[2] / "docs" / page).read_text(encoding="utf-8")
    block = text.partition("```toml\n")[2].partition("```")[0]
    assert read_scene(write(begin + block)).figures


def test_figures_may_be_those_of_another_scene(write):
    write(GOOD, "other.toml")
    head = 'model = "bar_on_frame/reduced"\nfigures = '
    assert read_scene(write(f'{head}"other.toml"')).figures == read_scene(write(GOOD)).figures
    shipped = read_scene(write(f'{head}"bar_theta.toml"')).figures
    assert shipped == read_scene("bar_theta.toml").figures != ()
    with pytest.raises(UnknownName, match=r"line 2.*no scene 'missing\.toml'"):
        read_scene(write(f'{head}"missing.toml"'))
    with pytest.raises(UsageError, match=r"write every figure as a table"):
        read_scene(write(f'{head}"scene.toml"'))


def test_settings_of_a_scene_have_the_names_of_the_keywords(write):
    request = read_scene(write('model = "crank_shaft"\n[run]\nmax_step = 0.1\n')).request
    assert run_settings(request) == {"relative_tolerance": 1e-8, "max_step": 0.1}
