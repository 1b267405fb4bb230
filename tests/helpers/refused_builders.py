"""DaeBuilder models that are rejected, with the reported reason."""

from collections.abc import Callable

import casadi as ca
from helpers.accepted_builders import builder_of

REFUSED: dict[str, tuple[Callable[[], ca.DaeBuilder], str]] = {}


def refused(reason: str):
    def note(add):
        REFUSED[add.__name__] = builder_of(add), reason
        return add

    return note


@refused("'n' is a discrete state")
def discrete_state(dae, x):
    dae.eq(dae.der(x), -x * dae.add("n", "local", "discrete"))


@refused("'k2' has no definition")
def calculated_parameter_without_definition(dae, x):
    dae.eq(dae.der(x), -x * dae.add("k2", "calculatedParameter", "tunable"))


@refused("0 equations for 1 algebraic unknowns")
def unknown_without_equation(dae, x):
    dae.add("z")
    dae.eq(dae.der(x), -x)


@refused("x: nominal -2.0 is not a positive number")
def negative_nominal_value(dae, x):
    dae.set_nominal("x", -2.0)
    dae.eq(dae.der(x), -x)


@refused("define each other in a circle")
def circle(dae, x):
    w, v = dae.add("w"), dae.add("v")
    dae.eq(v, w + x)
    dae.eq(w, v)
    dae.eq(dae.der(x), -v)


@refused("calls 'root', of type Newton")
def newton(dae, x):
    y, p = ca.SX.sym("y"), ca.SX.sym("p")
    dae.eq(dae.der(x), ca.rootfinder("root", "newton", {"x": y, "p": p, "g": y - p})(0, x))


class Python(ca.Callback):
    def __init__(self):
        super().__init__()
        self.construct("in_python", {})

    def eval(self, arguments):
        return arguments


CALLED = Python()


@refused("calls 'in_python', a callback")
def callback(dae, x):
    dae.eq(dae.der(x), CALLED(x))


@refused("index above 1")
def index_2(dae, x):
    z = dae.add("z")
    dae.eq(dae.der(x), z)
    dae.eq(0, x - 1)


@refused("needs 'y', which no rule before it settles|depends|needs")
def start_in_a_circle(dae, x):
    y = dae.add("y")
    dae.eq(dae.der(x), -x)
    dae.eq(dae.der(y), -y)
    dae.set_init("x", y)
    dae.set_init("y", x)
