"""Values of all types are those of the file, and those that were set; runs stay within bounds."""

from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.fmu_files import set_attributes, with_description
from helpers.small_models import ball
from helpers.typed_part import typed_part
from helpers.wrapped import wrapped

import cosim
from cosim.fmi.check.check import examine
from cosim.fmi.check.finding import ADVICE, WRONG
from cosim.fmi.check.isolated import try_apart
from cosim.fmi.check.trials.derivatives import Known, derivatives
from cosim.fmi.check.trials.derivatives import _adjoint as adjoint
from cosim.fmi.check.trials.derivatives import _by_several as by_several
from cosim.fmi.check.trials.derivatives import _compared as compared
from cosim.fmi.check.trials.start import initialization, reset, rollback, start
from cosim.fmi.check.trials.steps import _remembered as remembered
from cosim.fmi.check.trials.steps import calls, exchange, steps
from cosim.fmi.check.trials.switching import switching
from cosim.fmi.check.trials.values import _set_in_a_run as set_in_a_run
from cosim.fmi.check.trials.values import bounds, defaults, settings

VARIABLE = "ModelVariables/ScalarVariable[@name='{}']"
IN_CO_SIMULATION = {"fmi2Instantiate": "limit = kind == fmi2CoSimulation; return CALL;"}
ALL = "for (size_t i = 0; i < n; i++)"


def found(path, *trials):
    answer = try_apart(path, timeout=60, trials=(start, *trials))
    return {(f.level, f.rule, f.place) for f in answer.findings}


def oscillator():
    """x'' = force - k x from x = 1 at rest."""
    model = cosim.Model("oscillator", stop_time=2.0)
    x, v = model.state("x", "m", 1.0, "place"), model.state("v", "m/s", 0.0, "speed")
    k = model.parameter("k", "1/s2", 4.0, "stiffness")
    force = model.input("force", "m/s2", 0.0, "force")
    model.derivative(x, v)
    model.derivative(v, force - k * x)
    model.output("energy", "m2/s2", k * x**2 / 2 + v**2 / 2, "energy")
    model.limit(3 - x, "x stays below 3")
    return model.freeze()


def brief():
    """x' = 1 until x is 0.9."""
    model = cosim.Model("brief", stop_time=2.0)
    x = model.state("x", "1", 0.0, "x")
    model.derivative(x, 1.0)
    model.output("y", "1", 2 * x, "twice")
    model.stop(x > 0.9, "it is over")
    return model.freeze()


@pytest.mark.parametrize(
    ("fmi", "others"), [(2, {"on_in", "label_in"}), (3, {"on_in", "label_in", "level_in", "n"})]
)
def test_values_of_all_types_are_kept_and_those_that_begin_otherwise_are_found(
    fmi, others, tmp_path
):
    path = typed_part(tmp_path, fmi)  # it begins with false, "" and 0, against its file
    assert found(path, settings) == set()
    assert found(path, defaults) == {(WRONG, "defaults", name) for name in others}


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize(
    ("fault", "names"),
    [
        (("TYPE(Int64, int64_t, self->mode,", "TYPE(Int64, int64_t, self->mode + 1,"), {"mode_in"}),
        (("truth(self, which[i]), self->on)", "!truth(self, which[i]), self->on)"), {"on_in"}),
        (("int32_t, self->count,", "int32_t, self->count / 2 * 2 + 1,"), {"count_in"}),
        (("char label[64]", "char label[12]"), {"label_in"}),
        (("memcpy(sets ? place", "if (sets && own == 4) for (int k = 0; k < 4; ++k) "
          "place[k] = values[done + 3 - k]; else memcpy(sets ? place"),
         {f"A[{i},{k}]" for i in (1, 2) for k in (1, 2)}),
    ],
    ids=["enumeration", "Boolean", "integer", "text", "array"],
)  # fmt: skip
def test_value_that_is_not_what_was_set_is_found(fault, names, tmp_path):
    reported = found(typed_part(tmp_path, 3, fault), settings)
    assert {rule for _, rule, _ in reported} == {"settings"}
    assert {place for _, _, place in reported} == names


