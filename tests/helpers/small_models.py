"""Models small enough to export in a blink."""

from casadi_models.dae import Dae, Model


def decay(name: str = "decay", *, rate: float = 0.5) -> Dae:
    """Return x' = force - rate x with y = 2 x."""
    model = Model(name, description="decay", source="a test", stop_time=1.0)
    x = model.state("x", "m", 1.0, "place")
    force = model.input("force", "m/s", 0.0, "push")
    k = model.parameter("rate", "1", rate, "rate of decay", minimum=0.0, maximum=100.0)
    model.derivative(x, force - k * x)
    model.output("y", "m", 2 * x, "twice the place")
    return model.freeze()


def table() -> Dae:
    """Return outputs of time and an input, without a state."""
    model = Model("table", description="no state", source="a test", stop_time=1.0)
    gain = model.parameter("gain", "1", 3.0, "gain")
    push = model.input("push", "1", 0.5, "push")
    model.output("y", "1", gain * push + model.t, "result")
    return model.freeze()
