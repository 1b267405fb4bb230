"""What `freeze` checks of the whole, and what the frozen `Dae` promises."""

import dataclasses
import math

import casadi as ca
import numpy as np
import pytest
from casadi import SX

from casadi_models.dae import Dae, Model, Start
from casadi_models.dae.variational import variational


def oscillator(name="oscillator"):
    """Declare x' = v, v' = -k x with a reaction z = k x."""
    model = Model(name)
    x = model.state("x", "m", 1.0, "stretch")
    v = model.state("v", "m/s", 0.5, "rate")
    k = model.parameter("k", "1", 4.0, "stiffness over mass")
    z = model.algebraic("z", "m/s2", 0.0, "restoring acceleration")
    u = model.input("u", "m/s2", 0.0, "push")
    model.derivative(ca.vertcat(x, v), ca.vertcat(v, u - z))
    model.equation(z - k * x)
    model.output("twice", "m", 2 * x, "twice the stretch")
    return model, x, v, k, z, u


def refusal(reason, name="oscillator"):
    return pytest.raises(ValueError, match=f"^{name}: {reason}")


# -- completeness ---------------------------------------------------------------------------------


def test_state_without_derivative_is_refused():
    model, *_ = oscillator()
    model.state("a", "m", 0.0, "forgotten")
    model.state("b", "m", 0.0, "forgotten")
    with refusal("no derivative for state 'a', 'b'; call derivative"):
        model.freeze()


def test_number_of_equations_must_be_that_of_the_unknowns():
    model, x, *_ = oscillator()
    model.equation(x)
    with refusal("2 equations for 1 algebraic unknowns; give each unknown one equation"):
        model.freeze()
    model = Model("oscillator")
    model.algebraic("z", "m", 0.0, "forgotten")
    with refusal("0 equations for 1 algebraic unknowns"):
        model.freeze()


@pytest.mark.parametrize("equations", ["none", "twice the same"])
def test_equations_that_leave_an_unknown_undetermined_are_refused(equations):
    model = Model("pendulum")
    x = model.state("x", "m", 0.0, "place")
    force, other = (model.algebraic(name, "N", 0.0, "force") for name in ("a", "b"))
    model.derivative(x, force + other)
    if equations == "none":  # constraints of the place: index 3
        model.equation(ca.vertcat(x - 1, x + other))
    else:
        model.equation(ca.vertcat(force - 1, force - x))
    with refusal("the algebraic equations do not determine every algebraic unknown", "pendulum"):
        model.freeze()


def test_unknowns_in_any_order_of_equations_are_accepted():
    model = Model("loop")
    a, b, c = (model.algebraic(name, "1", 0.0, "unknown") for name in "abc")
    model.equation(ca.vertcat(b + c, a - 1, c * b - a))
    assert model.freeze().alg.shape == (3, 1)


@pytest.mark.parametrize("place", ["derivative", "equation", "output"])
def test_undeclared_symbol_is_rejected_with_its_name_and_place(place):
    model, x, *_ = oscillator()
    stranger = SX.sym("x")  # the same name, but another symbol
    if place == "derivative":
        model.derivative(model.state("w", "m", 0.0, "w"), x + stranger)
        where = "derivative of 'w'"
    elif place == "equation":
        model.equation(model.algebraic("w", "m", 0.0, "w") + stranger)
        where = "equation 2"
    else:
        model.output("w", "m", stranger, "w")
        where = "output 'w'"
    with refusal(f"{where} uses 'x'; only declared symbols and finite numbers may stand there"):
        model.freeze()


@pytest.mark.parametrize("constant", [math.nan, math.inf, -math.inf])
def test_constant_that_is_not_finite_is_refused_by_place(constant):
    model, x, *_ = oscillator()
    model.output("w", "m", constant * x, "w")
    with refusal(f"output 'w' holds the constant {constant}; only declared symbols and finite"):
        model.freeze()


@pytest.mark.parametrize("outside", ["state", "stranger"])
def test_inertia_may_hold_parameters_only(outside):
    model, x, *_ = oscillator()
    model.inertia("frame", SX.eye(3) * (x if outside == "state" else SX.sym("x")))
    with refusal("inertia of frame uses 'x'; only parameters and finite numbers may"):
        model.freeze()


# -- start rules ----------------------------------------------------------------------------------


def test_calculated_start_keeps_its_guess_and_its_law():
    model, x, v, k, *_ = oscillator()
    model.start_equation(x, x**2 - k, "balance")
    model.start(v, 2 * x, "rolling")
    dae = model.freeze()
    assert [s.start_kind for s in dae.states] == [Start.CALCULATED, Start.CALCULATED]
    assert [s.start for s in dae.states] == [None, None]
    assert dae.x_start == (1.0, 0.5)  # where an implicit rule begins
    assert [(r.states, r.implicit, r.meaning) for r in dae.start_rules] == [
        ((0,), True, "balance"),
        ((1,), False, "rolling"),
    ]
    law = ca.Function("law", [dae.x, dae.p], [rule.expression for rule in dae.start_rules])
    assert [float(value) for value in law([3.0, 0.0], 4.0)] == [5.0, 6.0]


