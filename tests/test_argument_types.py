"""Python calls with arguments of the wrong type: a `CosimError` in one line, never numpy's own."""

import inspect
import io
import pickle
from contextlib import suppress
from functools import partial
from time import perf_counter

import numpy as np
import pytest
from helpers.refusals import refusal, short
from helpers.small_models import decay

import cosim
from cosim.errors import (
    _ELSEWHERE,
    CosimError,
    ParameterError,
    UnknownName,
    UsageError,
    naming_arguments,
)
from cosim.model.inputs import InputSeries
from cosim.text import readable

DAE = decay()
RAMP = InputSeries(("force",), [0.0, 1.0], [[0.0], [1.0]])
RUN = cosim.simulate(DAE, stop_time=0.1, compiled=False)
NO_MODEL = ["decay", None, 3, RUN, type(DAE)]
NO_RUN = ["run.csv", None, 3, DAE, np.ones(3)]
NO_NAMES = ["x", 3, True, np.array(1.0), object(), [], {}]
NO_MAPPING = ["x", 3, ["x"], [("x", 1.0)], np.ones(2)]
NO_NUMBER = ["1", True, 1j, [1.0], np.ones(3), np.ones(1), np.array(1.0), {}, object()]
NOT_FINITE = [float("nan"), float("inf"), -float("inf"), np.float64("nan"), 10**400]


@pytest.mark.parametrize("wrong", NO_MODEL, ids=short)
@pytest.mark.parametrize(
    "call",
    [
        cosim.simulate,
        cosim.start_vectors,
        lambda dae: cosim.integrator(dae, [0, 1]),
        lambda dae: cosim.reduce(dae, ["x"]),
        cosim.requested,
        lambda dae: cosim.export_fmu(dae, "wrong.fmu"),
    ],
    ids=["simulate", "start_vectors", "integrator", "reduce", "requested", "export_fmu"],
)
def test_what_is_no_model_is_refused_with_how_to_get_one(call, wrong):
    if isinstance(wrong, str):
        assert "no model 'decay'" in refusal(UnknownName, lambda: call(wrong))  # it takes names
        return
    told = refusal(UsageError, lambda: call(wrong))
    assert type(wrong).__name__ in told
    assert told.endswith("a Dae, as cosim.load or cosim.from_casadi returns")


@pytest.mark.parametrize("wrong", NO_RUN, ids=short)
def test_what_is_no_run_is_neither_compared_nor_drawn(wrong):
    for pair in ((RUN, wrong), (wrong, RUN)):
        assert "compare was given" in refusal(UsageError, lambda pair=pair: cosim.compare(*pair))
    assert "draw_figures was given" in refusal(UsageError, lambda: cosim.draw_figures([], wrong))


@pytest.mark.parametrize("wrong", [None, 3, RUN, DAE], ids=short)
@pytest.mark.parametrize(
    ("call", "name"),
    [
        (cosim.run_scene, "run_scene"),
        (cosim.read_scene, "read_scene"),
        (cosim.simulate_fmu, "an FMU's reader"),
        (lambda wrong: next(cosim.crosscheck([wrong])), "crosscheck"),
        (RUN.to_csv, "to_csv"),
        (lambda wrong: cosim.export_fmu(DAE, wrong), "export_fmu"),
        (lambda wrong: cosim.tradeoff(wrong), "tradeoff"),
    ],
    ids=["run_scene", "read_scene", "simulate_fmu", "crosscheck", "to_csv", "export", "tradeoff"],
)
def test_what_is_no_file_and_no_scene_is_refused(call, name, wrong):
    assert refusal(UsageError, lambda: call(wrong)).startswith(f"{name} was given ")


@pytest.mark.parametrize("wrong", NO_NUMBER, ids=short)
@pytest.mark.parametrize("setting", ["start_time", "relative_tolerance", "output_interval"])
def test_what_is_no_number_is_refused_in_a_call(setting, wrong):
    told = refusal(ParameterError, lambda: cosim.simulate(DAE, **{setting: wrong}))
    assert f"{setting} = " in told


@pytest.mark.parametrize("wrong", [*NO_NUMBER, *NOT_FINITE], ids=short)
@pytest.mark.parametrize("setting", ["start_time", "stop_time", "output_interval", "step_size"])
def test_what_is_no_finite_number_is_rejected_in_a_request(setting, wrong):
    solver = {"solver": "rk4"} if setting == "step_size" else {}
    told = refusal(ParameterError, lambda: cosim.requested(DAE, **{setting: wrong}, **solver))
    assert f"{setting} = " in told


