"""DaeBuilder models of every feature: right on both roads, or refused by name.

The ones that are marked are examples of CasADi's own documentation (class DaeBuilder), with numbers
where those leave them out.
"""

import math
from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest

import cosim
from cosim.errors import CosimError, UsageError

ACCEPTED: dict[str, tuple[Callable[[], ca.DaeBuilder], dict[str, float]]] = {}
REFUSED: dict[str, tuple[Callable[[], ca.DaeBuilder], str]] = {}
E1 = math.exp(-1)


def accepted(**at_1):
    """Note a builder and exact values at t = 1."""

    def note(builder):
        ACCEPTED[builder.__name__] = builder, at_1
        return builder

    return note


def refused(reason: str):
    def note(builder):
        REFUSED[builder.__name__] = builder, reason
        return builder

    return note


def decay(name: str = "m", start: float = 1.0):
    """Return a builder with x' = -x not yet given."""
    dae = ca.DaeBuilder(name)
    return dae, dae.add("x", {"start": start})


@accepted(h=-4.405, v=-8.81)
def rocket():  # CasADi's class documentation; drag and burning off: closed form
    dae = ca.DaeBuilder("rocket")
    a = dae.add("a", "parameter", "tunable")
    u = dae.add("u", "input", {"start": 1})
    h = dae.add("h", {"start": 0})
    v = dae.add("v", {"start": 0, "unit": "m/s"})
    m = dae.add("m", {"start": 1})
    dae.eq(dae.der(h), v)
    dae.eq(dae.der(v), (u - a * v**2) / m - 9.81)
    dae.eq(dae.der(m), 0 * u)
    return dae


@accepted(m=0.0)
def rocket_that_burns():  # the same: m' = -u^2
    dae = ca.DaeBuilder("rocket")
    u, m = dae.add("u", "input", {"start": 1}), dae.add("m", {"start": 1})
    dae.eq(dae.der(m), -(u**2))
    return dae


@accepted(x=E1**0.5, z=E1**0.5 / 2)
def algebraic():  # CasADi, `inputs`: 0 = x - 2 z
    dae, x = decay()
    z, u = dae.add("z"), dae.add("u", "input", {"start": 1})
    dae.eq(dae.der(x), -x + z * u)
    dae.eq(0, x - 2 * z)
    return dae


@accepted(x=2 * math.atan(math.tan(0.5) * E1), w=math.sin(2 * math.atan(math.tan(0.5) * E1)))
def dependent():  # CasADi, `w`
    dae, x = decay()
    w = dae.add("w")
    dae.eq(w, ca.sin(x))
    dae.eq(dae.der(x), -w)
    return dae


@accepted(x=6 * E1)
def calculated_start():  # CasADi, `init_lhs`: set_init
    dae, x = decay()
    p = dae.add("p", "parameter", "tunable", {"start": 3})
    dae.eq(dae.der(x), -x)
    dae.set_init("x", 2 * p)
    return dae


@accepted(x=math.exp(-2))
def fixed_input():  # CasADi, `set_variability`
    dae, x = decay()
    u = dae.add("u", "input", {"start": 2})
    dae.eq(dae.der(x), -u * x)
    dae.set_variability("u", "fixed")
    return dae


@accepted(x=math.exp(-2))
def tunable_input():  # CasADi, `set_variability`
    dae, x = decay()
    u = dae.add("u", "input", {"start": 2})
    dae.eq(dae.der(x), -u * x)
    dae.set_variability("u", "tunable")
    return dae


@accepted(x=1 + 1 - math.cos(1))
def time():  # CasADi, `time`
    dae, x = decay()
    t = dae.add("t", "independent")
    dae.eq(dae.der(x), ca.sin(t))
    return dae


@accepted(x=2 - math.cos(1))
def time_by_its_name():
    dae, x = decay()
    dae.eq(dae.der(x), ca.sin(dae.add("time", "independent")))
    return dae


