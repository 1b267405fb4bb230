"""The book's formulation of the bicycle: its 15 states, integrated exactly as the book does."""

import casadi as ca
from casadi import SX, cos, sin, sqrt

from casadi_models.bicycle import declaration
from casadi_models.bicycle.declaration import PARAMETERS, Bicycle, assemble
from casadi_models.bicycle.stages import BODIES, Geometry, Signals, bodies, flow, in_wheel_plane
from casadi_models.dae import Dae
from casadi_models.mechanics import conditions
from casadi_models.mechanics.rotations import about, unit

_STATES = (
    "phi thetaR delta psi theta thetaF phi_dot thetaR_dot delta_dot psi_dot theta_dot thetaF_dot"
)
_OTHER_POINT = "the book leaves the pitch rate out of the contact point's velocity"


def build() -> Dae:
    """Return the ODE of the book's state vector; dependent rates are states of their own."""
    model = declaration.FAMILY.formulation("book", "the book's 15 states and algorithm")
    y = ca.vertcat(
        declaration.states(model, _STATES),
        declaration.states(model, "xP yP", own_meaning=_OTHER_POINT),
        declaration.states(model, "zP"),
    )
    bike, torques = declaration.bicycle(model), declaration.torques(model)
    on_speeds = ca.vertcat(torques.roll, torques.rear_wheel, torques.steer)
    s = flow({"y": y, "torques": on_speeds} | _constants(bike))
    k = Geometry(*ca.vertsplit(s["geometry"]))

    closure = _loop_closure(k, s)
    model.derivative(y, s["dydt"])
    model.start_equation(y[4], closure, declaration.LOOP_CLOSURE)
    model.start(y[9:12], s["J"] @ s["u_I"], declaration.ROLLING)

    places = _places(k, s)
    forces = _contact_forces(k, s, places)
    declaration.outputs(model, "fx_P fy_P fz_P fx_Q fy_Q fz_Q", forces)
    declaration.outputs(model, "speed", -k.rR * (y[7] + y[10]))
    model.start_through(y[7], "speed")
    slip = s["C_1"] @ s["u_I"] + s["C_2"] @ s["u_D"]
    declaration.outputs(model, "loop_closure slip_1 slip_2 slip_3", ca.vertcat(closure, slip))
    kinetic = ca.dot(s["u_I"], s["M"] @ s["u_I"]) / 2
    weight = sum((mass * places[body] for body, mass, _ in bodies(s)), SX.zeros(3)) * s["gravity"]
    declaration.energies(model, kinetic, -weight[2])
    declaration.name_modes(model, y[2])
    declaration.limits(model, s["phi"], forces[2], forces[5])
    declaration.elimination(model, bike, s["phi"], s["C_2"])
    declaration.drift_limits(model, closure, slip)
    declaration.contact(model, y[:6], closure)
    declaration.rolling(model, y[6:12], slip)
    conditions.watch_masses(model, s["M"])
    return model.freeze()


def constants() -> ca.Function:
    """Return the Function from the model's parameters, by name, to the constants of the stages.

    Its outputs: geometry (11, 1), see `Geometry`; masses (4, 1), kg; inertias of A to D (3, 12),
    each in the axes of W, kg.m2; gravity, m/s2.
    """
    symbols = {name: SX.sym(name) for name in PARAMETERS}
    signals = _constants(assemble(symbols))
    names = list(symbols), list(signals)
    return ca.Function("constants", list(symbols.values()), list(signals.values()), *names)


def _constants(bike: Bicycle) -> Signals:
    """Return geometry, masses and inertias as the book calculates them (Panels 4 and 6)."""
    s, c = sin(bike.tilt), cos(bike.tilt)
    B_to_C = about(2, bike.tilt).T  # without steer
    xS = ((bike.w + bike.c) * c - bike.rR * s) * c
    zS = xS * s / c
    axle = bike.rear_wheel.center
    at_S = axle + ca.vertcat(xS, 0, -zS)
    r_B = bike.rear_frame.center - axle
    r_C, r_D = (B_to_C @ (body.center - at_S) for body in (bike.fork, bike.front_wheel))
    geometry = Geometry(
        bike.rR, bike.rF, bike.tilt, r_B[0], -r_B[2], xS, zS, r_C[0], r_C[2], r_D[0], r_D[2]
    )
    fork = B_to_C @ bike.fork.inertia @ B_to_C.T
    inertias = (bike.rear_wheel.inertia, bike.rear_frame.inertia, fork, bike.front_wheel.inertia)
    return {
        "geometry": ca.vertcat(*geometry),
        "masses": ca.vertcat(*(body.mass for body in bike[:4])),
        "inertias": ca.horzcat(*inertias),
        "gravity": bike.g,
    }


