"""Parameters, states, names, units and sizes of all formulations of the bar on a frame."""

from functools import partial
from math import pi
from typing import NamedTuple

import casadi as ca
from casadi import SX

from casadi_models.bar_on_frame.shapes import draw
from casadi_models.dae import Family, Model
from casadi_models.units import BOOK_UNITS, DEGREE, FOOT, FOOT_POUND, INCH, SLUG

FAMILY = Family(
    "bar_on_frame",
    "bar pinned to a turning frame",
    "Unit 7, Example 2",
    BOOK_UNITS,
    stop_time=10.0,
    draw=draw,
)

# Loads and motion of the bar: unit, meaning, size
_FACTS = {
    "f1_G_F": ("N", "force of the pin on the bar along n1", 1.0),
    "f2_G_F": ("N", "force of the pin on the bar along n2", 100.0),
    "fk_G_F": ("N", "force of the pin on the bar along k", 1.0),
    "f1_G_B": ("N", "force of the pin on the bar along e1", 1.0),
    "f2_G_B": ("N", "force of the pin on the bar along n2", 100.0),
    "f3_G_B": ("N", "force of the pin on the bar along e3", 1.0),
    "t1_G_F": ("N.m", "torque of the pin on the bar about n1", 1.0),
    "t2_G_F": ("N.m", "torque of the pin on the bar about n2", 1.0),
    "tk_G_F": ("N.m", "torque of the pin on the bar about k", 1.0),
    "t1_G_B": ("N.m", "torque of the pin on the bar about e1", 1.0),
    "t2_G_B": ("N.m", "torque of the pin on the bar about n2", 1.0),
    "t3_G_B": ("N.m", "torque of the pin on the bar about e3", 1.0),
    "M_phi": ("N.m", "torque of the drive on the frame about k", 1.0),
    "f1_A_F": ("N", "force of the bottom bearing on the column along n1", 1.0),
    "f2_A_F": ("N", "force of the bottom bearing on the column along n2", 100.0),
    "f1_B_F": ("N", "force of the top bearing on the column along n1", 1.0),
    "f2_B_F": ("N", "force of the top bearing on the column along n2", 100.0),
    "wx_bar": ("rad/s", "angular velocity of the bar about world X", 10.0),
    "wy_bar": ("rad/s", "angular velocity of the bar about world Y", 10.0),
    "wz_bar": ("rad/s", "angular velocity of the bar about world Z", 10.0),
    "ax_bar": ("rad/s2", "angular acceleration of the bar about world X", 100.0),
    "ay_bar": ("rad/s2", "angular acceleration of the bar about world Y", 100.0),
    "az_bar": ("rad/s2", "angular acceleration of the bar about world Z", 100.0),
}


class Motion(NamedTuple):
    """States of the two angles."""

    theta: SX
    theta_dot: SX
    phi: SX
    Omega: SX


class Data(NamedTuple):
    """Parameters and the input, sorted by what they describe."""

    m: SX
    d: SX
    b: SX
    bar_inertia: SX  # about G, in (e1, n2, e3)
    column_mass: SX
    column_length: SX
    column_inertia: SX  # about its center, in F
    arm_mass: SX
    arm_inertia: SX  # about its center, in F
    weld_height: SX
    Omega_dot: SX
    T2: SX


def motion(model: Model) -> Motion:
    """Declare the states."""
    return Motion(
        model.state("theta", "rad", 60 * DEGREE, "angle of the bar about n2, relative to F"),
        model.state("theta_dot", "rad/s", 3.0, "rate of theta", nominal=10.0),
        model.state("phi", "rad", 0.0, "angle of the frame about k", nominal=100.0),
        model.state("Omega", "rad/s", 2 * pi, "rate of the frame about k", nominal=10.0),
    )


def data(model: Model) -> Data:
    """Declare parameters and input."""
    size = partial(model.parameter, positive=True)
    m = size("m", "kg", 0.2 * SLUG, "mass of the bar")
    length = size("length", "m", 1 * FOOT, "length of the bar")
    d = size("d", "m", 1 * FOOT, "length of the arm OG")
    b = model.parameter("b", "N.m.s/rad", 0.02 * FOOT_POUND, "damping in the pin", minimum=0.0)
    column_mass = size("column_mass", "kg", 0.01 * SLUG, "mass of the column")
    column_length = size("column_length", "m", 24 * INCH, "length of the column AB")
    radius = size("column_radius", "m", 0.5 * INCH, "radius of column and arm")
    arm_mass = size("arm_mass", "kg", 0.005 * SLUG, "mass of the arm")
    weld_height = size("weld_height", "m", 18 * INCH, "height of O above A")
    Omega_dot = model.parameter("Omega_dot", "rad/s2", 1.0, "angular acceleration of the frame")
    frame = model.parameter(
        "frame_inertia", "1", 1.0, "1: the frame has its mass, 0: it has none", minimum=0, maximum=1
    )
    T2 = model.input("T2", "N.m", 0.0, "torque in the pin on the bar about n2", nominal=0.1)
    return Data(
        m=m,
        d=d,
        b=b,
        bar_inertia=model.inertia("bar", _slender(m, length, SX(0), axis=1)),
        column_mass=frame * column_mass,
        column_length=column_length,
        column_inertia=frame
        * model.inertia("column", _slender(column_mass, column_length, radius, axis=3)),
        arm_mass=frame * arm_mass,
        arm_inertia=frame * model.inertia("arm", _slender(arm_mass, d, radius, axis=2)),
        weld_height=weld_height,
        Omega_dot=Omega_dot,
        T2=T2,
    )


def _slender(mass: SX, length: SX, radius: SX, *, axis: int) -> SX:
    """Return the inertia of a rod about its center: slender across, a cylinder about its axis."""
    across, along = mass * length**2 / 12, mass * radius**2 / 2
    return ca.diag(ca.vertcat(*(along if i == axis else across for i in (1, 2, 3))))


def outputs(model: Model, names: str, column: SX) -> None:
    """Declare outputs by name, one per row."""
    for name, component in zip(names.split(), ca.vertsplit(column), strict=True):
        unit, meaning, nominal = _FACTS[name]
        model.output(name, unit, component, meaning, nominal=nominal)


def algebraics(model: Model, names: str) -> SX:
    """Declare unknown loads by name; a column."""

    def declared(name: str) -> SX:
        unit, meaning, nominal = _FACTS[name]
        return model.algebraic(name, unit, 0.0, meaning, nominal=nominal)

    return ca.vertcat(*map(declared, names.split()))
