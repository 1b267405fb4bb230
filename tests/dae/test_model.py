"""What `Model` accepts, and everything that it refuses by name."""

import math
from decimal import Decimal
from fractions import Fraction

import casadi as ca
import numpy as np
import pytest
from casadi import MX, SX

from casadi_models.dae import Experiment, Family, Model, Start, Variable

NOT_NUMBERS = [True, np.True_, "1", 1j, None, [1.0], {}, Decimal(1), SX(1), SX.sym("q"), ca.DM(1)]
NOT_NUMBERS += [np.array([1.0, 2.0]), 10**400]
NOT_EXPRESSIONS = [None, "x", 1j, {}, MX.sym("x"), [SX.sym("x"), 1]]
DECLARATIONS = ["state", "algebraic", "input", "parameter"]


@pytest.fixture
def model():
    return Model("spring", "free")


def refusal(reason):
    """Expect a refusal that begins with the model's name."""
    return pytest.raises(ValueError, match=f"^spring/free: {reason}")


# -- what a variable knows ------------------------------------------------------------------------


def test_variable_carries_everything_that_was_declared(model):
    facts = {"display_unit": "in", "nominal": 2, "minimum": -3, "maximum": np.float64(4)}
    model.derivative(model.state("x", "m", Fraction(1, 2), "stretch", **facts), 0)
    (x,) = model.freeze().states
    assert (x.name, x.unit, x.meaning, x.display_unit) == ("x", "m", "stretch", "in")
    assert (x.start, x.start_kind, x.nominal, x.minimum, x.maximum) == (0.5, Start.EXACT, 2, -3, 4)
    assert {type(v) for v in (x.start, x.nominal, x.minimum, x.maximum)} == {float}


def test_kind_of_the_start_follows_from_the_kind_of_the_variable(model):
    z = model.algebraic("z", "m", 1.0, "guessed")
    model.input("u", "m", 1.0, "given")
    model.parameter("p", "m", 1.0, "given")
    model.equation(z)
    model.output("y", "m", z, "follows")
    dae = model.freeze()
    kinds = {variable.name: variable.start_kind for variable in dae.variables}
    assert kinds == {"z": Start.GUESS, "u": Start.EXACT, "p": Start.EXACT, "y": Start.CALCULATED}
    assert dae.variable("y").start is None


def test_display_unit_of_the_model_yields_to_that_of_the_variable():
    model = Model("spring", display={"m": "in"})
    model.parameter("a", "m", 1.0, "shown as the model says")
    model.parameter("b", "m", 1.0, "shown as it says itself", display_unit="ft")
    model.parameter("c", "kg", 1.0, "shown in its own unit")
    assert [v.display_unit for v in model.freeze().parameters] == ["in", "ft", None]


def test_positive_parameter_is_bounded_away_from_zero(model):
    model.parameter("m", "kg", 2.0, "mass", positive=True)
    model.parameter("c", "1", 2.0, "own bound", positive=True, maximum=3.0)
    m, c = model.freeze().parameters
    assert (m.minimum, m.maximum, m.nominal) == (2e-12, 2e12, 2.0)
    assert (c.minimum, c.maximum) == (2e-12, 3.0)


@pytest.mark.parametrize(("value", "nominal"), [(-4.0, 4.0), (0.0, 1.0)])
def test_nominal_of_a_parameter_is_the_size_of_its_value(model, value, nominal):
    model.parameter("p", "m", value, "length")
    assert model.freeze().parameters[0].nominal == nominal


def test_energies_are_two_and_their_sum(model):
    x = model.state("x", "m", 1.0, "stretch")
    model.derivative(x, 0)
    model.energies(x, 2 * x, nominal=5.0)
    dae = model.freeze()
    assert [v.name for v in dae.output_variables] == [
        "kinetic_energy",
        "potential_energy",
        "energy",
    ]
    assert [v.nominal for v in dae.output_variables] == [5.0] * 3
    values = ca.Function("y", [dae.x], [dae.outputs])(7.0)
    assert np.array(values).ravel().tolist() == [7.0, 14.0, 21.0]


def test_symbol_that_the_user_overwrites_leaves_the_model_alone(model):
    x = model.state("x", "m", 1.0, "stretch")
    model.derivative(x, -x)
    x[0] = 3.0
    assert model.freeze().x.is_symbolic()


