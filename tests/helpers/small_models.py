"""Models that are exported in less than a second."""

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


def late() -> Dae:
    """Return x' = u - k x, w' = -w, v' = u / 10, whose starts follow from when and where it begins.

    x = 2 u + t v,  w^3 + w = u x + t + v + k
    """
    model = Model("late", description="starts of time and inputs", stop_time=1.0)
    x, w, v = (model.state(n, "m", start, n) for n, start in (("x", 0.0), ("w", 0.3), ("v", 0.5)))
    u = model.input("u", "m", 0.5, "target")
    k = model.parameter("k", "1/s", 2.0, "rate")
    model.derivative(x, u - k * x)
    model.derivative(w, -w)
    model.derivative(v, 0.1 * u)
    model.start(x, 2 * u + model.t * v, "law of x")
    model.start_equation(w, w**3 + w - u * x - model.t - v - k, "law of w")
    model.output("y", "m", x + w, "sum")
    return model.freeze()


def table() -> Dae:
    """Return outputs of time and an input, without a state."""
    model = Model("table", description="no state", source="a test", stop_time=1.0)
    gain = model.parameter("gain", "1", 3.0, "gain")
    push = model.input("push", "1", 0.5, "push")
    model.output("y", "1", gain * push + model.t, "result")
    return model.freeze()


def growing() -> Dae:
    """Return x' = x^2 + u: infinite at 1 / x(0) where u is 0."""
    model = Model("growing", stop_time=2.0)
    x = model.state("x", "1", 1.0, "what grows")
    u = model.input("u", "1/s", 0.0, "push")
    model.derivative(x, x**2 + u)
    model.output("twice", "1", 2 * x + u, "output of state and input")
    model.limit(0.7 - x, "x stays below 0.7")
    return model.freeze()


def ball() -> Dae:
    """Return a ball that is dropped from 1 m and bounces back with 0.7 of its speed."""
    model = Model("ball", stop_time=1.5)
    h, v = model.state("h", "m", 1.0, "height"), model.state("v", "m/s", 0.0, "speed")
    model.derivative(h, v)
    model.derivative(v, -9.81)
    model.when(h < 0, {v: -0.7 * v})
    return model.freeze()
