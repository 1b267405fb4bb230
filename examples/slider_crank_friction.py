"""A slider-crank whose slider rubs on its guide: the crank runs down and sticks.

          B           crank OB turns by phi, rod BC carries the slider C at s
         / `-.        mass of the rod at its ends; no gravity
        O ----- C     F = -mu N sign(s'): dry friction of a slider that is pressed by a force N

Source  Haug, Computer Aided Kinematics and Dynamics, 1989 (slider-crank).
"""

from casadi import SX, cos, jacobian, jtimes, sin, sqrt

from casadi_models.dae import Dae, Model
from casadi_models.mechanics.contact import friction


def build() -> Dae:
    """Return the ODE: 2 states (angle and rate of the crank, rad and rad/s)."""
    model = Model("slider_crank_friction", description="slider with dry friction", stop_time=3.0)
    phi = model.state("phi", "rad", 0.5, "angle of the crank")
    omega = model.state("omega", "rad/s", 12.0, "rate of phi")
    r = model.parameter("r", "m", 0.1, "length of the crank", positive=True)
    rod = model.parameter("rod", "m", 0.3, "length of the rod", positive=True)
    inertia = model.parameter("inertia", "kg.m2", 0.01, "of the crank", positive=True)
    m = model.parameter("m", "kg", 1.0, "mass of the slider", positive=True)
    mu = model.parameter("mu", "1", 0.2, "coefficient of friction", minimum=0.0)
    pressing = model.parameter("pressing", "N", 20.0, "normal force", minimum=0.0)
    s = r * cos(phi) + sqrt(rod**2 - (r * sin(phi)) ** 2)
    lever = jacobian(s, phi)  # s' = lever omega
    mass = inertia + m * lever**2
    force = friction(lever * omega, pressing, mu)
    model.derivative(phi, omega)
    bent = m * lever * jtimes(lever, phi, omega) * omega
    model.derivative(omega, (lever * force - bent) / mass)
    model.output("s", "m", s, "place of the slider")
    model.output("friction", "N", force, "force of the guide on the slider")
    model.energies(mass * omega**2 / 2, SX(0))
    return model.freeze()