# -- refused declarations -------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["a-b", "", "2x", "a b", "x\n", "for/ever", 3, None, ["a"], "ö"])
def test_name_that_is_no_identifier_is_refused(model, name):
    with pytest.raises(ValueError, match="cannot name a model: use letters, digits and _"):
        Model(name)
    if name:  # an empty formulation is a system with only one
        with pytest.raises(ValueError, match="cannot name a model"):
            Model("spring", name)
    with refusal(r".* cannot name a variable: use letters, digits and _"):
        model.state(name, "m", 0.0, "stretch")


def test_time_cannot_name_a_variable(model):
    with refusal("'time' cannot name a variable"):
        model.input("time", "s", 0.0, "clock")


@pytest.mark.parametrize("declare", DECLARATIONS)
@pytest.mark.parametrize("value", NOT_NUMBERS, ids=repr)
def test_start_that_is_no_number_is_refused(model, declare, value):
    with refusal(r"x: (start|value) is (.*; give a number|too large for a float)"):
        getattr(model, declare)("x", "m", value, "stretch")


@pytest.mark.parametrize("declare", DECLARATIONS)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_start_that_is_not_finite_is_refused(model, declare, value):
    with refusal(f"x: start {value} is not finite; give a finite number"):
        getattr(model, declare)("x", "m", value, "stretch")


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan])
def test_positive_parameter_of_no_positive_value_is_refused(model, value):
    with refusal(f"m: value {value} is not positive, as declared"):
        model.parameter("m", "kg", value, "mass", positive=True)


@pytest.mark.parametrize("unit", ["furlong", "", None, 3, ["m"], SX.sym("m")], ids=repr)
def test_unit_that_does_not_exist_is_refused(model, unit):
    with refusal(r"x: unit .* is unknown; known are 1, s,"):
        model.state("x", unit, 0.0, "stretch")
    if unit is not None:
        with refusal(r"x: unit .* is unknown; known are 1, s,"):
            model.state("x", "m", 0.0, "stretch", display_unit=unit)


def test_display_unit_of_another_kind_is_refused(model):
    with refusal("x: 'm' cannot be converted to 'kg'"):
        model.state("x", "m", 0.0, "stretch", display_unit="kg")
    with pytest.raises(ValueError, match="spring: 'm' cannot be converted to 'kg'"):
        Model("spring", display={"m": "kg"})
    with pytest.raises(ValueError, match="spring: unit 'meter' is unknown"):
        Model("spring", display={"meter": "in"})


@pytest.mark.parametrize("meaning", ["", " ", None, 3])
def test_variable_without_meaning_is_refused(model, meaning):
    with refusal("x: the meaning is missing"):
        model.state("x", "m", 0.0, meaning)
    with refusal("y: the meaning is missing"):
        model.output("y", "m", 0.0, meaning)


@pytest.mark.parametrize("nominal", [0.0, -1.0, math.nan, math.inf])
def test_nominal_that_is_not_positive_is_refused(model, nominal):
    with refusal(f"x: nominal {nominal} is not a positive number"):
        model.state("x", "m", 0.0, "stretch", nominal=nominal)


@pytest.mark.parametrize("fact", ["nominal", "minimum", "maximum"])
@pytest.mark.parametrize("value", NOT_NUMBERS, ids=repr)
def test_fact_that_is_no_number_is_refused(model, fact, value):
    with refusal(f"x: {fact} is (.*; give a number|too large for a float)"):
        model.state("x", "m", 0.0, "stretch", **{fact: value})


@pytest.mark.parametrize(
    ("bounds", "reason"),
    [
        ({"minimum": 2.0, "maximum": 1.0}, r"bounds 2.0\.\.1.0 are empty"),
        ({"minimum": math.nan}, r"bounds nan\.\.inf are empty"),
        ({"maximum": math.nan}, r"bounds -inf\.\.nan are empty"),
        ({"minimum": 0.5}, r"start 0.0 is not within 0.5\.\.inf"),
        ({"maximum": -0.5}, r"start 0.0 is not within -inf\.\.-0.5"),
    ],
)
def test_bounds_that_contradict_are_refused(model, bounds, reason):
    with refusal(f"x: {reason}"):
        model.state("x", "m", 0.0, "stretch", **bounds)


