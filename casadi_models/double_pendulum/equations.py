"""Equations of motion of the explicit formulations, in body rates."""

import casadi as ca
from casadi import SX

from casadi_models.dae import Model
from casadi_models.double_pendulum import links
from casadi_models.double_pendulum.links import Link, Rod
from casadi_models.mechanics import conditions, kane

Pair = tuple[SX, SX]  # of link 1 and link 2


def add_motion(model: Model, rod: Rod, rates: Pair, turns: Pair, relative: SX) -> None:
    """Add the equations of motion and the outputs.

    Args:
        model: Has the states, and the derivatives of the orientations.
        rod: Properties of a link.
        rates: w1 in L1 and w2 in L2.
        turns: R1 and R2, from L1 and L2 to N.
        relative: R1^T R2, from L2 to L1.
    """
    (w1, w2), (R1, R2) = rates, turns
    v1, v2 = ca.cross(w1, rod.center), ca.cross(w2, rod.center)  # of G1 against O, G2 against A
    v_O, v_A = SX.sym("v_O", 3), SX.sym("v_A", 3)  # held: O; link 2 against link 1 at A; in N
    # The momentum of link 2 is m 2 v1, in L1, plus m v2, in L2: no derivative of a
    # rotation is needed, only the whole velocity of G2 is written in both frames.
    in_1 = R1.T @ (v_O + v_A) + 2 * v1 + relative @ v2
    in_2 = R2.T @ (v_O + v_A) + relative.T @ (2 * v1) + v2
    system = kane.System(
        q=SX(0, 1),  # no momentum depends on the orientation
        q_dot=SX(0, 1),
        free=ca.vertcat(w1[:2], w2[:2]),
        # Euler's third equation: axisymmetric links, and no force has a moment about their axis
        prescribed=ca.vertcat(w1[2], w2[2]),
        prescribed_dot=SX.zeros(2),
        held=ca.vertcat(v_O, v_A),
        inertias=(
            *kane.body(rod.m, rod.inertia, R1.T @ v_O + v1, w1),
            kane.InertialTerm(in_1, rod.m * 2 * v1, w1),
            kane.InertialTerm(in_2, rod.m * v2, w2),
            kane.InertialTerm(w2, rod.inertia @ w2, w2),
        ),
        loads=(
            kane.Load(3 * v1, R1.T @ rod.weight),  # at G1, and at A, which moves twice as fast
            kane.Load(v2, R2.T @ rod.weight),
            kane.Load(2 * v_O + v_A, rod.weight),
        ),
    )
    solution = kane.accelerations(system)
    motion = solution.free
    conditions.watch_masses(model, solution.mass)
    model.derivative(w1, ca.vertcat(motion[:2], 0))
    model.derivative(w2, ca.vertcat(motion[2:], 0))

    forces = kane.reactions(system, motion)[2:]  # those of w1_z and w2_z vanish
    for (name, meaning), force in zip(links.JOINT_FORCES, ca.vertsplit(forces), strict=True):
        model.output(name, "N", force, meaning, nominal=30.0)
    center, velocity = R1 @ rod.center, R1 @ v1
    upper = Link(R1, w1, center, velocity)
    lower = Link(R2, w2, 2 * center + R2 @ rod.center, 2 * velocity + R2 @ v2)
    links.outputs(model, rod, (upper, lower))
