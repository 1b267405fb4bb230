"""The book's own algorithm for the bicycle: ten stages that one can call and inspect.

Signals carry the book's letters, rates end in `_dot`, and flow from stage to stage by name as in
the book's Model 3. The matrices W and V turn the independent speeds u_I into angular velocities and
velocities of the mass centers: of A and B in the axes of B, of C and D in those of C. R_R2B turns
components from the ground's axes into those of B.

Source  Unit 7, Example 3: main script, Panels 4 to 10, and bicycleEOM, Panels 2 and 3. C_1 and C_2
        are printed there; W, V and the mass matrix follow from the bodies' motion (Unit 5), time
        derivatives from the chain rule.
"""

from collections.abc import Callable
from typing import NamedTuple

import casadi as ca
from casadi import SX, cos, sin, skew, sqrt

from casadi_models.mechanics.rotations import about, unit

Signals = dict[str, SX]

BODIES = "ABCD"
_SHAPES = {"y": 15, "geometry": 11, "masses": 4} | dict.fromkeys(
    ("torques", "u_I", "u_D", "N_3"), 3
)


class Geometry(NamedTuple):
    """The book's geoParameters, m and rad: B and S from the rear axle, C and D from S."""

    rR: SX
    rF: SX
    tilt: SX
    xB: SX
    zB: SX
    xS: SX
    zS: SX
    xC: SX
    zC: SX
    xD: SX
    zD: SX

    @property
    def r_B(self) -> SX:
        """Mass center of B from the rear axle, in B."""
        return ca.vertcat(self.xB, 0, -self.zB)

    @property
    def r_S(self) -> SX:
        """Point S of the steering axis from the rear axle, in B."""
        return ca.vertcat(self.xS, 0, -self.zS)

    @property
    def r_C(self) -> SX:
        """Mass center of C from S, in C."""
        return ca.vertcat(self.xC, 0, self.zC)

    @property
    def r_D(self) -> SX:
        """Mass center of D from S, in C."""
        return ca.vertcat(self.xD, 0, self.zD)

    def r_A(self, theta: SX) -> SX:
        """Rear axle from the contact P, in B."""
        return self.rR * ca.vertcat(sin(theta), 0, -cos(theta))


def stages() -> dict[str, ca.Function]:
    """Return the stages from the state vector y to its derivative dydt, in order."""
    W, V, W_dot, V_dot = (
        " ".join(name.format(body) for body in BODIES)
        for name in ("W{}", "V{}", "W{}_dot", "V{}_dot")
    )
    omega, v = (" ".join(name + body for body in BODIES) for name in ("omega", "vG"))
    functions = (
        _stage(_load_variables, "y"),
        _stage(_transformations, "geometry phi delta psi theta"),
        _stage(_constraints, "geometry phi theta R_B2C N_3"),
        _stage(_angular_partials, "phi theta R_B2C J"),
        _stage(_linear_partials, f"geometry theta R_B2C {W}"),
        _stage(_velocities, f"u_I {W} {V}"),
        _stage(
            _constraint_rates,
            "geometry phi delta theta phi_dot delta_dot theta_dot R_B2C N_3 C_2 J",
        ),
        _stage(_angular_partial_rates, "phi theta phi_dot theta_dot R_B2C R_B2C_dot J J_dot"),
        _stage(_linear_partial_rates, f"geometry theta theta_dot R_B2C R_B2C_dot {W} {W_dot}"),
        _stage(
            _state_derivative,
            f"geometry masses inertias gravity torques theta R_R2B N_3 J J_dot u_I u_D "
            f"{W} {V} {omega} {v} {W_dot} {V_dot}",
        ),
    )
    return {function.name(): function for function in functions}


def flow(known: Signals) -> Signals:
    """Return every signal that follows from y, geometry, masses, inertias, gravity and torques."""
    signals = dict(known)
    for stage in stages().values():
        signals |= stage(**{name: signals[name] for name in stage.name_in()})
    return signals


def _load_variables(s: Signals) -> Signals:
    phi, _, delta, psi, theta, _, phi_dot, _, delta_dot, _, theta_dot = ca.vertsplit(s["y"])[:11]
    angles = {"phi": phi, "delta": delta, "psi": psi, "theta": theta}
    rates = {"phi_dot": phi_dot, "delta_dot": delta_dot, "theta_dot": theta_dot}
    return angles | rates | {"u_I": s["y"][6:9], "u_D": s["y"][9:12]}


