"""What users may give for a number, and how everything else is refused."""

import math
import re
import warnings

import casadi as ca
import numpy as np
import pytest

import casadi_models
import cosim
from casadi_models.dae import Model, Start
from cosim.errors import InitialConditionError, ParameterError, UnknownName, UsageError
from cosim.model.catalogue import loaded
from cosim.model.values import assign, number


@pytest.fixture(scope="module")
def crank():
    return loaded("crank_shaft")


@pytest.fixture(scope="module")
def bicycle():
    return loaded("bicycle")


# -- numbers --------------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [1, 1.5, np.float32(0.5), np.int64(3)])
def test_real_numbers_of_every_kind_are_taken(value):
    assert number("run", "n", value) == float(value)
    assert isinstance(number("run", "n", value), float)


@pytest.mark.parametrize(
    "value", [True, np.True_, "1", None, 1j, [1.0], np.array([1.0]), np.array(1.0), ca.DM(1)]
)
def test_what_is_no_real_number_is_refused(value):
    with pytest.raises(ParameterError, match=r"run: n = .* is not a real number; give a float"):
        number("run", "n", value)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 10**400, np.float64("nan")])
def test_what_is_not_finite_is_refused(value):
    with pytest.raises(ParameterError, match="is not finite; give a finite number"):
        number("run", "n", value)


@pytest.mark.parametrize("value", [0, -1, -5e-324])
def test_what_must_be_positive_is_refused_otherwise(value):
    with pytest.raises(ParameterError, match="is not positive; give a positive number"):
        number("run", "n", value, positive=True)


# -- a model's numbers ----------------------------------------------------------------------------

POSITIVE = [
    (name, parameter.name)
    for name in casadi_models.CATALOG
    for parameter in loaded(name).parameters
    if parameter.unit in ("kg", "m", "kg.m2", "kg/m3") and parameter.minimum > 0
]


def test_numbers_go_to_their_places(crank):
    values = assign(crank, {"omega": 3, "alpha": -1.0})
    names = [v.name for v in crank.parameters]
    assert values.x.tolist() == [0.0, 3.0]
    assert values.p[names.index("alpha")] == -1.0
    assert values.p[names.index("diameter")] == 0.5 * 0.0254
    bar = loaded("bar_on_frame")
    assert assign(bar, {"T2": 0.5}).u.tolist() == [0.5]


def test_overrides_of_the_caller_stay_as_they_are(crank):
    given = {"omega": 3}
    assign(crank, given)
    assert given == {"omega": 3}
    assert type(given["omega"]) is int


@pytest.mark.quick_share(0.3)
@pytest.mark.parametrize(
    "value", [0, -0.1, 5e-324, 1e308, math.nan, math.inf, -math.inf, True, "2"]
)
@pytest.mark.parametrize(
    ("model", "name"),
    [
        ("crank_shaft", "segment_length"),
        ("crank_shaft", "density"),
        ("bar_on_frame", "m"),
        ("bicycle", "mB"),
        ("bicycle", "rF"),
        ("bicycle", "ICzz"),
        ("disk_two_bars", "bar_mass"),
        ("double_pendulum", "m"),
    ],
)
def test_mass_length_and_inertia_outside_their_range_are_refused(model, name, value):
    with pytest.raises(ParameterError, match=rf"{model}/\w+: {name}"):
        assign(loaded(model), {name: value})


def test_every_mass_length_and_inertia_is_bounded_that_must_be_positive():
    assert len(POSITIVE) > 60
    for name in casadi_models.CATALOG:
        for parameter in loaded(name).parameters:
            mass_like = parameter.unit in ("kg", "kg/m3") or "radius" in parameter.name
            if mass_like:
                assert parameter.minimum > 0, (name, parameter.name)


@pytest.mark.parametrize(("name", "value"), [("b", 0.0), ("Omega_dot", 0.0)])
def test_zero_is_taken_where_the_model_allows_it(name, value):
    assign(loaded("bar_on_frame"), {name: value})


@pytest.mark.parametrize(
    ("given", "moments"),
    [
        ({"IBxx": 9.2, "IByy": 11.0, "IBzz": 1e-3, "IBxz": 2.4}, "-0.58"),  # not positive
        ({"IBxx": 50.0}, "50.1"),  # more than the sum of the two others
    ],
)
def test_inertia_that_no_body_has_is_refused_with_its_principal_moments(bicycle, given, moments):
    with pytest.raises(ParameterError, match=rf"rear frame has principal moments .*{moments}"):
        assign(bicycle, given)


