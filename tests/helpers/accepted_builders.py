"""DaeBuilder models that are accepted, with exact values at t = 1.

The ones that are marked are examples of CasADi's own documentation (class DaeBuilder), with numbers
where those leave them out.
"""

import math
from collections.abc import Callable

import casadi as ca
import numpy as np

Facts = float | dict | None
ACCEPTED: dict[str, tuple[Callable[[], ca.DaeBuilder], dict[str, float]]] = {}
E1 = math.exp(-1)


def accepted(x: Facts = 1.0, /, **at_1: float):
    """Note a builder and exact values at t = 1; `x` are start or facts of its first variable."""

    def note(add):
        ACCEPTED[add.__name__] = builder_of(add, x), at_1
        return ACCEPTED[add.__name__][0]

    return note


def builder_of(add: Callable[..., None], x: Facts = 1.0) -> Callable[[], ca.DaeBuilder]:
    """Return what makes a builder with a variable x, if any, to which `add` adds the rest."""

    def build():
        dae = ca.DaeBuilder("m")
        own = () if x is None else (dae.add("x", x if isinstance(x, dict) else {"start": x}),)
        add(dae, *own)
        return dae

    return build


@accepted(None, h=-4.405, v=-8.81)
def rocket(dae):  # CasADi's class documentation; drag and burning off: closed form
    a = dae.add("a", "parameter", "tunable")
    u = dae.add("u", "input", {"start": 1})
    h = dae.add("h", {"start": 0})
    v = dae.add("v", {"start": 0, "unit": "m/s"})
    m = dae.add("m", {"start": 1})
    dae.eq(dae.der(h), v)
    dae.eq(dae.der(v), (u - a * v**2) / m - 9.81)
    dae.eq(dae.der(m), 0 * u)


@accepted(None, m=0.0)
def rocket_that_burns(dae):  # the same: m' = -u^2
    u, m = dae.add("u", "input", {"start": 1}), dae.add("m", {"start": 1})
    dae.eq(dae.der(m), -(u**2))


@accepted(x=E1 * 3.0)
def start_of_an_input(dae, x):  # set_init with what is known where a run begins
    t, u = dae.add("t", "independent"), dae.add("u", "input", {"start": 2})
    dae.eq(dae.der(x), -x)
    dae.set_init("x", u + ca.exp(t))


@accepted(x=E1**0.5, z=E1**0.5 / 2)
def algebraic(dae, x):  # CasADi, `inputs`: 0 = x - 2 z
    z, u = dae.add("z"), dae.add("u", "input", {"start": 1})
    dae.eq(dae.der(x), -x + z * u)
    dae.eq(0, x - 2 * z)


@accepted(x=2 * math.atan(math.tan(0.5) * E1), w=math.sin(2 * math.atan(math.tan(0.5) * E1)))
def dependent(dae, x):  # CasADi, `w`
    w = dae.add("w")
    dae.eq(w, ca.sin(x))
    dae.eq(dae.der(x), -w)


@accepted(x=6 * E1)
def calculated_start(dae, x):  # CasADi, `init_lhs`: set_init
    p = dae.add("p", "parameter", "tunable", {"start": 3})
    dae.eq(dae.der(x), -x)
    dae.set_init("x", 2 * p)


@accepted(x=math.exp(-2))
def fixed_input(dae, x):  # CasADi, `set_variability`
    u = dae.add("u", "input", {"start": 2})
    dae.eq(dae.der(x), -u * x)
    dae.set_variability("u", "fixed")


@accepted(x=math.exp(-2))
def tunable_input(dae, x):  # CasADi, `set_variability`
    u = dae.add("u", "input", {"start": 2})
    dae.eq(dae.der(x), -u * x)
    dae.set_variability("u", "tunable")


@accepted(x=1 + 1 - math.cos(1))
def time(dae, x):  # CasADi, `time`
    t = dae.add("t", "independent")
    dae.eq(dae.der(x), ca.sin(t))


@accepted(x=2 - math.cos(1))
def time_by_its_name(dae, x):
    dae.eq(dae.der(x), ca.sin(dae.add("time", "independent")))