@accepted(x=math.exp(-6))
def fixed_and_integer_parameters():
    dae, x = decay()
    k = dae.add("k", "parameter", "fixed", {"start": 2})
    n = dae.add("n", "parameter", "fixed", {"type": "Int32", "start": 3})
    dae.eq(dae.der(x), -k * n * x)
    return dae


@accepted(x=E1)
def boolean_parameter():
    dae, x = decay()
    on = dae.add("on", "parameter", "fixed", {"type": "Boolean", "start": 1})
    dae.eq(dae.der(x), -on * x)
    return dae


@accepted(x=math.exp(-2))
def constant():
    dae, x = decay()
    k = dae.add("k", "local", "constant")
    dae.set_start("k", 2.0)
    dae.eq(dae.der(x), -k * x)
    return dae


@accepted(x=math.exp(-2), k=2.0)
def constant_output():
    dae, x = decay()
    k = dae.add("k", "output", "constant", {"start": 2})
    dae.eq(dae.der(x), -k * x)
    return dae


@accepted(x=E1, q=1 - E1)
def quadrature():
    dae, x = decay()
    q = dae.add("q")
    dae.eq(dae.der(x), -x)
    dae.eq(dae.der(q), x)
    dae.set_category("q", "q")
    return dae


@accepted(x=E1, y=2 * E1)
def output():
    dae, x = decay()
    y = dae.add("y", "output")
    dae.eq(dae.der(x), -x)
    dae.eq(y, 2 * x)
    return dae


@accepted(x=E1)
def state_as_output():
    dae = ca.DaeBuilder("m")
    x = dae.add("x", "output", {"start": 1})
    dae.eq(dae.der(x), -x)
    return dae


@accepted(x=math.exp(-3), w=2 * math.exp(-3), v=3 * math.exp(-3), y=6 * math.exp(-3))
def chain_of_definitions():
    dae, x = decay()
    w, v, y = dae.add("w"), dae.add("v"), dae.add("y", "output")
    dae.eq(w, 2 * x)
    dae.eq(v, w + x)
    dae.eq(y, 2 * v)
    dae.eq(dae.der(x), -v)
    return dae


@accepted(x=math.exp(-3), v=3 * math.exp(-3))
def definitions_in_any_order():
    dae, x = decay()
    w, v = dae.add("w"), dae.add("v")
    dae.eq(v, w + x)
    dae.eq(w, 2 * x)
    dae.eq(dae.der(x), -v)
    return dae


@accepted(body_x=math.cos(1), v_1=-math.sin(1))
def structured_names():
    dae = ca.DaeBuilder("m")
    x, v = dae.add("body.x", {"start": 1}), dae.add("v[1]")
    dae.eq(dae.der(x), v)
    dae.eq(dae.der(v), -x)
    return dae


@accepted(x_1=E1, x_2=2 * E1, x_3=3 * E1)
def vector():
    dae = ca.DaeBuilder("m")
    x = dae.add("x", {"dimension": [3], "start": [1, 2, 3]})
    dae.eq(dae.der(x), -x)
    return dae


@accepted(x=math.exp(-2))
def matrix_of_parameters():
    dae, x = decay()
    A = dae.add("A", "parameter", "tunable", {"dimension": [2, 3]})
    dae.set_start("A", [1, 2, 3, 4, 5, 6])  # FMI: row by row
    dae.eq(dae.der(x), -A[1] * x)
    return dae


@accepted(x=math.cosh(1) - math.sinh(1))
def rate_in_an_equation():
    dae, x = decay()
    dae.eq(dae.der(x) + x, 0)
    return dae


def root_of_cubic(x: float) -> float:
    return float(np.roots([1, 0, 1, -x]).real[np.abs(np.roots([1, 0, 1, -x]).imag) < 1e-9][0])


@accepted()
def rate_and_unknown_in_equations():
    dae, x = decay(start=2.0)
    z = dae.add("z", {"start": 1})
    dae.eq(dae.der(x) + z, 0)
    dae.eq(z**3 + z, x)
    return dae


