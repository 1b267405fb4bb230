"""Models of sessions, of which each has something that a saved state must hold."""

from helpers.event_models import ball, sampled
from helpers.small_models import decay

from casadi_models.dae import Model


def driven_ball():
    """Return the bouncing ball with a force, a discrete count and a sampled controller."""
    model = Model("driven_ball", stop_time=2.0)
    h, v = model.state("h", "m", 1.0, "height"), model.state("v", "m/s", 0.0, "speed")
    n, pull = model.discrete("n", "1", 0, "impacts"), model.discrete("pull", "N", 0.0, "control")
    wind = model.input("wind", "N", 0.0, "force")
    model.derivative(h, v)
    model.derivative(v, -9.81 + wind + pull)
    model.when(h < 0, {v: -0.7 * v, n: n + 1}, name="impact")
    model.every(0.13, {pull: -0.5 * v}, name="control", offset=0.05)
    return model.freeze()


MODELS = {"decay": decay, "ball": ball, "sampled": sampled, "driven_ball": driven_ball}