@pytest.mark.parametrize("fact", ["bogus", "start_kind", "positive"])
def test_fact_that_no_variable_has_is_refused(model, fact):
    with refusal(f"x: '{fact}' is no fact of a variable; there are display_unit, nominal"):
        model.state("x", "m", 0.0, "stretch", **{fact: 1})


@pytest.mark.parametrize("first", DECLARATIONS)
@pytest.mark.parametrize("second", DECLARATIONS)
def test_name_declared_twice_is_refused(model, first, second):
    getattr(model, first)("x", "m", 0.0, "stretch")
    with refusal("'x' is declared twice; choose another name"):
        getattr(model, second)("x", "m", 0.0, "stretch")
    with refusal("'x' is declared twice"):
        model.output("x", "m", 0.0, "stretch")


@pytest.mark.parametrize("time", [0.0, -1.0, math.nan, math.inf])
def test_experiment_without_positive_times_is_refused(time):
    with pytest.raises(ValueError, match=f"spring: stop_time {time} s is not a positive time"):
        Model("spring", stop_time=time)
    with pytest.raises(ValueError, match=f"spring: output_interval {time} s is not a positive"):
        Model("spring", output_interval=time)
    with pytest.raises(ValueError, match="spring: stop_time is True; give a number"):
        Model("spring", stop_time=True)


# -- refused expressions --------------------------------------------------------------------------


@pytest.mark.parametrize("wrong", NOT_EXPRESSIONS, ids=repr)
def test_what_is_no_expression_is_refused_wherever_one_is_due(model, wrong):
    x = model.state("x", "m", 0.0, "stretch")
    with refusal(r"derivative of 'x' is .*; give an SX expression"):
        model.derivative(x, wrong)
    with refusal(r"column of states is .*; give an SX expression"):
        model.derivative(wrong, 1.0)
    with refusal(r"output 'y' is .*; give an SX expression"):
        model.output("y", "m", wrong, "stretch")
    with refusal(r"equation is .*; give an SX expression"):
        model.equation(wrong)
    with refusal(r"start \(law\) is .*; give an SX expression"):
        model.start(x, wrong, "law")
    with refusal(r"inertia of frame is .*; give an SX expression"):
        model.inertia("frame", wrong)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda m, x: m.when(x < 0, None), "when: values is None; give new values by state"),
        (lambda m, x: m.every(1.0, [x]), r"every: values is \[.*\]; give new values by state"),
        (lambda m, x: m.every(1.0, {x: 1}, offset="1"), "every: offset is '1'; give a number or"),
        (lambda m, x: m.every(1.0, {x: 1}, offset=10**400), "every cannot use period = 1.0, val"),
        (lambda m, x: m.when(x < 0, {x: 1}, name=SX.zeros(2, 2)), "when: name is .*; give a text"),
        (lambda m, x: m.state("v", "m", 0, "v", foreign_unit=x), r"state: foreign_unit is SX\(x\)"),
        (lambda m, x: m.state("v", "m", 0, "v", foreign_unit=x), r"state: foreign_unit is SX.x."),
        (lambda m, x: m.state(np.zeros(2), "m", 0, "v"), r"array\(.*\) cannot name a variable"),
        (lambda m, x: m.state("v", np.zeros((2, 2)), 0, "v"), r"v: unit array\(.*\) is unknown"),
        (lambda m, x: m.closing_rate("1"), "closing_rate is '1'; give a number"),
        (lambda m, x: m.name_modes(x, real=x), r"name_modes: real is SX\(x\); give a list"),
        (lambda m, x: m.start_through(x, {}), "start_through: output is {}; give a text"),
        (lambda m, x: m.rod("r", "ab", 1.0), "end of 'r' is 'a'; give an SX expression"),
        (lambda m, x: m.rod("r", (), 1.0), r"rod cannot use name = 'r', ends = \(\), radius"),
        (lambda m, x: m.shape("s", [], 1.0), r"shape: kind is \[\]; give a text"),
        (lambda m, x: m.named(None), "named: name is None; give a text"),
        (lambda m, x: m.world(up=1), "world: up is 1; give a list"),
        (lambda m, x: m.world(follow=x), r"follow is SX\(x\); give the name of a body"),
        (lambda m, x: m.smooth(np.zeros((2, 2))), r"smooth expression has shape \(2, 2\)"),
        (lambda m, x: m.inertia("a\nb", 1.0), "inertia of a b has shape"),
    ],
)  # fmt: skip
def test_argument_of_a_type_that_cannot_be_is_refused(model, call, said):
    x = model.state("x", "m", 0.0, "stretch")
    with refusal(said) as caught:
        call(model, x)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400 or "known are" in str(caught.value)


