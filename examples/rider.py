"""Rider who balances the bicycle with torques: state feedback through a first-order muscle lag.

The gains are those of a linear-quadratic regulator for the benchmark bicycle at 3.5 m/s. Without a
rider, it falls at this speed (its weave mode is unstable below 4.292 m/s).
"""

import casadi as ca

from casadi_models.dae import Dae, Model

# N.m/rad and N.m.s/rad on phi, delta, phi_dot, delta_dot
STEER_GAINS = (-22.88, 18.26, -5.68, 1.75)
ROLL_GAINS = (10.08, -6.73, 2.73, -0.63)


def build() -> Dae:
    """Return the ODE: 2 states; its inputs are outputs of the bicycle, its outputs are torques."""
    model = Model("rider", description="rider: state feedback behind a muscular lag")
    measured = ca.vertcat(
        model.input("phi", "rad", 0.0, "roll angle"),
        model.input("delta", "rad", 0.0, "steer angle"),
        model.input("phi_dot", "rad/s", 0.0, "roll rate"),
        model.input("delta_dot", "rad/s", 0.0, "steer rate"),
    )
    lag = model.parameter("lag", "s", 0.03, "time constant of the muscles", positive=True)
    for name, gains in (("steer", STEER_GAINS), ("roll", ROLL_GAINS)):
        torque = model.state(f"{name}_effort", "N.m", 0.0, f"{name} torque after the lag")
        command = -ca.dot(ca.DM(gains), measured)
        model.derivative(torque, (command - torque) / lag)
        model.output(f"{name}_torque", "N.m", torque, f"{name} torque on the bicycle")
    return model.freeze()
