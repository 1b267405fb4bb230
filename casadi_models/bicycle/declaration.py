"""Parameters, names, units, start values and sizes of all formulations of the bicycle.

Places and inertias are those of the aligned bicycle: origin at the rear contact P, axes of the
rear frame B with 1 forward, 2 to the right, 3 downward (Unit 7, Example 3, mass and inertia data).
"""

from collections.abc import Mapping
from math import pi
from typing import NamedTuple

import casadi as ca
from casadi import SX, cos

from casadi_models.bicycle.shapes import draw
from casadi_models.dae import Family, Model
from casadi_models.mechanics import conditions

FAMILY = Family(
    "bicycle",
    "upright bicycle",
    "Unit 7, Example 3; Meijaard et al., Proc. R. Soc. A 463, 2007",
    {"rad": "deg"},
    stop_time=20.0,
    draw=draw,
)

# Unit, value, meaning; the benchmark bicycle. A `+` marks what must be positive.
PARAMETERS: dict[str, tuple[str, float, str]] = {
    "w": ("+m", 1.02, "wheelbase"),
    "c": ("m", 0.08, "trail"),
    "lambda": ("rad", pi / 10, "tilt of the steering axis"),
    "rR": ("+m", 0.3, "radius of the rear wheel"),
    "rF": ("+m", 0.35, "radius of the front wheel"),
    "mA": ("+kg", 2.0, "mass of the rear wheel"),
    "mB": ("+kg", 85.0, "mass of the rear frame with rider"),
    "mC": ("+kg", 4.0, "mass of the fork"),
    "mD": ("+kg", 3.0, "mass of the front wheel"),
    "IAxx": ("+kg.m2", 0.0603, "inertia of the rear wheel about a diameter"),
    "IAyy": ("+kg.m2", 0.12, "inertia of the rear wheel about its axle"),
    "IBxx": ("+kg.m2", 9.2, "inertia of the rear frame, entry 11"),
    "IBxz": ("kg.m2", 2.4, "inertia of the rear frame, entry 13"),
    "IByy": ("+kg.m2", 11.0, "inertia of the rear frame, entry 22"),
    "IBzz": ("+kg.m2", 2.8, "inertia of the rear frame, entry 33"),
    "ICxx": ("+kg.m2", 0.05892, "inertia of the fork, entry 11"),
    "ICxz": ("kg.m2", -0.00756, "inertia of the fork, entry 13"),
    "ICyy": ("+kg.m2", 0.06, "inertia of the fork, entry 22"),
    "ICzz": ("+kg.m2", 0.00708, "inertia of the fork, entry 33"),
    "IDxx": ("+kg.m2", 0.1405, "inertia of the front wheel about a diameter"),
    "IDyy": ("+kg.m2", 0.28, "inertia of the front wheel about its axle"),
    "xGB": ("m", 0.3, "mass center of the rear frame, forward of P"),
    "zGB": ("m", -0.9, "mass center of the rear frame, below P"),
    "xGC": ("m", 0.9, "mass center of the fork, forward of P"),
    "zGC": ("m", -0.7, "mass center of the fork, below P"),
    "g": ("m/s2", 9.81, "gravity"),
}