@accepted(x=math.exp(-6))
def fixed_and_integer_parameters(dae, x):
    k = dae.add("k", "parameter", "fixed", {"start": 2})
    n = dae.add("n", "parameter", "fixed", {"type": "Int32", "start": 3})
    dae.eq(dae.der(x), -k * n * x)


@accepted(x=E1)
def boolean_parameter(dae, x):
    on = dae.add("on", "parameter", "fixed", {"type": "Boolean", "start": 1})
    dae.eq(dae.der(x), -on * x)


@accepted(x=math.exp(-2))
def constant(dae, x):
    k = dae.add("k", "local", "constant")
    dae.set_start("k", 2.0)
    dae.eq(dae.der(x), -k * x)


@accepted(x=math.exp(-2), k=2.0)
def constant_output(dae, x):
    k = dae.add("k", "output", "constant", {"start": 2})
    dae.eq(dae.der(x), -k * x)


@accepted(x=E1, q=1 - E1)
def quadrature(dae, x):
    q = dae.add("q")
    dae.eq(dae.der(x), -x)
    dae.eq(dae.der(q), x)
    dae.set_category("q", "q")


@accepted(x=E1, y=2 * E1)
def output(dae, x):
    y = dae.add("y", "output")
    dae.eq(dae.der(x), -x)
    dae.eq(y, 2 * x)


@accepted(None, x=E1)
def state_as_output(dae):
    x = dae.add("x", "output", {"start": 1})
    dae.eq(dae.der(x), -x)


@accepted(x=math.exp(-3), w=2 * math.exp(-3), v=3 * math.exp(-3), y=6 * math.exp(-3))
def chain_of_definitions(dae, x):
    w, v, y = dae.add("w"), dae.add("v"), dae.add("y", "output")
    dae.eq(w, 2 * x)
    dae.eq(v, w + x)
    dae.eq(y, 2 * v)
    dae.eq(dae.der(x), -v)


@accepted(x=math.exp(-3), v=3 * math.exp(-3))
def definitions_in_any_order(dae, x):
    w, v = dae.add("w"), dae.add("v")
    dae.eq(v, w + x)
    dae.eq(w, 2 * x)
    dae.eq(dae.der(x), -v)


@accepted(None, body_x=math.cos(1), v_1=-math.sin(1))
def structured_names(dae):
    x, v = dae.add("body.x", {"start": 1}), dae.add("v[1]")
    dae.eq(dae.der(x), v)
    dae.eq(dae.der(v), -x)


@accepted({"dimension": [3], "start": [1, 2, 3]}, x_1=E1, x_2=2 * E1, x_3=3 * E1)
def vector(dae, x):
    dae.eq(dae.der(x), -x)


@accepted(x=math.exp(-2))
def matrix_of_parameters(dae, x):
    A = dae.add("A", "parameter", "tunable", {"dimension": [2, 3]})
    dae.set_start("A", [1, 2, 3, 4, 5, 6])  # FMI: row by row
    dae.eq(dae.der(x), -A[1] * x)


@accepted(x=math.cosh(1) - math.sinh(1))
def rate_in_an_equation(dae, x):
    dae.eq(dae.der(x) + x, 0)


def root_of_cubic(x: float) -> float:
    return float(np.roots([1, 0, 1, -x]).real[np.abs(np.roots([1, 0, 1, -x]).imag) < 1e-9][0])


@accepted(2.0)
def rate_and_unknown_in_equations(dae, x):
    z = dae.add("z", {"start": 1})
    dae.eq(dae.der(x) + z, 0)
    dae.eq(z**3 + z, x)


@accepted({"start": 1, "unit": "furlong/fortnight"}, x=E1)
def any_unit(dae, x):
    dae.set_display_unit("x", "knot")
    dae.eq(dae.der(x), -x)


@accepted({"start": 1, "unit": "kg.m2/s3"}, x=E1)
def product_of_units(dae, x):
    dae.eq(dae.der(x), -x)


@accepted({"start": 1, "min": -5, "max": 5, "nominal": 2, "description": "place"}, x=E1)
def bounds_and_nominals(dae, x):
    dae.eq(dae.der(x), -x)


