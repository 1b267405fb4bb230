"""The double pendulum in 3-1-3 angles of a frame fixed in each link: an explicit ODE."""

import casadi as ca
from casadi import SX, sin

from casadi_models.dae import Dae
from casadi_models.dae.expressions import column
from casadi_models.double_pendulum import links, orientation
from casadi_models.double_pendulum.equations import add_motion
from casadi_models.mechanics import conditions, rotations

NEAR_SINGULAR = 1e-6  # of sin(theta); below, rates of psi and phi lose more than six digits


def in_angles(formulation: str, axis: int, to_angles: SX, axes: SX) -> Dae:
    """Return the ODE in the angles of frames E1 and E2 that are fixed in the links.

    Args:
        formulation: Its name.
        axis: Axis of E against which the link points.
        to_angles: Unit quaternion that turns components in L into components in E.
        axes: Its matrix.
    """
    model = links.FAMILY.formulation(formulation, f"3-1-3 angles, links along -{axis}")
    rod, starts = links.parameters(model)
    own_frame = f"angles of a frame in which the link points along -{axis}"
    rates, turns, sines = [], [], []
    for link, start in enumerate(starts, start=1):
        rate = links.rate_states(model, link, start)
        angles = column(
            model.state(
                f"{name}{link}",
                "rad",
                0.0,
                f"3-1-3 angle {name} of link {link}",
                nominal=10.0 if axis == 3 and name != "theta" else 1.0,  # they run on
                own_meaning=own_frame,
            )
            for name in ("psi", "theta", "phi")
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
            own_meaning=own_frame,
        )
        sines.append(ca.fabs(sin(angles[1])))
        model.limit(
            sines[-1] - NEAR_SINGULAR,
            f"psi{link} and phi{link} exist: sin(theta{link}) is above {NEAR_SINGULAR:g} "
            "(the angles are singular; the quaternion formulation is regular there)",
        )
        rates.append(rate)
        turns.append(rotations.body_fixed((3, 1, 3), angles, SX.zeros(3))[0] @ axes)
    add_motion(model, rod, (rates[0], rates[1]), (turns[0], turns[1]), turns[0].T @ turns[1])
    conditions.watch_singularity(model, *sines)
    return model.freeze()