def test_implicit_rule_of_two_states_may_use_both():
    model, x, v, k, *_ = oscillator()
    model.start_equation(ca.vertcat(v, x), ca.vertcat(x + v, x - k), "both")
    (rule,) = model.freeze().start_rules
    assert rule.states == (1, 0)  # in the order given


def test_state_without_rule_keeps_its_exact_start():
    model, x, v, *_ = oscillator()
    model.start(v, x, "law")
    x_, v_ = model.freeze().states
    assert (x_.start, x_.start_kind) == (1.0, Start.EXACT)
    assert (v_.start, v_.start_kind) == (None, Start.CALCULATED)


def test_rule_that_needs_a_later_one_is_refused():
    model, x, v, *_ = oscillator()
    model.start(v, 2 * x, "rolling")
    model.start_equation(x, x**2 - 4, "balance")
    with refusal(r"start \(rolling\) needs 'x', which no rule before it settles"):
        model.freeze()


def test_implicit_rule_that_needs_a_later_one_is_refused():
    model, x, v, *_ = oscillator()
    model.start_equation(v, v - 2 * x, "rolling")
    model.start(x, 3.0, "balance")
    with refusal(r"start \(rolling\) needs 'x', which no rule before it settles"):
        model.freeze()


def test_explicit_rule_that_needs_itself_is_refused():
    model, x, *_ = oscillator()
    model.start(x, x + 1, "circle")
    with refusal(r"start \(circle\) needs 'x', which no rule before it settles"):
        model.freeze()


def test_two_explicit_rules_in_a_circle_are_refused():
    model, x, v, *_ = oscillator()
    model.start(x, v, "one")
    model.start(v, x, "other")
    with refusal(r"start \(one\) needs 'v'"):
        model.freeze()


@pytest.mark.parametrize("same_rule", [True, False])
def test_start_calculated_twice_is_refused(same_rule):
    model, x, *_ = oscillator()
    if same_rule:
        model.start(ca.vertcat(x, x), ca.vertcat(1.0, 2.0), "law")
    else:
        model.start(x, 1.0, "law")
        model.start(x, 2.0, "other law")
    with refusal(r"the start of 'x'.* is calculated twice; keep one rule"):
        model.freeze()


@pytest.mark.parametrize("outside", ["z", "stranger"])
def test_rule_may_not_use_what_is_unknown_where_a_run_begins(outside):
    model, x, _, _, z, _ = oscillator()
    model.start(x, {"z": z, "stranger": SX.sym("stranger")}[outside], "law")
    allowed = "time, states, inputs and parameters"
    with refusal(rf"start \(law\) uses '{outside}'; only {allowed} and finite"):
        model.freeze()


def test_start_given_through_an_output_cannot_be_solved_beside_rules_of_time_or_inputs():
    model, x, v, _, _, u = oscillator()
    model.start(x, u, "law")
    model.output("both", "m/s", 2 * v + x, "rate and place")
    model.start_through(v, "both")
    with refusal(r"start \(law\), solved with 'both', uses 'u'; only states and parameters"):
        model.freeze()


def test_rule_with_a_constant_that_is_not_finite_is_refused():
    model, x, *_ = oscillator()
    model.start(x, math.nan, "law")
    with refusal(r"start \(law\) holds the constant nan"):
        model.freeze()


@pytest.mark.parametrize("kind", ["independent of the state", "twice the same"])
def test_implicit_rule_that_does_not_determine_its_states_is_refused(kind):
    model, x, v, k, *_ = oscillator()
    if kind == "twice the same":
        model.start_equation(ca.vertcat(x, v), ca.vertcat(x - 1, x - k), "law")
    else:
        model.start_equation(x, k - v, "law")
    with refusal(r"start \(law\) does not determine each of 'x'"):
        model.freeze()


# -- the frozen result ----------------------------------------------------------------------------


def test_dae_holds_columns_in_the_order_of_declaration():
    dae = oscillator()[0].freeze()
    assert [column.shape for column in (dae.x, dae.ode)] == [(2, 1)] * 2
    rest = (dae.t, dae.z, dae.u, dae.p, dae.alg, dae.outputs)
    assert [column.shape for column in rest] == [(1, 1)] * 6
    assert [v.name for v in dae.variables] == ["x", "v", "z", "twice", "u", "k"]
    assert dae.observed == ("x", "v", "z", "twice")
    f = ca.Function("f", [dae.t, dae.x, dae.z, dae.u, dae.p], [dae.ode, dae.alg, dae.outputs])
    ode, alg, y = f(0.0, [2.0, 3.0], 5.0, 7.0, 11.0)
    assert np.array(ode).ravel().tolist() == [3.0, 2.0]
    assert (float(alg), float(y)) == (-17.0, 4.0)


