"""A block on a moving belt, held by a spring: it sticks to the belt, tears off and slips back.

Model   Coulomb's law with a larger coefficient at rest: m x'' = -k x + F.
Source  Den Hartog, Mechanical Vibrations, 1956, section 7.6 (friction with two coefficients).
"""

from casadi_models.dae import Dae, Model
from casadi_models.mechanics.contact import friction_in_plane


def build() -> Dae:
    """Return the ODE: 2 states (place and speed, m and m/s) and the modes of the friction."""
    model = Model("belt", description="stick-slip on a belt", stop_time=30.0)
    x = model.state("x", "m", 0.0, "place of the block; the spring is relaxed at 0")
    v = model.state("v", "m/s", 0.1, "speed of the block")
    m = model.parameter("m", "kg", 1.0, "mass", positive=True)
    k = model.parameter("k", "N/m", 4.0, "stiffness", positive=True)
    belt = model.parameter("belt", "m/s", 0.1, "speed of the belt")
    sticking = model.parameter("sticking", "1", 0.08, "coefficient of friction at rest")
    sliding = model.parameter("sliding", "1", 0.04, "coefficient of sliding friction")
    g = model.parameter("g", "m/s2", 9.81, "gravity")
    force = friction_in_plane(model, v, m, v - belt, -k * x, m * g, sliding, sticking=sticking)
    model.derivative(x, v)
    model.derivative(v, (-k * x + force) / m)
    model.output("friction", "N", force, "force of the belt on the block")
    return model.freeze()
