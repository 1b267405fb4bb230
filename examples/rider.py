"""A rider who balances the bicycle by torques: state feedback behind a muscular lag.

The gains are those of a linear-quadratic regulator for the benchmark bicycle at 3.5 m/s, where the
free bicycle falls (its weave is unstable below 4.292 m/s).
"""

import casadi as ca

from casadi_models.dae import Dae, Model

# N.m/rad and N.m.s/rad on phi, delta, phi_dot, delta_dot
STEER_GAINS = (-22.88, 18.26, -5.68, 1.75)
ROLL_GAINS = (10.08, -6.73, 2.73, -0.63)


def build() -> Dae:
    """Return the rider: inputs are the bicycle's outputs, outputs are its torques; 2 states."""
    model = Model("rider", description="rider: state feedback behind a muscular lag")
    seen = ca.vertcat(
        model.input("phi", "rad", 0.0, "roll angle"),
        model.input("delta", "rad", 0.0, "steer angle"),
        model.input("phi_dot", "rad/s", 0.0, "roll rate"),
        model.input("delta_dot", "rad/s", 0.0, "steer rate"),
    )
    lag = model.parameter("lag", "s", 0.03, "time constant of the muscles", positive=True)
    for name, gains in (("steer", STEER_GAINS), ("roll", ROLL_GAINS)):
        torque = model.state(f"{name}_effort", "N.m", 0.0, f"{name} torque after the lag")
        wanted = -ca.dot(ca.DM(gains), seen)
        model.derivative(torque, (wanted - torque) / lag)
        model.output(f"{name}_torque", "N.m", torque, f"{name} torque on the bicycle")
    return model.freeze()