@accepted(x=E1)
def any_unit():
    dae = ca.DaeBuilder("m")
    x = dae.add("x", {"start": 1, "unit": "furlong/fortnight"})
    dae.set_display_unit("x", "knot")
    dae.eq(dae.der(x), -x)
    return dae


@accepted(x=E1)
def product_of_units():
    dae = ca.DaeBuilder("m")
    x = dae.add("x", {"start": 1, "unit": "kg.m2/s3"})
    dae.eq(dae.der(x), -x)
    return dae


@accepted(x=E1)
def bounds_and_nominals():
    dae = ca.DaeBuilder("m")
    x = dae.add("x", {"start": 1, "min": -5, "max": 5, "nominal": 2, "description": "place"})
    dae.eq(dae.der(x), -x)
    return dae


@accepted(x=E1)
def linear_system():
    dae, x = decay()
    A = ca.blockcat([[2 + x, 1], [1, 3 + x]])
    dae.eq(dae.der(x), -ca.solve(A, A @ ca.vertcat(x, 0))[0])
    return dae


@accepted(x=2 * (1 - math.exp(-0.5)))
def table():
    dae, x = decay(start=0.0)
    line = ca.interpolant("line", "linear", [[0, 1, 2]], [1, 0.5, 0])
    dae.eq(dae.der(x), line(x))
    return dae


@accepted(x=1 / 3)
def call_of_a_function():
    dae, x = decay()
    v = ca.MX.sym("v")
    dae.eq(dae.der(x), ca.Function("square", [v], [-2 * v**2])(x))
    return dae


@accepted(x=0.5)
def switch():
    dae, x = decay()
    dae.eq(dae.der(x), ca.if_else(x > 0.5, -1, 0))
    return dae


@accepted(k2=4.0, x=math.exp(-4))
def parameter_that_is_calculated():
    dae, x = decay()
    k = dae.add("k", "parameter", "tunable", {"start": 2})
    k2 = dae.add("k2", "calculatedParameter", "tunable")
    dae.assign("k2", 2 * k)
    dae.eq(dae.der(x), -k2 * x)
    return dae


@accepted(x=E1)
def alias_of_an_input():
    dae, x = decay()
    u, y = dae.add("u", "input", {"start": 1}), dae.add("y", "output")
    dae.eq(y, u)
    dae.eq(dae.der(x), -y * x)
    return dae


# -- refused by name ------------------------------------------------------------------------------


@refused("has events")
def ball():  # CasADi, `when`
    dae = ca.DaeBuilder("ball")
    h, v = dae.add("h", {"start": 5}), dae.add("v", {"start": 0})
    dae.eq(dae.der(h), v)
    dae.eq(dae.der(v), -9.81)
    dae.when(h < 0, [dae.reinit("v", -0.8 * v)])
    return dae


@refused("'n' is a discrete state")
def discrete_state():
    dae, x = decay()
    dae.eq(dae.der(x), -x * dae.add("n", "local", "discrete"))
    return dae


@refused("'k2' has no definition")
def calculated_parameter_without_definition():
    dae, x = decay()
    dae.eq(dae.der(x), -x * dae.add("k2", "calculatedParameter", "tunable"))
    return dae


@refused("0 equations for 1 algebraic unknowns")
def unknown_without_equation():
    dae, x = decay()
    dae.add("z")
    dae.eq(dae.der(x), -x)
    return dae


@refused("define each other in a circle")
def circle():
    dae, x = decay()
    w, v = dae.add("w"), dae.add("v")
    dae.eq(v, w + x)
    dae.eq(w, v)
    dae.eq(dae.der(x), -v)
    return dae


@refused("calls 'root', of type Newton")
def newton():
    dae, x = decay()
    y, p = ca.SX.sym("y"), ca.SX.sym("p")
    dae.eq(dae.der(x), ca.rootfinder("root", "newton", {"x": y, "p": p, "g": y - p})(0, x))
    return dae


class Python(ca.Callback):
    def __init__(self):
        super().__init__()
        self.construct("in_python", {})

    def eval(self, arguments):
        return arguments


CALLED = Python()