ANSWER = "    *event = *ends = *early = false;"
RESETS = "API void *fmi3InstantiateCoSimulation(void)"
RESET = "API int fmi3Reset(Instance *self) {\n    return start(self), 0;\n}\n"


def test_array_that_a_reset_or_a_stored_state_leaves_is_found(tmp_path):
    """Its outputs are arrays, and numbers of other types."""
    assert found(typed_part(tmp_path), reset) == {(WRONG, "reset", "CoSimulation")}
    sound = typed_part(tmp_path, 3, (RESETS, RESET + RESETS))
    assert found(sound, reset, rollback) == set()
    ignored = (
        "    return memcpy(c, state, sizeof(Instance)), 0;",
        "    return (void)c, (void)state, 0;",
    )
    places = found(typed_part(tmp_path, 3, ignored), rollback)  # before: nothing was compared
    assert places == {(WRONG, "rollback", "CoSimulation")}


def test_array_that_is_not_finite_is_found(tmp_path):
    begin = "    *self = (Instance){.n = FMI == 3 ? 2 : 1, .count = 1, .mode = 1};"
    late = begin.replace("};", "};\n    self->x[1] = 0.0 / 0.0;")
    places = {("start", "ModelExchange"), ("start", "CoSimulation")}
    assert {one[1:] for one in found(typed_part(tmp_path, 3, (begin, late)))} == places
    late = ANSWER.replace(
        "    *event", "    if (time > 0.5) ((Instance *)c)->x[1] = 0.0 / 0.0;\n    *event"
    )
    path = typed_part(tmp_path, 3, (ANSWER, late))
    (fault,) = found(path, steps)  # before: none
    assert fault == (WRONG, "steps", "CoSimulation")
    stops = set_attributes("DefaultExperiment", stopTime="0.3")
    assert found(with_description(path, tmp_path / "stops.fmu", stops), steps) == set()


def test_state_and_parameter_that_cannot_be_set_are_found(tmp_path):
    ignored = (
        f"int s = 0; {ALL} if (vr[i] != REF(x)) s |= inner_fmi2SetReal(c, vr + i, 1, value + i); "
        "return (fmi2Status)s;"
    )
    path = wrapped(tmp_path, {}, oscillator(), fmi2SetReal=ignored)
    assert found(path, settings) == {(WRONG, "settings", "x")}


def test_tunable_parameter_that_a_run_rejects_is_found(tmp_path):
    path = cosim.export_fmu(oscillator(), tmp_path / "a.fmu", tunable=[])
    assert found(path, settings) == set()
    edit = set_attributes(VARIABLE.format("k"), variability="tunable")
    path = with_description(path, tmp_path / "b.fmu", edit)
    assert found(path, settings) == {(WRONG, "settings", "k")}


def test_parameter_that_is_ignored_after_a_reset_is_found(tmp_path):
    bodies = {
        "fmi2Instantiate": "limit = 0; return CALL;",
        "fmi2Reset": "limit = 1; return CALL;",
        "fmi2SetReal": f"{ALL} if (limit && vr[i] == REF(k)) return fmi2OK; return CALL;",
    }
    reported = found(wrapped(tmp_path, {}, oscillator(), **bodies), reset)
    assert reported == {(WRONG, "reset", "ModelExchange"), (WRONG, "reset", "CoSimulation")}


def test_run_that_leaves_the_bounds_of_an_output_is_advice(tmp_path):
    own = cosim.export_fmu(oscillator(), tmp_path / "a.fmu")
    for most, rules in (("1.001", set()), ("0.9", {(ADVICE, "bounds", "x")})):
        edit = set_attributes(VARIABLE.format("x") + "/Real", min="-1.001", max=most, start="0.5")
        path = with_description(own, tmp_path / f"{most}.fmu", edit)
        assert found(path, bounds) == rules  # x is cos(2 t)


def test_nominal_value_of_the_library_is_that_of_the_file(tmp_path):
    own = cosim.export_fmu(oscillator(), tmp_path / "a.fmu")
    assert found(own, exchange) == set()
    edit = set_attributes(VARIABLE.format("x") + "/Real", nominal="1e6")
    path = with_description(own, tmp_path / "b.fmu", edit)
    assert found(path, exchange) == {(ADVICE, "exchange", "x")}


