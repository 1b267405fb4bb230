"""The double pendulum as two free bodies held by ball joints: an index-1 DAE."""

from collections.abc import Callable
from functools import partial

import casadi as ca
from casadi import SX

from casadi_models.dae import Dae
from casadi_models.dae.expressions import column
from casadi_models.double_pendulum import links
from casadi_models.double_pendulum.links import Link
from casadi_models.mechanics import conditions, kane, rotations

CLOSING_RATE = 1.0  # 1/s; at 0 gaps grow, at 5 and more they cost energy: docs/drift.md
GAP_LIMIT = 1e-3  # m


def build() -> Dae:
    """Return the DAE with joint forces as multipliers: 26 states, 16 algebraic unknowns."""
    model = links.FAMILY.formulation(
        "multipliers", "two free bodies, joint forces are the multipliers"
    )
    rod, starts = links.parameters(model)
    w1, w2 = (links.rate_states(model, i, start) for i, start in enumerate(starts, start=1))
    q1 = links.quaternion_states(model, 1, starts[0], w1)
    q2 = links.quaternion_states(model, 2, starts[1], w2)
    r1, r2 = (_vector(model.state, f"{{}}_G{i}", "m", f"G{i}: place along") for i in (1, 2))
    v1, v2 = (_vector(model.state, f"v{{}}_G{i}", "m/s", f"G{i}: velocity along") for i in (1, 2))
    large = partial(model.algebraic, nominal=30.0)
    v1_dot, v2_dot = (
        _vector(large, f"v{{}}_G{i}_dot", "m/s2", f"G{i}: acceleration along") for i in (1, 2)
    )
    w1_dot, w2_dot = (  # across the link only
        _vector(large, f"w{i}_{{}}_dot", "rad/s2", f"link {i}: rate of w{i} along", "xy")
        for i in (1, 2)
    )
    forces = [model.algebraic(n, "N", 0.0, text, nominal=30.0) for n, text in links.JOINT_FORCES]

    # The direction cosines serve as coordinates (Poisson: R' = R [w]); in the end they become
    # those of the quaternions. From G, -s leads to the upper end of the link and s to the lower.
    R1, R2 = SX.sym("R1", 3, 3), SX.sym("R2", 3, 3)
    s1, s2 = R1 @ rod.center, R2 @ rod.center
    s1_dot, s2_dot = R1 @ ca.cross(w1, rod.center), R2 @ ca.cross(w2, rod.center)
    gaps = ca.vertcat(r1 - s1, (r2 - s2) - (r1 + s1))  # at O and at A
    gap_rates = ca.vertcat(v1 - s1_dot, (v2 - s2_dot) - (v1 + s1_dot))
    system = kane.System(
        q=ca.vertcat(ca.vec(R1), ca.vec(R2)),
        q_dot=ca.vertcat(ca.vec(R1 @ ca.skew(w1)), ca.vec(R2 @ ca.skew(w2))),
        free=ca.vertcat(v1, v2, w1[:2], w2[:2]),
        # Euler's third equation: axisymmetric links, and no force has a moment about their axis
        prescribed=ca.vertcat(w1[2], w2[2]),
        prescribed_dot=SX.zeros(2),
        inertias=(
            kane.InertialTerm(v1, rod.m * v1),
            kane.InertialTerm(v2, rod.m * v2),
            kane.InertialTerm(w1, rod.inertia @ w1, w1),
            kane.InertialTerm(w2, rod.inertia @ w2, w2),
        ),
        loads=(kane.Load(v1 + v2, rod.weight),),
        constraints=gap_rates,
    )
    accelerations = ca.vertcat(v1_dot, v2_dot, w1_dot, w2_dot)
    residual = kane.multiplier_equations(system, accelerations, ca.vertcat(*forces))
    rate = model.closing_rate(CLOSING_RATE)
    closing = 2 * rate * gap_rates + rate**2 * gaps
    residual += ca.vertcat(SX.zeros(accelerations.numel()), closing)

    turns = [rotations.from_quaternion(q1), rotations.from_quaternion(q2)]
    jacobian = kane.constraint_matrix(system)
    residual, jacobian, gaps, gap_rates, s1, s2, s1_dot, s2_dot = ca.substitute(
        [residual, jacobian, gaps, gap_rates, s1, s2, s1_dot, s2_dot], [R1, R2], turns
    )
    model.equation(residual)
    model.limit(GAP_LIMIT - ca.norm_inf(gaps), f"the joints are closed to within {GAP_LIMIT:g} m")
    model.derivative(ca.vertcat(r1, r2, v1, v2), ca.vertcat(v1, v2, v1_dot, v2_dot))
    model.derivative(ca.vertcat(w1, w2), ca.vertcat(w1_dot, 0, w2_dot, 0))
    model.start(ca.vertcat(r1, r2), ca.vertcat(s1, 2 * s1 + s2), "closed joints")
    model.start(ca.vertcat(v1, v2), ca.vertcat(s1_dot, 2 * s1_dot + s2_dot), "closed joints")
    norms = ca.vertcat(links.norm_error(q1), links.norm_error(q2))
    places, speeds = ca.vertcat(q1, q2, r1, r2), system.free
    closed = "the joints are closed"
    model.invariant(
        "position_drift", places, ca.vertcat(norms, gaps), f"{closed}, quaternions have length 1"
    )
    mass = kane.mass_matrix(system)
    sizes = conditions.equal_energies(mass)
    model.invariant("velocity_drift", speeds, gap_rates, f"{closed} and stay so", sizes=sizes)
    conditions.watch_masses(model, mass)
    conditions.watch_constraints(model, jacobian, mass)
    links.outputs(model, rod, (Link(turns[0], w1, r1, v1), Link(turns[1], w2, r2, v2)))
    return model.freeze()


def _vector(
    declare: Callable[[str, str, float, str], SX],
    name: str,
    unit: str,
    meaning: str,
    axes: str = "xyz",
) -> SX:
    return column(declare(name.format(axis), unit, 0.0, f"{meaning} {axis}") for axis in axes)