# Unit, meaning, size of everything that some formulation calculates
QUANTITIES: dict[str, tuple[str, str, float]] = {
    "phi": ("rad", "roll angle of the rear frame", 0.1),
    "thetaR": ("rad", "angle of the rear wheel in the rear frame", 100.0),
    "delta": ("rad", "steer angle of the fork in the rear frame", 0.1),
    "psi": ("rad", "yaw angle of the rear frame", 0.1),
    "theta": ("rad", "pitch angle of the rear frame", 0.01),
    "thetaF": ("rad", "angle of the front wheel in the fork", 100.0),
    "phi_dot": ("rad/s", "rate of phi", 0.1),
    "thetaR_dot": ("rad/s", "rate of thetaR", 10.0),
    "delta_dot": ("rad/s", "rate of delta", 0.1),
    "psi_dot": ("rad/s", "rate of psi", 0.1),
    "theta_dot": ("rad/s", "rate of theta", 0.01),
    "thetaF_dot": ("rad/s", "rate of thetaF", 10.0),
    "xP": ("m", "contact point of the rear wheel along N1", 100.0),
    "yP": ("m", "contact point of the rear wheel along N2", 10.0),
    "zP": ("m", "contact point of the rear wheel along N3", 1.0),
    "speed": ("m/s", "speed of P along the heading of the rear wheel", 1.0),
    "fx_P": ("N", "force of the ground on the rear wheel along N1", 10.0),
    "fy_P": ("N", "force of the ground on the rear wheel along N2", 100.0),
    "fz_P": ("N", "force of the ground on the rear wheel along N3", 1000.0),
    "fx_Q": ("N", "force of the ground on the front wheel along N1", 10.0),
    "fy_Q": ("N", "force of the ground on the front wheel along N2", 100.0),
    "fz_Q": ("N", "force of the ground on the front wheel along N3", 1000.0),
    "loop_closure": ("m", "height of the front contact Q below the ground", 1.0),
    "slip_1": ("m/s", "velocity of the front wheel's material at Q along c1", 1.0),
    "slip_2": ("m/s", "velocity of the front wheel's material at Q along c2", 1.0),
    "slip_3": ("m/s", "velocity of the front wheel's material at Q along c3", 1.0),
}
# Names of the coordinates, of their rates and of the residuals, in the order of columns
ANGLES = "phi thetaR delta psi theta thetaF"
INDEPENDENT = "phi_dot thetaR_dot delta_dot"
DEPENDENT = "psi_dot theta_dot thetaF_dot"
RESIDUALS = "loop_closure slip_1 slip_2 slip_3"
STARTS = {"phi_dot": 0.5, "thetaR_dot": -15.3333333}  # rad/s; every other start is zero or follows

DRIFT = 1e-3  # m or m/s
SINGULAR = 1e-3  # of the scaled determinant of the constraint matrix

LOOP_CLOSURE = "pitch: the front wheel touches the ground"
ROLLING = "dependent rates: the front wheel rolls without slip"


class Body(NamedTuple):
    """A rigid body of the aligned bicycle: kg; kg.m2 about the mass center; m from P."""

    mass: SX
    inertia: SX
    center: SX


class Bicycle(NamedTuple):
    """The parameters, sorted by what they describe; lengths in m, angles in rad."""

    rear_wheel: Body  # A
    rear_frame: Body  # B, with the rider
    fork: Body  # C
    front_wheel: Body  # D
    w: SX
    c: SX
    tilt: SX
    rR: SX
    rF: SX
    g: SX


class Torques(NamedTuple):
    """The inputs, N.m."""

    steer: SX
    roll: SX
    rear_wheel: SX


def states(model: Model, names: str, *, own_meaning: str = "") -> SX:
    """Declare states by name; a column."""
    declared = []
    for name in names.split():
        unit, meaning, size = QUANTITIES[name]
        start = STARTS.get(name, 0.0)
        declared.append(
            model.state(name, unit, start, meaning, nominal=size, own_meaning=own_meaning)
        )
    return ca.vertcat(*declared)


def name_modes(model: Model, delta: SX) -> None:
    """Name the modes of lean and steer, as the literature does."""
    model.name_modes(delta, oscillating=["weave"], real=["capsize", "castering"])


def outputs(model: Model, names: str, column: SX) -> None:
    """Declare outputs by name, one per row."""
    for name, row in zip(names.split(), ca.vertsplit(column), strict=True):
        unit, meaning, size = QUANTITIES[name]
        model.output(name, unit, row, meaning, nominal=size)


def energies(model: Model, kinetic: SX, potential: SX) -> None:
    """Declare the energies."""
    model.energies(kinetic, potential, nominal=1000.0)


def limits(model: Model, phi: SX, fz_P: SX, fz_Q: SX) -> None:
    """Declare what every formulation supposes: two wheels on the ground, no fall."""
    model.limit(-fz_P, "the ground pushes the rear wheel up (the rear wheel would lift off)")
    model.limit(-fz_Q, "the ground pushes the front wheel up (the front wheel would lift off)")
    model.limit(cos(phi), "the rear frame leans by less than 90 deg")