def test_outputs_of_both_interfaces_begin_alike(tmp_path):
    body = (
        "fmi2Status s = CALL; fmi2ValueReference r = REF(time); double now; "
        "inner_fmi2GetReal(c, &r, 1, &now); "
        f"if (limit && now == 0) {ALL} if (vr[i] == REF(energy)) value[i] *= 1.5; return s;"
    )
    path = wrapped(tmp_path, {}, oscillator(), fmi2GetReal=body, **IN_CO_SIMULATION)
    assert (WRONG, "initialization", "energy") in found(path, initialization)


@pytest.mark.slow
def test_boolean_output_that_is_inverted_in_co_simulation_is_found(tmp_path):
    body = f"fmi2Status s = CALL; if (limit) {ALL} value[i] = !value[i]; return s;"
    options = {"valid": True}
    path = wrapped(tmp_path, options, oscillator(), fmi2GetBoolean=body, **IN_CO_SIMULATION)
    assert found(path, switching) == {(WRONG, "switching", "valid")}


@pytest.mark.slow
def test_end_of_a_run_that_model_exchange_does_not_report_is_found(tmp_path):
    bodies = {
        "fmi2NewDiscreteStates": "fmi2Status s = CALL; info->terminateSimulation = fmi2False; "
        "return s;",
        "fmi2CompletedIntegratorStep": "fmi2Status s = CALL; *terminate = fmi2False; return s;",
    }
    assert found(wrapped(tmp_path, {}, brief()), switching) == set()
    path = wrapped(tmp_path, {}, brief(), **bodies)
    assert found(path, switching) == {(WRONG, "switching", "CoSimulation")}


@pytest.mark.parametrize(
    "change", ["if (*early) *last += 1e-3", "if (*event) *event = *early = fmi3False"]
)
def test_wrong_answer_of_a_step_that_ends_at_an_event_is_found(change, tmp_path):
    body = f"fmi3Status s = CALL; {change}; return s;"
    path = wrapped(tmp_path, {"fmi": 3}, ball(), fmi3DoStep=body)
    assert found(path, switching) == {(WRONG, "switching", "CoSimulation")}


def test_declared_updates_that_no_step_makes_are_advice(tmp_path):
    silent = {"providesIntermediateUpdate": "true"}
    own = typed_part(tmp_path)
    path = with_description(own, tmp_path / "b.fmu", set_attributes("CoSimulation", **silent))
    without = found(own, calls)
    assert found(path, calls) - without == {(ADVICE, "calls", "fmi3IntermediateUpdateCallback")}


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["dop853", "rk4", "erk", "rosenbrock"])
def test_own_files_declare_updates_if_their_solver_makes_them(solver, tmp_path):
    model = cosim.Model("decay", stop_time=1.0)
    x = model.state("x", "1", 1.0, "x")
    model.derivative(x, -x)
    model.output("y", "1", x, "y")
    path = cosim.export_fmu(model.freeze(), tmp_path / "own.fmu", fmi=3, solver=solver)
    assert [*examine(path)] == []
    assert found(path, calls) == set()


@pytest.mark.slow
def test_directional_derivative_to_a_parameter_that_is_wrong_is_found(tmp_path):
    options, function = {"fmi": 3, "tunable": ["k"]}, "fmi3GetDirectionalDerivative"
    assert found(wrapped(tmp_path, options, oscillator()), derivatives) == set()
    wrong = "if (knowns[0] == REF(k)) for (size_t i = 0; i < m; i++) value[i] *= 1.1"
    body = {function: f"fmi3Status s = CALL; {wrong}; return s;"}
    path = wrapped(tmp_path, options, oscillator(), **body)
    assert {f[:2] for f in found(path, derivatives)} == {(WRONG, "derivatives")}


