"""Explicit ODEs of the double pendulum: unit quaternions, or the book's 3-1-3 angles."""

from math import pi

import casadi as ca
from casadi import SX, sin

from casadi_models import conditions, kane, rotations
from casadi_models.dae import Dae, Model
from casadi_models.double_pendulum import links, orientation
from casadi_models.double_pendulum.links import Link, Rod

NEAR_SINGULAR = 1e-6  # of sin(theta); below, rates of psi and phi lose more than six digits
Pair = tuple[SX, SX]  # of link 1 and link 2

# Turns components in L into components in E, the frame of the book's angles: the axes 1 agree,
# and axis 2 of E is z of L. The matrix is written out so that its zeros are exact.
TO_BOOK = rotations.quaternion_about(1, SX(-pi / 2))
BOOK_AXES = SX([[1, 0, 0], [0, 0, 1], [0, -1, 0]])


def quaternion() -> Dae:
    """Return the ODE in unit quaternions and body rates, regular everywhere: 14 states."""
    model = links.pendulum("quaternion", "unit quaternions")
    rod, (start_1, start_2) = links.parameters(model)
    w1, w2 = links.rate_states(model, 1, start_1), links.rate_states(model, 2, start_2)
    q1 = links.quaternion_states(model, 1, start_1, w1)
    q2 = links.quaternion_states(model, 2, start_2, w2)
    turns = (rotations.from_quaternion(q1), rotations.from_quaternion(q2))
    # R1^T R2 by a product of quaternions: cheaper than one of matrices
    relative = rotations.quaternion_product(orientation.conjugate(q1), q2)
    _motion(model, rod, (w1, w2), turns, rotations.from_quaternion(relative))
    norms = ca.vertcat(links.norm_error(q1), links.norm_error(q2))
    model.invariant("position_drift", ca.vertcat(q1, q2), norms, "quaternions have length 1")
    return model.freeze()


def euler_313() -> Dae:
    """Return the ODE in 3-1-3 angles with links along -2 (the book's), hanging regular: 12 states.

    Singular where axis 3 of a link's frame E is vertical, which needs a horizontal link.
    """
    return _euler("euler_313", 2, TO_BOOK, BOOK_AXES)


def euler_313_axial() -> Dae:
    """Return the ODE in 3-1-3 angles with links along -3, hanging singular: 12 states."""
    return _euler("euler_313_axial", 3, SX([1, 0, 0, 0]), SX.eye(3))


def _euler(formulation: str, axis: int, to_angles: SX, axes: SX) -> Dae:
    """Return the ODE in the angles of frames E1 and E2 that are fixed in the links.

    Args:
        formulation: Its name.
        axis: Axis of E against which the link points.
        to_angles: Unit quaternion that turns components in L into components in E.
        axes: Its matrix.
    """
    model = links.pendulum(formulation, f"3-1-3 angles, links along -{axis}")
    rod, starts = links.parameters(model)
    rates, turns, sines = [], [], []
    for link, start in enumerate(starts, start=1):
        rate = links.rate_states(model, link, start)
        angles = ca.vertcat(
            *(
                model.state(
                    f"{name}{link}",
                    "rad",
                    0.0,
                    f"3-1-3 angle {name} of link {link}",
                    nominal=10.0 if axis == 3 and name != "theta" else 1.0,  # they run on
                )
                for name in ("psi", "theta", "phi")
            )
        )
        model.derivative(angles, orientation.angle_rates(angles, axes @ rate))
        in_e = rotations.quaternion_product(start.quaternion, orientation.conjugate(to_angles))
        first = start.angles if axis == 3 else orientation.from_quaternion(in_e)
        model.start(
            angles,
            orientation.defined(first),
            f"common start of link {link} in 3-1-3 angles, which do not exist where sin(theta) "
            "is zero (the quaternion formulation is regular there)",
        )
        q = rotations.quaternion_product(orientation.to_quaternion(angles), to_angles)
        for part, value in zip("wxyz", ca.vertsplit(q), strict=True):
            model.output(f"q{link}_{part}", "1", value, links.quaternion_meaning(link, part))
        model.output(
            f"singularity_{link}",
            "1",
            sin(angles[1]),
            f"sin(theta{link}); psi{link} and phi{link} do not exist where it is zero",
        )
        sines.append(ca.fabs(sin(angles[1])))
        model.limit(
            sines[-1] - NEAR_SINGULAR,
            f"psi{link} and phi{link} exist: sin(theta{link}) is above {NEAR_SINGULAR:g} "
            "(the quaternion formulation is regular there)",
        )
        rates.append(rate)
        turns.append(rotations.body_fixed((3, 1, 3), angles, SX.zeros(3))[0] @ axes)
    _motion(model, rod, (rates[0], rates[1]), (turns[0], turns[1]), turns[0].T @ turns[1])
    conditions.watch_singularity(model, *sines)
    return model.freeze()


def _motion(model: Model, rod: Rod, rates: Pair, turns: Pair, relative: SX) -> None:
    """Add the equations of motion and the outputs.

    Args:
        model: Has the states, and the derivatives of the orientations.
        rod: Properties of a link.
        rates: w1 in L1 and w2 in L2.
        turns: R1 and R2, from L1 and L2 to N.
        relative: R1^T R2, from L2 to L1.
    """
    (w1, w2), (R1, R2) = rates, turns
    v1, v2 = ca.cross(w1, rod.centre), ca.cross(w2, rod.centre)  # of G1 against O, G2 against A
    v_O, v_A = SX.sym("v_O", 3), SX.sym("v_A", 3)  # held: O; link 2 against link 1 at A; in N
    # The momentum of link 2 is m 2 v1, kept in L1, plus m v2, kept in L2: no derivative of a
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
            kane.Inertia(in_1, rod.m * 2 * v1, w1),
            kane.Inertia(in_2, rod.m * v2, w2),
            kane.Inertia(w2, rod.inertia @ w2, w2),
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
    centre, velocity = R1 @ rod.centre, R1 @ v1
    upper = Link(R1, w1, centre, velocity)
    lower = Link(R2, w2, 2 * centre + R2 @ rod.centre, 2 * velocity + R2 @ v2)
    links.outputs(model, rod, (upper, lower))