@pytest.mark.parametrize(
    ("keywords", "said"),
    [
        ({"display": ["m"]}, r"display is \['m'\]; give units by SI unit"),
        ({"formulation": SX.zeros(2, 2)}, "cannot name a model"),
        ({"formulation": 0}, "0 cannot name a model"),
    ],
)
def test_model_of_arguments_that_cannot_be_is_refused(keywords, said):
    with pytest.raises(ValueError, match=said):
        Model("spring", **keywords)


def test_expression_of_the_wrong_shape_is_refused(model):
    x, v = model.state("x", "m", 0.0, "stretch"), model.state("v", "m/s", 0.0, "rate")
    both = ca.vertcat(x, v)
    with refusal(r"derivative of 'x', 'v' has shape \(1, 1\); give shape \(2, 1\)"):
        model.derivative(both, 1.0)
    with refusal(r"derivative of 'x' has shape \(2, 1\); give shape \(1, 1\)"):
        model.derivative(x, both)
    with refusal(r"column of states has shape \(1, 2\); give shape \(n, 1\)"):
        model.derivative(both.T, both.T)
    with refusal(r"output 'y' has shape \(2, 1\); give shape \(1, 1\)"):
        model.output("y", "m", both, "stretch")
    with refusal(r"equation has shape \(1, 2\); give shape \(n, 1\)"):
        model.equation(both.T)
    with refusal(r"start \(law\) has shape \(1, 1\); give shape \(2, 1\)"):
        model.start(both, 1.0, "law")
    with refusal(r"inertia of frame has shape \(2, 1\); give a 3x3 matrix"):
        model.inertia("frame", both)


def test_refused_output_may_be_declared_again(model):
    with refusal("output 'y' is None"):
        model.output("y", "m", None, "stretch")
    model.output("y", "m", 1.0, "stretch")
    assert [v.name for v in model.freeze().output_variables] == ["y"]


def test_derivative_of_what_is_no_state_is_refused(model):
    x = model.state("x", "m", 0.0, "stretch")
    p = model.parameter("p", "m", 0.0, "length")
    for other in (x + 1, p, SX.sym("x"), SX(1), model.t):
        with refusal(r"'.*' is not a state of this model; declare it with state\(\)"):
            model.derivative(other, 0.0)
        with refusal(r"'.*' is not a state of this model"):
            model.start(other, 0.0, "law")


def test_second_derivative_of_a_state_is_refused(model):
    x = model.state("x", "m", 0.0, "stretch")
    model.derivative(x, 1.0)
    with refusal("state 'x' has two derivatives; give it one"):
        model.derivative(x, 1.0)


def test_variable_with_a_contradictory_start_is_refused():
    with pytest.raises(ValueError, match=r"x: start 1\.0 is given, but calculated"):
        Variable("x", "m", "stretch", 1.0, Start.CALCULATED)
    with pytest.raises(ValueError, match="x: start is None; give a number"):
        Variable("x", "m", "stretch")
    with pytest.raises(ValueError, match="x: start_kind 'exact' is not a Start"):
        Variable("x", "m", "stretch", 1.0, "exact")


def test_family_gives_every_formulation_what_they_share():
    family = Family("swing", "child's swing", "a test", {"rad": "deg"}, 3.0, 0.1, 1e-11)
    for name in ("angle", "place"):
        model = family.formulation(name, f"by its {name}")
        theta = model.state("theta", "rad", 0.0, "angle", own_meaning=f"of the {name}")
        model.derivative(theta, 1)
        dae = model.freeze()
        assert dae.full_name == f"swing/{name}"
        assert dae.description == f"child's swing: by its {name}"
        assert dae.source == "a test"
        assert dae.experiment == Experiment(3.0, 0.1, 1e-11)
        assert dae.states[0].display_unit == "deg"
        assert dae.own_meanings == {"theta": f"of the {name}"}


@pytest.mark.parametrize("tolerance", [0.0, -1e-9, math.nan, math.inf, "1e-9"])
def test_reference_tolerance_is_a_positive_number(tolerance):
    with pytest.raises(ValueError, match="reference_tolerance"):
        Experiment(1.0, reference_tolerance=tolerance)