def _transformations(s: Signals) -> Signals:
    R_R2B = (about(3, s["psi"]) @ about(1, s["phi"]) @ about(2, s["theta"])).T
    R_B2C = (about(2, _geometry(s).tilt) @ about(3, s["delta"])).T
    R_R2C = R_B2C @ R_R2B
    return {"R_R2B": R_R2B, "R_B2C": R_B2C, "R_R2C": R_R2C, "N_3": R_R2C[:, 2]}


def _constraints(s: Signals) -> Signals:
    """C_1 u_I + C_2 u_D = 0: the front wheel's material at Q rests; in C (Panel 10)."""
    k, R_B2C = _geometry(s), s["R_B2C"]
    sin_phi, cos_phi = sin(s["phi"]), cos(s["phi"])
    sin_theta, cos_theta = sin(s["theta"]), cos(s["theta"])
    frame_I, frame_D = _rear_frame_rates(s)
    fork_I, fork_D = R_B2C @ frame_I + _entry(3, 3), R_B2C @ frame_D
    # Velocity of S in B; then, in C, what the hub adds to it and Q to the hub
    up, ahead = k.rR * cos_theta + k.zS, k.rR * sin_theta + k.xS
    S_I = ca.blockcat(
        [
            [0, -k.rR * cos_theta, 0],
            [k.rR + k.xS * sin_theta + k.zS * cos_theta, 0, 0],
            [0, -k.rR * sin_theta, 0],
        ]
    )
    S_D = ca.blockcat(
        [
            [-sin_phi * up, -up, 0],
            [cos_phi * (k.xS * cos_theta - k.zS * sin_theta), 0, 0],
            [-sin_phi * ahead, -ahead, 0],
        ]
    )
    to_Q = k.rF * in_wheel_plane(s["N_3"])
    C_1 = R_B2C @ S_I - skew(k.r_D) @ fork_I - skew(to_Q) @ fork_I
    C_2 = R_B2C @ S_D - skew(k.r_D) @ fork_D - skew(to_Q) @ (fork_D + _entry(2, 3))
    return {"C_1": C_1, "C_2": C_2, "J": -ca.solve(C_2, C_1)}


def _angular_partials(s: Signals) -> Signals:
    frame_I, frame_D = _rear_frame_rates(s)
    WB = frame_I + frame_D @ s["J"]
    WC = s["R_B2C"] @ WB + _entry(3, 3)
    return {
        "WA": WB + _entry(2, 2),
        "WB": WB,
        "WC": WC,
        "WD": WC + _entry(2, 3) @ s["J"],
    }


def _linear_partials(s: Signals) -> Signals:
    k = _geometry(s)
    VA = -skew(k.r_A(s["theta"])) @ s["WA"]  # the rear wheel's material at P rests
    VS = s["R_B2C"] @ (VA - skew(k.r_S) @ s["WB"])
    return {
        "VA": VA,
        "VB": VA - skew(k.r_B) @ s["WB"],
        "VC": VS - skew(k.r_C) @ s["WC"],
        "VD": VS - skew(k.r_D) @ s["WC"],
    }


def _velocities(s: Signals) -> Signals:
    omega = {f"omega{body}": s[f"W{body}"] @ s["u_I"] for body in BODIES}
    return omega | {f"vG{body}": s[f"V{body}"] @ s["u_I"] for body in BODIES}


def _constraint_rates(s: Signals) -> Signals:
    turning = _transformations(s | {"psi": SX(0)})  # neither R_B2C nor N_3 depends on yaw
    rates = {f"{n}_dot": _rate(turning[n], s, "phi delta theta") for n in ("R_B2C", "N_3")}
    matrices = _constraints(s)
    for name in ("C_1", "C_2"):
        rates[f"{name}_dot"] = _rate(matrices[name], s | rates, "phi theta R_B2C N_3")
    J_dot = -ca.solve(s["C_2"], rates["C_1_dot"] + rates["C_2_dot"] @ s["J"])
    return rates | {"J_dot": J_dot}


def _angular_partial_rates(s: Signals) -> Signals:
    matrices = _angular_partials(s)
    return {f"{n}_dot": _rate(W, s, "phi theta R_B2C J") for n, W in matrices.items()}


def _linear_partial_rates(s: Signals) -> Signals:
    varying = "theta R_B2C WA WB WC WD"
    return {f"{n}_dot": _rate(V, s, varying) for n, V in _linear_partials(s).items()}