def _loop_closure(k: Geometry, s: Signals) -> SX:
    """Return the depth of Q below the ground (the equation that gives the pitch angle)."""
    phi, delta, theta = s["phi"], s["delta"], s["theta"]
    n_1 = sin(phi) * sin(delta) - cos(phi) * cos(delta) * sin(k.tilt + theta)
    n_3 = cos(phi) * cos(k.tilt + theta)
    depth_S = -(k.rR + k.xS * sin(theta) + k.zS * cos(theta)) * cos(phi)
    return depth_S + k.xD * n_1 + k.zD * n_3 + k.rF * sqrt(n_1**2 + n_3**2)


def _places(k: Geometry, s: Signals) -> Signals:
    """Return the mass centers and the front contact Q from P, in the ground's axes."""
    B_to_R, C_to_R = s["R_R2B"].T, s["R_R2C"].T
    r_A = k.r_A(s["theta"])
    at_S = B_to_R @ (r_A + k.r_S)
    at_D = at_S + C_to_R @ k.r_D
    return {
        "A": B_to_R @ r_A,
        "B": B_to_R @ (r_A + k.r_B),
        "C": at_S + C_to_R @ k.r_C,
        "D": at_D,
        "Q": at_D + C_to_R @ (k.rF * in_wheel_plane(s["N_3"])),
    }


def _contact_forces(k: Geometry, s: Signals, places: Signals) -> SX:
    """Return the ground's forces at P and Q by Newton and Euler, (6, 1); the book has none.

    Three equations hold the force at Q but neither the force at P nor an input: the moments of the
    whole bicycle about P, vertical and across, and the moment of the front wheel about its axle.
    """
    rates = {body: _momentum_rates(s, body, mass, inertia) for body, mass, inertia in bodies(s)}
    loads = {body: rates[body][0] - mass * s["gravity"] * unit(3) for body, mass, _ in bodies(s)}
    moments = (ca.cross(places[body], loads[body]) + rates[body][1] for body in BODIES)
    force, moment = sum(loads.values(), SX.zeros(3)), sum(moments, SX.zeros(3))

    across = ca.vertcat(-sin(s["psi"]), cos(s["psi"]), 0)
    axle = s["R_R2C"][1, :].T
    heading = s["R_R2C"].T @ ca.cross(unit(2), in_wheel_plane(s["N_3"]))
    r_Q = places["Q"]
    equations = ca.horzcat(ca.cross(unit(3), r_Q), ca.cross(across, r_Q), k.rF * heading).T
    at_Q = ca.solve(
        equations, ca.vertcat(moment[2], ca.dot(across, moment), ca.dot(axle, rates["D"][1]))
    )
    return ca.vertcat(force - at_Q, at_Q)


def _momentum_rates(s: Signals, body: str, mass: SX, inertia: SX) -> tuple[SX, SX]:
    """Return the rates of linear and angular momentum of a body, in the ground's axes."""
    turn, to_R = (s["omegaB"], s["R_R2B"].T) if body in "AB" else (s["omegaC"], s["R_R2C"].T)
    v, omega = f"V{body}", f"W{body}"
    v_dot = s[v] @ s["u_I_dot"] + s[f"{v}_dot"] @ s["u_I"] + ca.cross(turn, s[f"vG{body}"])
    omega_dot = s[omega] @ s["u_I_dot"] + s[f"{omega}_dot"] @ s["u_I"]
    momentum = inertia @ s[f"omega{body}"]
    return mass * to_R @ v_dot, to_R @ (inertia @ omega_dot + ca.cross(turn, momentum))