@pytest.mark.parametrize("wrong", NO_NAMES, ids=short)
def test_what_is_no_list_of_names_is_refused(wrong):
    def export(dae, outputs):
        cosim.export_fmu(dae, "x.fmu", outputs=outputs)

    for call in (cosim.simulate, cosim.reduce, export):
        told = refusal(UsageError, lambda call=call: call(DAE, outputs=wrong))
        assert told.startswith("decay: outputs was given ")
        assert told.endswith("; give a list of names")


@pytest.mark.parametrize(
    "names", [("x",), {"x"}, np.array(["x"]), (n for n in "x")], ids=lambda value: repr(value)[:20]
)
def test_any_list_of_names_will_do(names):
    run = cosim.simulate(DAE, stop_time=0.1, outputs=names, compiled=False)
    assert run.names == ("x",)


@pytest.mark.parametrize("wrong", NO_MAPPING, ids=short)
def test_values_that_have_no_names_are_refused(wrong):
    told = refusal(UsageError, lambda: cosim.simulate(DAE, start_values=wrong))
    assert "give values by name" in told


@pytest.mark.parametrize(
    "wrong",
    [None, True, np.ones(2), np.ones(1), 1j, [1.0]],
    ids=lambda value: repr(value)[:20],
)
def test_value_of_a_variable_must_be_a_number(wrong):
    assert "decay: x [m] = " in refusal(
        ParameterError, lambda: cosim.simulate(DAE, start_values={"x": wrong})
    )


@pytest.mark.parametrize(
    "wrong",
    ["", "CVODE", 3, ["cvodes"], {}, np.array("cvodes")],
    ids=lambda value: repr(value)[:20],
)
def test_what_is_no_solver_is_refused(wrong):
    for call in (cosim.simulate, lambda dae, solver: cosim.integrator(dae, [0, 1], solver=solver)):
        told = refusal(UnknownName, lambda call=call: call(DAE, solver=wrong))
        assert "cosim has no solver" in told


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"inputs": "force.csv"}, "inputs was given 'force.csv'"),
        ({"inputs": {"forse": 1.0}}, "decay has no input 'forse'; did you mean force?"),
        ({"inputs": {"force": object()}}, "force = <object object"),
        ({"inputs": {"force": [1.0, 2.0]}}, "force has samples of shape (2,); the run has 101 "),
        ({"inputs": {"force": "sin(q)"}}, "'sin(q)' has no name 'q'"),
        ({"inputs": {"force": "sin("}}, "'sin(' is no formula"),
        ({"inputs": {"force": "5 rad"}}, "'rad' cannot be converted to"),
        ({"start_values": {"x": "one"}}, "x: 'one' is not a number with a unit"),
        ({"start_values": {"x": "1deg"}}, "'deg' cannot be converted to 'm'"),
        ({"inputs": {"force": 1.0}, "start_values": {"force": 2}}, "force is given twice"),
        ({"inputs": {"force": "t"}, "start_values": {"force": 2}}, "force is given twice"),
        ({"inputs": RAMP, "start_values": {"force": 2}}, "force is given twice"),
        ({"stop_when": "x > "}, "stop_when: 'x > ' is no formula"),
        ({"stop_when": "x > 3 m"}, "units without a blank, as in 3deg"),
        ({"stop_when": "x"}, "'x' is no condition; compare two values"),
        ({"stop_when": "x + (x > 1) > 2"}, "'x > 1' in 'x + (x > 1) > 2' is no number; write"),
        ({"stop_when": 3}, "3 is no formula"),
        (
            {"stop_when": "x > 1", "stop_time": 0.0},
            "needs two or more output times, but 0 s is the only one",
        ),
        ({"stop_when": "x > 0"}, "stop_when 'x > 0' is true at the start already"),
        ({"stop_when": "q > 0"}, "no name 'q'"),
        ({"stop_when": "x < 0.5", "accuracy": 1e-3}, "stop_when needs a solver"),
        ({"output_times": [1, 2], "stop_time": 3}, "output_times already sets all output times"),
        ({"output_times": [2, 1]}, "output_times: time 2 (1 s) is not after the one before it"),
        ({"output_times": "soon"}, "output_times was given 'soon'"),
        ({"compiled": "no"}, "compiled was given 'no', of type str; give True, False or None"),
        ({"compiled": np.ones(2)}, "compiled was given array"),
        ({"on_invalid": np.ones(2)}, "to an invalid state '[1. 1.]'"),
        ({"on_invalid": "sometimes"}, "to an invalid state 'sometimes'"),
    ],
    ids=short,
)
def test_other_arguments_of_a_run_are_checked_too(arguments, told):
    assert told in refusal(CosimError, lambda: cosim.simulate(DAE, **arguments))