def contact(model: Model, angles: SX, closure: SX) -> None:
    """Declare that the front wheel keeps to the ground: a matter of phi, delta and theta."""
    meaning = "the front wheel touches the ground"
    model.invariant("position_drift", angles[[0, 2, 4]], closure, meaning)


def rolling(model: Model, rates: SX, slip: SX, sizes: SX | None = None) -> None:
    """Declare that the front wheel does not slip, where all six rates are states."""
    model.invariant("velocity_drift", rates, slip, "the front wheel rolls", sizes=sizes)


def drift_limits(model: Model, closure: SX, slip: SX) -> None:
    """Declare how far a formulation that differentiates the constraints may drift from them."""
    model.limit(DRIFT - ca.fabs(closure), f"the front wheel is within {DRIFT:g} m of the ground")
    model.limit(DRIFT - ca.norm_inf(slip), f"the front wheel slips by less than {DRIFT:g} m/s")


def elimination(model: Model, bike: Bicycle, phi: SX, constraint_matrix: SX) -> None:
    """Declare where psi_dot, theta_dot and thetaF_dot can be eliminated, and how well.

    Args:
        model: The formulation.
        bike: Its parameters.
        phi: Roll angle.
        constraint_matrix: d(slip)/d(those rates), (3, 3), m; its determinant is -rF w^2 in the
            aligned bicycle and changes sign near a steer angle of 92 deg.
    """
    regular = -ca.det(constraint_matrix) / (bike.rF * bike.w**2)
    model.limit(
        regular - SINGULAR,
        "the steer angle is below the one (92 deg upright) where rolling no longer determines yaw, "
        "pitch and front wheel rate (the steer angle is singular here; use bicycle/multipliers)",
    )
    conditions.watch_elimination(model, constraint_matrix)
    conditions.watch_singularity(model, regular, cos(phi))


def torques(model: Model) -> Torques:
    """Declare the inputs."""
    return Torques(
        model.input("steer_torque", "N.m", 0.0, "torque of the rear frame on the fork about c3"),
        model.input("roll_torque", "N.m", 0.0, "torque from outside on the rear frame in roll"),
        model.input("rear_wheel_torque", "N.m", 0.0, "torque of the frame on the rear wheel"),
    )


def bicycle(model: Model) -> Bicycle:
    """Declare the parameters; note the inertias of the four bodies."""
    symbols = {
        name: model.parameter(name, unit.lstrip("+"), value, meaning, positive=unit[0] == "+")
        for name, (unit, value, meaning) in PARAMETERS.items()
    }
    bike = assemble(symbols)
    model.inertia("rear wheel", bike.rear_wheel.inertia)
    model.inertia("rear frame", bike.rear_frame.inertia)
    model.inertia("fork", bike.fork.inertia)
    model.inertia("front wheel", bike.front_wheel.inertia)
    return bike


def assemble(p: Mapping[str, SX]) -> Bicycle:
    """Sort parameters, given by name, into bodies and lengths."""

    def body(letter: str, x: SX, z: SX) -> Body:
        xx, yy = p[f"I{letter}xx"], p[f"I{letter}yy"]
        zz, xz = p.get(f"I{letter}zz", xx), p.get(f"I{letter}xz", SX(0))  # wheels: axisymmetric
        inertia = ca.blockcat([[xx, 0, xz], [0, yy, 0], [xz, 0, zz]])
        return Body(p[f"m{letter}"], inertia, ca.vertcat(x, 0, z))

    return Bicycle(
        rear_wheel=body("A", SX(0), -p["rR"]),
        rear_frame=body("B", p["xGB"], p["zGB"]),
        fork=body("C", p["xGC"], p["zGC"]),
        front_wheel=body("D", p["w"], -p["rF"]),
        w=p["w"],
        c=p["c"],
        tilt=p["lambda"],
        rR=p["rR"],
        rF=p["rF"],
        g=p["g"],
    )