def test_dae_without_algebraics_inputs_and_parameters_has_empty_columns():
    model = Model("drift")
    model.derivative(model.state("x", "m", 0.0, "place"), model.t)
    dae = model.freeze()
    assert {column.shape for column in (dae.z, dae.u, dae.p, dae.alg, dae.outputs)} == {(0, 1)}
    assert dae.operations() == 0


@pytest.mark.parametrize("field", [field.name for field in dataclasses.fields(Dae)])
def test_field_of_a_dae_cannot_be_assigned(field):
    dae = oscillator()[0].freeze()
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(dae, field, None)


def test_variables_rules_and_experiment_are_frozen():
    model, x, *_ = oscillator()
    model.start(x, 1.0, "law")
    dae = model.freeze()
    for value in (dae.states[0], dae.start_rules[0], dae.experiment):
        assert dataclasses.is_dataclass(value)
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(value, dataclasses.fields(value)[0].name, None)


def test_declaring_more_does_not_change_what_was_frozen():
    model, x, *_ = oscillator()
    dae = model.freeze()
    names, count = [v.name for v in dae.variables], dae.operations()
    model.output("more", "m", x, "later")
    model.start(x, 1.0, "later")
    assert ([v.name for v in dae.variables], dae.operations()) == (names, count)
    assert dae.start_rules == ()
    assert len(model.freeze().start_rules) == 1


def test_daes_compare_and_hash_by_identity():
    dae, other = oscillator()[0].freeze(), oscillator()[0].freeze()
    assert dae != other
    assert len({dae, other, dae}) == 2


def test_replaced_dae_whose_columns_do_not_match_is_refused():
    dae = oscillator()[0].freeze()
    for changes, what in (
        ({"x": dae.x[0]}, "2 states, but columns of shape (1, 1), (2, 1), (2, 1)"),
        ({"ode": dae.ode.T}, "2 states, but columns of shape (2, 1), (1, 2), (2, 1)"),
        ({"x_start": (1.0,)}, "2 states, but columns of shape (2, 1), (2, 1), (1, 1)"),
        ({"alg": SX(0, 1)}, "1 algebraics, but columns of shape (1, 1), (0, 1)"),
        ({"u": SX(0, 1)}, "1 inputs, but columns of shape (0, 1)"),
        ({"parameters": ()}, "0 parameters, but columns of shape (1, 1)"),
        ({"outputs": SX(0, 1)}, "1 output_variables, but columns of shape (0, 1)"),
    ):
        with pytest.raises(ValueError, match=r"^oscillator: ") as refused:
            dataclasses.replace(dae, **changes)
        assert str(refused.value) == f"oscillator: {what}"


def test_variable_is_found_by_name_or_missed_by_name():
    dae = oscillator()[0].freeze()
    assert dae.variable("k").meaning == "stiffness over mass"
    with pytest.raises(KeyError, match="no variable 'kk'; did you mean k"):
        dae.variable("kk")
    with pytest.raises(KeyError, match="no variable '3'"):
        dae.variable(3)


@pytest.mark.parametrize(("formulation", "full"), [("", "spring"), ("free", "spring/free")])
def test_full_name_is_what_the_command_line_takes(formulation, full):
    assert Model("spring", formulation).freeze().full_name == full


def test_operations_count_shared_terms_once_and_parameters_as_numbers():
    model = Model("shared")
    x, y = model.state("x", "m", 1.0, "x"), model.state("y", "m", 1.0, "y")
    p = model.parameter("p", "1", 2.0, "p")
    z = model.algebraic("z", "m", 0.0, "z")
    model.derivative(x, ca.sin(x * y) + p**3)  # x y; sin; + 8
    model.derivative(y, ca.sin(x * y) - z)  # -
    model.equation(z - x * y)  # -
    model.output("free", "m", ca.cos(x), "an output costs the equations nothing")
    assert model.freeze().operations() == 5


def test_derivatives_of_variables_in_foreign_units_have_these_units():
    model = Model("shop")
    stock = model.state("stock", "widget", 1.0, "stock", foreign_unit=True)
    model.derivative(stock, -stock)
    both = variational(model.freeze())
    assert [(v.unit, v.foreign_unit) for v in both.states] == 2 * [("widget", True)]


@pytest.mark.parametrize(
    ("condition", "text"),
    [
        (lambda x: x - 1 > -0.5, "when (-0.5<(x-1))"),
        (lambda x: (x - 5.03) - (-0.003) > 0, "when (0<((x-5.03)+0.003))"),
        (lambda x: x + (-2) > 0, "when (0<(x-2))"),
    ],
)
def test_event_without_a_name_is_named_by_its_condition_with_joined_signs(condition, text):
    model = Model("m", stop_time=1.0)
    x = model.state("x", "1", 0.0, "x")
    model.derivative(x, 1.0)
    model.when(condition(x), {x: 0.0})
    assert [event.name for event in model.freeze().events] == [text]