@pytest.mark.parametrize("wrong", ["rate", 3, True], ids=short)
def test_what_is_no_list_of_parameters_is_not_frozen(wrong):
    told = refusal(UsageError, lambda: cosim.reduce(DAE, ["x"], freeze=wrong))
    assert told.startswith("decay: freeze was given ")


@pytest.mark.parametrize(
    "wrong", ["x", None, 3, [], [0.0], [0, np.nan], [[0, 1]], ["a", "b"], [0, 1j]], ids=repr
)
def test_grid_of_an_integrator_must_be_times(wrong):
    assert refusal(ParameterError, lambda: cosim.integrator(DAE, wrong)).startswith("grid: ")


@pytest.mark.parametrize(
    "version", [2.0, "2", "3.0", None, True, 4], ids=lambda value: repr(value)[:20]
)
def test_version_of_fmi_is_2_or_3(version, tmp_path):
    told = refusal(UnknownName, lambda: cosim.export_fmu(DAE, tmp_path / "a.fmu", fmi=version))
    assert f"cosim has no FMI version '{version}'" in told


@pytest.mark.parametrize("platforms", ["native", "win64"])
def test_platforms_are_a_list(platforms, tmp_path):
    told = refusal(
        UsageError, lambda: cosim.export_fmu(DAE, tmp_path / "a.fmu", platforms=platforms)
    )
    assert told.endswith("give a list of platforms")


@pytest.mark.parametrize("wrong", ["4", 4.5, 0, True], ids=short)
def test_number_of_threads_is_a_positive_whole_number(wrong):
    call = partial(cosim.simulate_many, DAE, {"x": [1.0, 2.0]}, threads=wrong)
    assert "threads" in refusal(UsageError, call)


def test_plot_of_nothing_is_rejected():
    assert "at least one variable" in refusal(UsageError, lambda: RUN.plot(()))


def test_message_on_an_endless_name_is_short():
    assert refusal(UnknownName, lambda: cosim.simulate(DAE, outputs=["y" * 100_000]))


@pytest.mark.parametrize("length", [300, 100_000])
@pytest.mark.parametrize("text", ["a", "b ", "3 ft ", "'"], ids=repr)
def test_message_on_an_endless_value_is_short(text, length):
    for value in (text * length, [text] * length):
        with pytest.raises(ParameterError, match="x") as caught:
            cosim.simulate(DAE, start_values={"x": value})
        assert len(str(caught.value)) < 700  # which names the value twice


@pytest.mark.parametrize("text", ["[ ", "' ", "] ", "a' ", "[' "], ids=repr)
def test_long_message_is_shortened_in_linear_time(text):
    began = perf_counter()
    assert len(readable(text * 200_000)) < 6100
    assert perf_counter() - began < 5  # measured 0.1 s; 100 s if every bracket were followed


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (
            lambda: cosim.couple({"a": DAE}, [1]),
            "couple: connections was given [1], of type list; give val",
        ),
        (lambda: cosim.grid(3), "grid: axes was given 3, of type int; give values by name"),
        (
            lambda: cosim.read_ssp(3),
            "read_ssp: path was given 3, of type int; give a text or a path",
        ),
        (lambda: cosim.write_ssp("x", 3, []), "write_ssp: components was given 3"),
        (lambda: cosim.animate(3), "give a Trajectory or a list or a Dae"),
        (
            lambda: cosim.design("sobol", "2", {"x": (0, 1)}),
            "design: runs was given '2', of type str",
        ),
        (lambda: cosim.sensitivity(DAE, start_values=3), "sensitivity: start_values was given 3"),
        (lambda: cosim.export_fmu(DAE, "x.fmu", platforms=3), "give a list of texts"),
        (
            lambda: RUN.plot(3),
            "Trajectory.select: names was given 3, of type int; give a text or",
        ),
        (lambda: RUN.to_mat(3), "Trajectory.to_mat: target was given 3"),
    ],
    ids=lambda value: value[:20] if isinstance(value, str) else "",
)
def test_argument_that_does_not_fit_its_annotation_is_named(call, told):
    assert told in refusal(UsageError, call)