@accepted(x=E1)
def linear_system(dae, x):
    A = ca.blockcat([[2 + x, 1], [1, 3 + x]])
    dae.eq(dae.der(x), -ca.solve(A, A @ ca.vertcat(x, 0))[0])


@accepted(0.0, x=2 * (1 - math.exp(-0.5)))
def table(dae, x):
    line = ca.interpolant("line", "linear", [[0, 1, 2]], [1, 0.5, 0])
    dae.eq(dae.der(x), line(x))


@accepted(x=1 / 3)
def call_of_a_function(dae, x):
    v = ca.MX.sym("v")
    dae.eq(dae.der(x), ca.Function("square", [v], [-2 * v**2])(x))


@accepted(x=0.5)
def switch(dae, x):
    dae.eq(dae.der(x), ca.if_else(x > 0.5, -1, 0))


@accepted(k2=4.0, x=math.exp(-4))
def parameter_that_is_calculated(dae, x):
    k = dae.add("k", "parameter", "tunable", {"start": 2})
    k2 = dae.add("k2", "calculatedParameter", "tunable")
    dae.assign("k2", 2 * k)
    dae.eq(dae.der(x), -k2 * x)


@accepted(x=E1)
def alias_of_an_input(dae, x):
    u, y = dae.add("u", "input", {"start": 1}), dae.add("y", "output")
    dae.eq(y, u)
    dae.eq(dae.der(x), -y * x)


# -- what only MX has ---------------------------------------------------------------------------


@accepted(x=E1)
def large_linear_system(dae, x):  # more rows than are written out
    A = ca.DM.ones(30, 30) + ca.diag(ca.DM(range(1, 31))) + x * ca.DM.eye(30)
    dae.eq(dae.der(x), -ca.solve(A, A @ ca.repmat(x, 30, 1))[17])


@accepted(x=E1)
def root_of_a_function(dae, x):
    y, p = ca.SX.sym("y"), ca.SX.sym("p")
    root = ca.rootfinder("root", "fast_newton", {"x": y, "p": p, "g": y**3 + y - p**3 - p})
    dae.eq(dae.der(x), -root(0.5, x))


@accepted(x=math.exp(-2))
def short_circuit_with_an_index_between_two(dae, x):
    which = dae.add("which", "parameter", "tunable", {"start": 1.5})
    dae.eq(dae.der(x), ca.conditional(which, [-x, -2 * x, -3 * x], -4 * x, True))


@accepted(x=E1)
def mapped_function(dae, x):
    v = ca.MX.sym("v")
    every = ca.Function("half", [v], [-v / 2]).map(3)(ca.horzcat(x / 3, x, 2 * x / 3))
    dae.eq(dae.der(x), ca.sum2(every))


@accepted(x=E1)
def accumulated_function(dae, x):
    v, w = ca.MX.sym("v"), ca.MX.sym("w")
    steps = ca.Function("step", [v, w], [v + w]).mapaccum(4)
    dae.eq(dae.der(x), steps(0, -x / 4 * ca.DM.ones(1, 4))[3])


@accepted(x=math.exp(-2))
def entry_at_a_calculated_place(dae, x):
    which = dae.add("which", "parameter", "tunable", {"start": 1})
    dae.eq(dae.der(x), -ca.vertcat(x, 2 * x, 3 * x)[which])


@accepted(x=E1)
def sum_of_exponentials(dae, x):
    dae.eq(dae.der(x), math.log(2) - ca.logsumexp(ca.vertcat(x, x)))


@accepted(0.0, x=1 - E1)
def smooth_table(dae, x):
    line = ca.interpolant("line", "bspline", [[0, 1, 2, 3]], [1, 0, -1, -2])
    dae.eq(dae.der(x), line(x))


@accepted(x=E1)
def matrices_and_norms(dae, x):
    A = ca.reshape(ca.vertcat(x, 0, 0, x), 2, 2)
    dae.eq(dae.der(x), -ca.norm_fro(A) / math.sqrt(2) * ca.det(A) / ca.dot(A, A) * 2)
