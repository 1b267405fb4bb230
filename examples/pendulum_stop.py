"""A pendulum that swings against a stop below its pivot and rebounds with a restitution.

Model   Mass point on a massless rod; Newton's law of restitution: theta' after = -e theta' before.
Source  Brogliato, Nonsmooth Mechanics, 2016, chapter 4 (impact oscillators).
"""

from casadi import SX, cos, sin

from casadi_models.dae import Dae, Model
from casadi_models.mechanics.contact import impact


def build() -> Dae:
    """Return the ODE: 2 states (angle and rate, rad and rad/s)."""
    model = Model("pendulum_stop", description="pendulum against a stop", stop_time=6.0)
    theta = model.state("theta", "rad", 2.0, "angle from hanging")
    rate = model.state("rate", "rad/s", 0.0, "rate of theta")
    m = model.parameter("m", "kg", 0.5, "mass", positive=True)
    length = model.parameter("length", "m", 0.4, "length of the rod", positive=True)
    g = model.parameter("g", "m/s2", 9.81, "gravity")
    stop = model.parameter("stop", "rad", 0.0, "angle at the stop")
    e = model.parameter("e", "1", 0.8, "restitution", minimum=0.0, maximum=1.0)
    model.derivative(theta, rate)
    model.derivative(rate, -g / length * sin(theta))
    impact(model, theta < stop, rate, m * length**2, SX(1), e, name="stop")
    model.energies(m * (length * rate) ** 2 / 2, m * g * length * (1 - cos(theta)))
    return model.freeze()