def test_display_unit_whose_factor_is_not_that_of_its_name_is_found(tmp_path, exported):
    own = exported("crank_shaft")
    edit = set_attributes("UnitDefinitions/Unit[@name='rad']/DisplayUnit", factor="60")
    path = with_description(own, tmp_path / "a.fmu", edit)
    assert {(f.level, f.rule) for f in {*examine(path)} - {*examine(own)}} == {(WRONG, "unit")}


class Square:
    """A session of y = u^2 at u = 2, whose directional derivative is a given number."""

    def __init__(self, slope):
        self.slope, self.u = slope, 2.0
        self.bench = SimpleNamespace(second=True)

    def values(self, _variables):
        return np.array([self.u**2])

    def put(self, _variable, value):
        self.u = value

    def slopes(self, _unknowns, _known):
        return np.array([self.slope])


@pytest.mark.parametrize(("slope", "found"), [(4.0, 0), (5.0, 1), (np.nan, 1)])
def test_a_derivative_that_is_not_finite_differs_from_one_that_is(slope, found):
    u, y = (SimpleNamespace(name=n, reference=n, nominal=1.0) for n in "uy")
    known = [Known(u, None, required=True)]
    assert len([*compared(Square(slope), [y], known, np.array([2.0]))]) == found


def test_output_that_is_no_number_hides_no_violated_bound(tmp_path):
    body = (
        "fmi2Status s = CALL; fmi2ValueReference r = REF(time); double now; "
        f"inner_fmi2GetReal(c, &r, 1, &now); {ALL} "
        "if (vr[i] == REF(energy) && now > 1.9) value[i] = NAN; return s;"
    )
    own = wrapped(tmp_path, {}, oscillator(), fmi2GetReal=body)
    edit = set_attributes(VARIABLE.format("energy") + "/Real", max="1")
    path = with_description(own, tmp_path / "b.fmu", edit)
    assert found(path, bounds) == {(ADVICE, "bounds", "energy")}  # it is 2


@pytest.mark.parametrize("compare", [by_several, adjoint])
def test_a_sum_of_derivatives_that_is_not_finite_differs_from_one_that_is(compare):
    """The first of two is NaN, the second wrong; then the derivatives by one are NaN instead."""
    instance = SimpleNamespace(
        getDirectionalDerivative=lambda *_: [np.nan, 1e9],
        getAdjointDerivative=lambda *_: np.array([np.nan, 1e9]),
    )
    session = SimpleNamespace(instance=instance)
    first, second = (SimpleNamespace(name=n, reference=n, nominal=1.0) for n in (0, 1))
    knowns = [Known(one, None, required=True) for one in (first, second)]
    forward = np.array([[1.0, 2.0], [3.0, 4.0]])
    for expected in (2, 1):
        assert len([*compare(session, [first, second], knowns, forward)]) == expected
        forward[0, 0] = np.nan


@pytest.mark.parametrize(("near", "far", "found"), [(1, 1, 0), (np.nan, 1, 1), (np.nan, np.nan, 0)])
def test_a_variable_that_is_no_number_after_one_time_only_remembers_it(near, far, found):
    times = list[float]()
    session = SimpleNamespace(
        bench=SimpleNamespace(step_size=lambda _: 0.1, start=0.0),
        kind="ModelExchange",
        next_event=np.inf,
        instance=SimpleNamespace(setTime=times.append),
        values=lambda _: np.array([near if len(times) < 3 else far]),
    )
    variable = SimpleNamespace(name="y", nominal=1.0)
    assert len([*remembered(session, [variable])]) == found


@pytest.mark.parametrize(("after", "found"), [(2.0, 0), (3.0, 1), (np.nan, 1)])
def test_a_parameter_that_is_no_number_after_it_is_set_is_found(after, found):
    """It is 2 and set to more in a run; a number that stays what it is set to is right."""
    kept = [2.0]

    def put(_, value):
        kept[0] = value if after == 2.0 or value == 2.0 else after

    session = SimpleNamespace(values=lambda _: kept, put=put)
    parameter = SimpleNamespace(name="p", nominal=1.0, texts={})
    bench = SimpleNamespace(reals=lambda *_: [parameter], started=lambda _: nullcontext(session))
    assert len([*set_in_a_run(bench, "CoSimulation")]) == found
