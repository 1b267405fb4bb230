"""DaeBuilder models that are rejected, with the reported reason."""

from collections.abc import Callable

import casadi as ca
from helpers.accepted_builders import decay

REFUSED: dict[str, tuple[Callable[[], ca.DaeBuilder], str]] = {}


def refused(reason: str):
    def note(builder):
        REFUSED[builder.__name__] = builder, reason
        return builder

    return note


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