@refused("calls 'in_python', a callback")
def callback():
    dae, x = decay()
    dae.eq(dae.der(x), CALLED(x))
    return dae


@refused("index above 1")
def index_2():
    dae, x = decay()
    z = dae.add("z")
    dae.eq(dae.der(x), z)
    dae.eq(0, x - 1)
    return dae


@refused("needs 'y', which no rule before it settles|depends|needs")
def start_in_a_circle():
    dae, x = decay()
    y = dae.add("y")
    dae.eq(dae.der(x), -x)
    dae.eq(dae.der(y), -y)
    dae.set_init("x", y)
    dae.set_init("y", x)
    return dae


def test_table_has_30_models():
    assert len(ACCEPTED) + len(REFUSED) >= 30


OPTIONS = {"stop_time": 1.0, "relative_tolerance": 1e-9}


@pytest.mark.parametrize("name", ACCEPTED)
def test_accepted_model_is_right(name):
    builder, exact = ACCEPTED[name]
    dae = cosim.from_dae_builder(builder())
    run = cosim.simulate(dae, solver="rosenbrock", compiled=False, **OPTIONS)
    for variable, value in exact.items():
        assert run[variable][-1] == pytest.approx(value, abs=1e-6)


QUICK = (
    "switch",
    "calculated_start",
    "structured_names",
    "matrix_of_parameters",
    "any_unit",
    "quadrature",
)


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=[] if n in QUICK else pytest.mark.slow) for n in ACCEPTED],
)
def test_accepted_model_is_right_in_an_fmu(name, tmp_path):
    builder, exact = ACCEPTED[name]
    dae = cosim.from_dae_builder(builder())
    path = cosim.export_fmu(dae, tmp_path / "m.fmu")
    run = cosim.simulate_fmu(path, interface="CoSimulation", output_interval=0.1, **OPTIONS)
    start = cosim.simulate(dae, stop_time=0.1, output_interval=0.1, compiled=False)
    for variable in run.names:
        assert run[variable][0] == pytest.approx(start[variable][0], abs=1e-12)
    for variable, value in exact.items():
        assert run[variable][-1] == pytest.approx(value, abs=1e-6)


@pytest.mark.parametrize("name", REFUSED)
def test_refused_model_is_refused_in_one_sentence(name):
    builder, reason = REFUSED[name]
    with pytest.raises(UsageError, match=reason) as caught:
        cosim.from_dae_builder(builder())
    assert "\n" not in str(caught.value)
    assert isinstance(caught.value, CosimError)


def test_rate_and_unknown_satisfy_their_equations():
    run = cosim.simulate(
        cosim.from_dae_builder(rate_and_unknown_in_equations()),
        solver="rosenbrock",
        compiled=False,
        **OPTIONS,
    )
    assert run["z"][-1] == pytest.approx(root_of_cubic(run["x"][-1]), abs=1e-7)
    # x' = -z with x = z^3 + z: 3 z^2/2 + ln z falls as t
    fall = [1.5 * z**2 + math.log(z) for z in run["z"][[0, -1]]]
    assert fall[0] - fall[1] == pytest.approx(1.0, abs=1e-6)


def test_facts_come_along():
    dae = cosim.from_dae_builder(bounds_and_nominals())
    x = dae.variable("x")
    assert (x.minimum, x.maximum, x.nominal, x.meaning) == (-5, 5, 2, "place")
    assert "unit 'furlong/fortnight' is unknown here: factor 1" in (
        cosim.from_dae_builder(any_unit()).variable("x").meaning
    )
    matrix = cosim.from_dae_builder(matrix_of_parameters())
    assert {v.name: v.start for v in matrix.parameters} == {
        "A_1_1": 1, "A_1_2": 2, "A_1_3": 3, "A_2_1": 4, "A_2_2": 5, "A_2_3": 6
    }  # fmt: skip


def test_calculated_start_follows_its_parameter():
    dae = cosim.from_dae_builder(calculated_start())
    run = cosim.simulate(dae, stop_time=0.01, start={"p": 5.0}, compiled=False)
    assert run["x"][0] == 10.0