@pytest.mark.parametrize(
    "given",
    [
        lambda z: cosim.simulate_many("crank_shaft", {"omega": z}, stop_time=1.0),
        lambda z: cosim.sweep("crank_shaft", {"omega": z}, workers=0),
        lambda z: cosim.sweep("crank_shaft", {"omega": z}, design="grid", workers=0),
        lambda z: cosim.open("crank_shaft", copies=2, start_values={"omega": z}),
        lambda z: cosim.simulate("bar_on_frame", inputs={"T2": z}, stop_time=1, output_interval=1),
        lambda z: cosim.simulate("crank_shaft", output_times=z),
        lambda z: cosim.simulate("crank_shaft", stop_time=1.0).at(z),
        lambda z: cosim.InputSeries(("T2",), np.arange(2.0), z[:, None]),
    ],
)
def test_complex_numbers_are_refused_in_arrays_as_elsewhere(given):
    with pytest.raises((ParameterError, UsageError)):
        given(np.array([0.0, 1.0 + 1.0j]))  # before: their real parts were taken


def test_rod_without_thickness_is_a_body(bicycle):
    assign(bicycle, {"ICxx": 0.06, "ICyy": 0.06, "ICzz": 1e-9, "ICxz": 0.0})


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("omgea", r"did you mean omega\? \(all: cosim info crank_shaft/driven\)"),
        ("Alpha", "did you mean alpha"),
        ("zzzz", "it has phi, omega, segment_length"),
        (3, "it has phi, omega"),
        ("fx_A", "'fx_A' is a result of the model and cannot be set"),
    ],
)
def test_unknown_name_is_refused_with_near_names_and_the_command_that_lists_all(crank, name, hint):
    with pytest.raises(UnknownName, match=hint):
        assign(crank, {name: 1.0})


def test_calculated_start_is_refused_with_what_it_follows_from(bicycle):
    with pytest.raises(InitialConditionError) as caught:
        assign(bicycle, {"theta": 0.1})
    message = str(caught.value)
    assert "the start of theta is calculated (pitch: the front wheel touches the ground)" in message
    assert "set some of phi, delta, w, c, lambda, rR, rF instead" in message


@pytest.mark.parametrize(("unit", "shown"), [("m", " m"), ("1", "")])
def test_state_outside_its_bounds_is_refused(unit, shown):
    model = Model("bounded")
    x = model.state("x", unit, 0.5, "x", minimum=0.0, maximum=1.0)
    model.derivative(x, 0)
    dae = model.freeze()
    assert assign(dae, {"x": 1.0}).x.tolist() == [1.0]
    words = f"x = 1.5{shown} is out of its range 0 ... 1{shown}; give"
    with pytest.raises(ParameterError, match=re.escape(words)):
        assign(dae, {"x": 1.5})


@pytest.mark.parametrize(
    ("model", "name", "value"),
    [("bicycle", "phi", 30.0), ("bar_on_frame", "theta", -60.0), ("crank_shaft", "phi", 1e4)],
)
def test_angle_of_the_size_of_degrees_is_doubted_and_taken(model, name, value):
    dae = loaded(model)
    with pytest.warns(UserWarning, match=rf"{name} = .* rad is more than two turns; write .*deg"):
        values = assign(dae, {name: value})
    assert value in values.x


@pytest.mark.parametrize(
    ("model", "name", "value"),
    [("bicycle", "phi", 1.0), ("bicycle", "thetaR", 500.0), ("bicycle", "phi_dot", 50.0)],
)
def test_angle_of_a_wheel_and_rates_are_not_doubted(model, name, value):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assign(loaded(model), {name: value})


@pytest.mark.parametrize("name", casadi_models.CATALOG)
def test_defaults_of_every_model_are_accepted(name):
    dae = loaded(name)
    values = assign(dae)
    assert values.x.tolist() == list(dae.x_start)
    assert values.p.tolist() == [v.start for v in dae.parameters]
    assert all(v.start_kind is Start.EXACT for v in dae.parameters)