def _state_derivative(s: Signals) -> Signals:
    """Kane's equations M u_I' = f (Unit 5), then the rates of u_D and of the contact point P."""
    k, u_I = _geometry(s), s["u_I"]
    M, Fg, f = SX.zeros(3, 3), SX.zeros(3), s["torques"]
    for body, mass, inertia in bodies(s):
        W, V, v = s[f"W{body}"], s[f"V{body}"], s[f"vG{body}"]
        turn = s["omegaB"] if body in "AB" else s["omegaC"]  # of the axes of W and V
        down = s["R_R2B"][:, 2] if body in "AB" else s["N_3"]
        momentum = inertia @ s[f"omega{body}"]
        M += mass * V.T @ V + W.T @ inertia @ W
        Fg += V.T @ (mass * s["gravity"] * down)
        f -= mass * V.T @ (s[f"V{body}_dot"] @ u_I + ca.cross(turn, v))
        f -= W.T @ (inertia @ s[f"W{body}_dot"] @ u_I + ca.cross(turn, momentum))
    f += Fg
    u_I_dot = ca.solve(M, f)
    u_D_dot = s["J"] @ u_I_dot + s["J_dot"] @ u_I
    to_P = -k.r_A(s["theta"])
    # The book's rate of P: the point of B at P, which leaves the pitch rate out
    xP_dot = s["R_R2B"].T @ (s["vGA"] + ca.cross(s["omegaB"], to_P))
    dydt = ca.vertcat(u_I, s["u_D"], u_I_dot, u_D_dot, xP_dot)
    return {"M": M, "Fg": Fg, "f": f, "u_I_dot": u_I_dot, "u_D_dot": u_D_dot, "dydt": dydt}


def bodies(s: Signals) -> list[tuple[str, SX, SX]]:
    """Return letter, mass and inertia of the four bodies."""
    return list(zip(BODIES, ca.vertsplit(s["masses"]), ca.horzsplit(s["inertias"], 3), strict=True))


def in_wheel_plane(N_3: SX) -> SX:
    """Return the direction from the hub to Q, in C: N_3 without its part along the axle."""
    return ca.vertcat(N_3[0], 0, N_3[2]) / sqrt(N_3[0] ** 2 + N_3[2] ** 2)


def _stage(law: Callable[[Signals], Signals], inputs: str) -> ca.Function:
    """Return a function with the name of a law."""
    name, names = law.__name__.removeprefix("_"), inputs.split()
    symbols = {n: SX.sym(n, *_shape(n)) for n in names}
    signals = law(symbols)
    return ca.Function(name, list(symbols.values()), list(signals.values()), names, list(signals))


def _shape(name: str) -> tuple[int, int]:
    if name == "inertias":
        return 3, 12
    if name in _SHAPES or name.startswith(("omega", "vG")):
        return _SHAPES.get(name, 3), 1
    return (3, 3) if name[0] in "RCJWV" else (1, 1)


def _rate(expression: SX, s: Signals, names: str) -> SX:
    """Return the time derivative of a matrix of named signals (chain rule)."""
    symbols = ca.veccat(*(s[name] for name in names.split()))
    rates = ca.veccat(*(s[f"{name}_dot"] for name in names.split()))
    return ca.reshape(ca.jtimes(ca.vec(expression), symbols, rates), expression.shape)


def _geometry(s: Signals) -> Geometry:
    return Geometry(*ca.vertsplit(s["geometry"]))


def _rear_frame_rates(s: Signals) -> tuple[SX, SX]:
    """Return the parts of omega_B in B due to u_I and to u_D (Panel 10, tempMatrix2 and 4)."""
    sin_phi, cos_phi = sin(s["phi"]), cos(s["phi"])
    sin_theta, cos_theta = sin(s["theta"]), cos(s["theta"])
    due_to_I = ca.blockcat([[cos_theta, 0, 0], [0, 0, 0], [sin_theta, 0, 0]])
    due_to_D = ca.blockcat(
        [[-cos_phi * sin_theta, 0, 0], [sin_phi, 1, 0], [cos_phi * cos_theta, 0, 0]]
    )
    return due_to_I, due_to_D


def _entry(row: int, column: int) -> SX:
    """Return the matrix with a single one: a turn about axis `row` by speed number `column`."""
    return unit(row) @ unit(column).T