def test_exceptions_of_calls_whose_arguments_fit_are_left_alone():
    def fails(run):
        raise ZeroDivisionError("own")

    with pytest.raises(ZeroDivisionError, match="own"):
        naming_arguments(lambda run: fails(run))(RUN)


# -- keywords of other tools ---------------------------------------------------------------------

FUNCTIONS = {
    name: value
    for name in cosim.__all__
    if callable(value := getattr(cosim, name)) and not isinstance(value, type)
} | {"System.simulate": cosim.System.simulate}
FOREIGN = ("parameters", "params", "rtol", "t_end", "tspan", "stoptime", "frobnicate")


@pytest.mark.parametrize("keyword", FOREIGN)
@pytest.mark.parametrize("name", FUNCTIONS)
def test_unknown_keyword_is_answered_with_one_that_exists(name, keyword):
    function = FUNCTIONS[name]
    own = inspect.signature(function).parameters
    if keyword in own:
        return
    with pytest.raises(TypeError) as caught:
        function(**{keyword: 1})
    problem, _, remedy = str(caught.value).partition("; ")
    assert problem == f"{name.rpartition('.')[2]}() got an unexpected keyword argument '{keyword}'"
    if "frobnicate" in problem or "did you mean" not in remedy:
        assert remedy.startswith("it has " + next(iter(own), "none"))


@pytest.mark.parametrize(
    ("name", "keyword", "meant"),
    [
        ("simulate", "rtol", "relative_tolerance"),
        ("simulate", "parameters", "start_values"),
        ("simulate_many", "t_end", "stop_time"),
        ("sweep", "tspan", "stop_time"),
        ("linearize", "params", "start_values"),
        ("linearize", "rtol", "relative_tolerance"),
        ("integrator", "tspan", "grid"),
        ("integrator", "atol", "absolute_tolerance"),
        ("compare", "rtol", "bound"),
        ("export_fmu", "rtol", "tolerance"),
        ("export_fmu", "method", "solver"),
        ("from_sympy", "params", "parameters"),
        ("from_casadi", "params", "start_values"),
        ("sensitivity", "stoptime", "stop_time"),
        ("sensitivity", "t_eval", "output_times"),
        ("simulate_fmu", "parameters", "start_values"),
        ("couple", "stoptime", "stop_time"),
        ("System.simulate", "params", "start_values"),
        ("System.simulate", "stoptime", "stop_time"),
        ("animate", "lables", "labels"),
    ],
)
def test_keyword_of_another_tool_is_translated(name, keyword, meant):
    with pytest.raises(TypeError, match=f"'{keyword}'; did you mean {meant}[?]$"):
        FUNCTIONS[name](**{keyword: 1})


def test_table_of_foreign_keywords_leads_to_own_ones():
    for own, foreign in _ELSEWHERE.items():
        for keyword in foreign.split():
            answers = []
            for function in FUNCTIONS.values():
                with suppress(CosimError):  # of functions that have this keyword
                    try:
                        function(**{keyword: None})
                    except TypeError as error:
                        answers.append(str(error))
            assert any(f"'{keyword}'; did you mean {own}?" in told for told in answers)


@pytest.mark.parametrize("name", [name for name in FUNCTIONS if "." not in name])
def test_public_function_can_be_sent_to_other_processes(name):
    assert pickle.loads(pickle.dumps(FUNCTIONS[name])) is FUNCTIONS[name]
    assert FUNCTIONS[name].__doc__


def test_too_many_arguments_are_answered_by_python():
    with pytest.raises(TypeError, match=r"simulate\(\) takes .* were given"):
        cosim.simulate("bicycle", 1.0)


def test_a_file_that_cannot_be_written_is_no_argument_of_a_wrong_type():
    class Full(io.StringIO):
        def write(self, text):
            raise BrokenPipeError(text[:4])

    run = cosim.simulate("crank_shaft", stop_time=1)
    with pytest.raises(BrokenPipeError):  # before: UsageError, give a TextIO
        run.to_csv(Full())
