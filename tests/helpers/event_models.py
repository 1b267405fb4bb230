"""Models with events whose motion has a closed form, and one with every kind of event."""

from pathlib import Path

import casadi as ca
from helpers.toy import GUID

import cosim
from casadi_models.dae import Dae, Model
from cosim.fmi.export.options import FmuOptions
from cosim.fmi.export.package import source_files

TEXT_SIZE = 512  # of the runtime's messages, in bytes
G, RESTITUTION, RATE = 9.81, 0.7, 4.0
FIXED = ("ode8", "rk4")
SOLVERS = ("dop853", *FIXED, "erk", "rosenbrock", "cvodes", "cvodes_adams", "idas")


def simulate(
    dae: Dae, solver: str = "dop853", tolerance: float = 1e-10, **options: object
) -> cosim.Trajectory:
    """Simulate with a relative tolerance, or with the solver's default step if that is fixed."""
    if solver not in FIXED:
        options["relative_tolerance"] = tolerance
    return cosim.simulate(dae, solver=solver, **options)


def ball(stop_time: float = 2.0) -> Dae:
    """Return a ball that is dropped from 1 m and bounces."""
    model = Model("ball", stop_time=stop_time)
    h = model.state("h", "m", 1.0, "height")
    v = model.state("v", "m/s", 0.0, "speed")
    n = model.discrete("n", "1", 0, "number of impacts")
    model.derivative(h, v)
    model.derivative(v, -G)
    model.when(h < 0, {v: -RESTITUTION * v, n: n + 1}, name="impact")
    return model.freeze()


def oscillator(speed: float = 600.0) -> Dae:
    """Return one without damping, at `speed` rad/s, whose passages upwards are counted."""
    model = Model("oscillator", stop_time=2.0)
    x = model.state("x", "m", 0.1, "place")
    v = model.state("v", "m/s", 0.0, "speed")
    n = model.discrete("n", "1", 0, "number of passages")
    model.derivative(x, v)
    model.derivative(v, -(speed**2) * x)
    model.when(x > 0, {n: n + 1}, name="up")
    return model.freeze()


def late() -> Dae:
    """Return a model in which x becomes 5 and n becomes 16 at the stop time itself."""
    model = Model("late", stop_time=2.0, output_interval=0.1)
    n, x = model.discrete("n", "1", 0.0, "samples"), model.state("x", "1", 0.0, "x")
    model.derivative(x, 0)
    model.every(0.13, {n: n + 1}, offset=0.05)  # 0.05 + 15 * 0.13 = 2, but for rounding
    model.when(model.t > 2, {x: 5})
    return model.freeze()


def pulse(width: float) -> Dae:
    """Return a mass of 1 kg that 1000 N push from 5 s on."""
    model = Model("pulse", stop_time=10.0, output_interval=0.1)
    v = model.state("v", "m/s", 0.0, "speed")
    pushed = ca.logic_and(model.t >= 5, model.t < 5 + width)
    model.derivative(v, ca.if_else(pushed, 1000, 0))
    return model.freeze()


def square_wave() -> Dae:
    """Return the integral of 1 in the first 0.1 s of every 0.655 s and of -0.2 later: 0.002 s."""
    model = Model("square_wave", stop_time=2.0)
    x = model.state("x", "s", 0.0, "integral")
    model.derivative(x, ca.if_else(ca.fmod(model.t, 0.655) < 0.1, 1, -0.2))
    return model.freeze()


def falling() -> Dae:
    """Return a single state that goes from 1 through 0 at 2/3 s, more slowly then, to -2/3."""
    model = Model("falling", stop_time=2.0)
    x = model.state("x", "1", 1.0, "a state")
    model.derivative(x, -1 - 0.5 * ca.sign(x))
    return model.freeze()


def draining(form: str) -> Dae:
    """Return x' = -1 - sqrt(x) from 1 to x = 0 at 2 (1 - ln 2) s, and x' = -1 from there."""
    model = Model("draining", stop_time=2.0)
    x = model.state("x", "1", 1.0, "a state")
    forms = {
        "fmax": lambda: ca.sqrt(ca.fmax(x, 0)),
        "if_else": lambda: ca.if_else(x > 0, ca.sqrt(x), 0),
        "power": lambda: (0.5 * (x + ca.fabs(x))) ** 0.5,
    }
    model.derivative(x, -1 - forms[form]())
    return model.freeze()


DRAINED = -2 + 2 * (1 - ca.log(2))  # at 2 s


def rectified() -> Dae:
    """Return the integral of fmax(0, sin t), 4 after two periods."""
    model = Model("rectified", stop_time=4 * ca.pi, output_interval=ca.pi / 50)
    y = model.state("y", "s", 0.0, "integral")
    model.derivative(y, ca.fmax(0, ca.sin(model.t)))
    return model.freeze()


def sampled() -> Dae:
    """Return a state that a sampled controller multiplies by 0.8 every 0.1 s."""
    model = Model("sampled", stop_time=2.0, output_interval=0.05)
    x = model.state("x", "m", 1.0, "place")
    u = model.discrete("u", "m/s", 0.0, "control")
    model.derivative(x, u)
    model.every(0.1, {u: -2 * x}, name="control")
    return model.freeze()


def counting(hundredths: int) -> Dae:
    """Return a motion at 1 m/s, and a number of samples that output times coincide with."""
    model = Model("counting", stop_time=3.0, output_interval=0.01)
    x, n = model.state("x", "m", 0.0, "place"), model.discrete("n", "1", 0.0, "number")
    model.derivative(x, 1.0)
    model.every(hundredths / 100, {n: n + 1}, name="sample")
    return model.freeze()


def holding() -> Dae:
    """Return a motion at 1 m/s; y holds an input at samples, of which n is the number."""
    model = Model("holding", stop_time=2.0)
    x, u = model.state("x", "m", 0.0, "place"), model.input("u", "1", 0.0, "input")
    n, y = model.discrete("n", "1", 0.0, "number"), model.discrete("y", "1", 0.0, "held")
    period = model.parameter("period", "s", 0.25, "period", minimum=0.01)
    model.derivative(x, 1.0)
    model.every(period, {n: n + 1, y: u}, name="sample")
    return model.freeze()


def humming() -> Dae:
    """Return a motion at 1 m/s over 1000 s with an output at 100 rad/s."""
    model = Model("humming", stop_time=1000.0)
    x = model.state("x", "m", 0.0, "place")
    model.derivative(x, 1.0)
    model.output("y", "1", ca.sin(100 * x), "sine")
    return model.freeze()


def swinging() -> Dae:
    """Return the integral of cos t, and sin t as an output."""
    model = Model("swinging", stop_time=10.0)
    x = model.state("x", "s", 0.0, "integral")
    model.derivative(x, ca.cos(model.t))
    model.output("y", "1", ca.sin(model.t), "sine")
    return model.freeze()


def stopping() -> Dae:
    """Return a motion at 1 m/s that ends at 0.777 m."""
    model = Model("stopping", stop_time=2.0)
    x = model.state("x", "m", 0.0, "place")
    model.derivative(x, 1.0)
    model.stop(x > 0.777, "the wall is reached")
    return model.freeze()


def block(*, branches: bool = False) -> Dae:
    """Return a block at 3 m/s that dry friction of 4 m/s2 stops; by sign, or by branches."""
    model = Model("block", stop_time=2.0)
    x = model.state("x", "m", 0.0, "place")
    v = model.state("v", "m/s", 3.0, "speed")
    friction = RATE * (ca.if_else(v > 0, 1, -1) if branches else ca.sign(v))
    model.derivative(x, v)
    model.derivative(v, -friction)
    model.output("friction", "N", friction, "friction per mass")
    return model.freeze()


def glimpses() -> Dae:
    """Return the time for which cos(20 t) is above 0.9999."""
    model = Model("glimpses", stop_time=3.0)
    x = model.state("x", "m", 1.0, "place")
    v = model.state("v", "m/s", 0.0, "speed")
    y = model.state("y", "s", 0.0, "time above")
    model.derivative(x, v)
    model.derivative(v, -400 * x)
    model.derivative(y, ca.if_else(x > 0.9999, 1, 0))
    return model.freeze()


def everything(*, slides: bool = True) -> Dae:
    """Return a DAE with state and time events, samples, a stop, an input, and perhaps sliding."""
    model = Model("everything", stop_time=5.0)
    x = model.state("x", "m", 0.3, "place")
    v = model.state("v", "m/s", 1.0, "speed")
    a = model.algebraic("a", "m/s2", 0.0, "acceleration")
    n = model.discrete("n", "1", 0, "number of impacts")
    u = model.input("u", "N", 0.0, "force")
    mu = model.parameter("mu", "N", 0.3, "friction", minimum=0.0)
    more = ca.if_else(ca.sin(3 * model.t) > 0.5, 1, 0) + ca.floor(2 * x) * 0.1
    model.derivative(x, v)
    model.derivative(v, a)
    model.equation(a + x - u + mu * (ca.sign(v) if slides else v) - more)
    model.when(x > 1, {v: -0.5 * v, n: n + 1}, name="impact")
    model.every(0.3, {n: n + 0.001})
    model.stop(n > 20, "enough")
    model.output("power", "W", a * v, "power per mass")
    return model.freeze()


def left() -> Dae:
    """Return x' = 1 with the force 100 max(0.3 - u - x, 0) of a spring that an input leaves."""
    model = Model("left", stop_time=1.0)
    x, u = model.state("x", "m", 0.0, "place"), model.input("u", "m", 0.0, "place of the other")
    w, force = model.state("w", "N.s", 0.0, "impulse"), 100 * ca.fmax(0.3 - u - x, 0)
    model.derivative(x, 1.0)
    model.derivative(w, force)
    model.output("force", "N", force, "force of the spring")
    return model.freeze()


def pole() -> Dae:
    """Return x' = -1 / y; n counts when |x| falls below 0.1."""
    model = Model("pole", stop_time=1.0)
    x, y = model.state("x", "1", 1.0, "a state"), model.state("y", "1", 1.0, "another")
    n = model.discrete("n", "1", 0, "number")
    model.derivative(x, -1 / y)
    model.derivative(y, -0.5)
    model.when(x * x < 0.01, {n: n + 1})
    model.limit(x + 5, "x above -5")
    model.limit(y + 1, "é" * TEXT_SIZE)
    return model.freeze()


def pushed_block() -> Dae:
    """Return a block at rest, held by dry friction that has no value beyond 1 m."""
    model = Model("pushed_block", stop_time=1.0)
    x, v = model.state("x", "m", 0.0, "place"), model.state("v", "m/s", 0.0, "speed")
    model.derivative(x, v)
    model.derivative(v, 1 - RATE * ca.sign(v) * ca.sqrt(1 - x))
    return model.freeze()


def limited(count: int = 1) -> Dae:
    """Return a motion at 1 m/s with a limit every 0.1 m."""
    model = Model("limited", stop_time=1.0)
    x = model.state("x", "m", 0.0, "place")
    model.derivative(x, 1.0)
    for k in range(1, count + 1):
        model.limit(k / 10 - x, f"x below {k} dm")
    return model.freeze()


def stuck() -> Dae:
    """Return a body of 1 kg at rest, which a force pushes and dry friction holds."""
    model = Model("stuck", stop_time=1.0)
    v, u = model.state("v", "m/s", 0.0, "speed"), model.input("u", "N", 0.1, "force")
    mu = model.parameter("mu", "N", 0.3, "most friction", minimum=0.0)
    model.derivative(v, u - mu * ca.sign(v))
    model.output("friction", "N", mu * ca.sign(v), "friction")
    return model.freeze()


def write(folder: Path, dae: Dae, solver: str, *, fmi: int, most_trials: int) -> None:
    """Write the generated files of an exported model under the toy's GUID, and its solver's files.

    Args:
        folder: An existing one.
        dae: The model.
        solver: Solver of co-simulation.
        fmi: Version of FMI.
        most_trials: Largest number of dop853's steps, or of other solvers' looks, in a call.
    """
    files = source_files(dae, FmuOptions(fmi=fmi, solver=solver))
    code = {Path(path).name: content.decode() for path, content in files.items()
            if path.startswith("sources/") and Path(path).name in _GENERATED}  # fmt: skip
    header = code["model.h"].splitlines()
    limited = [line for line in header if "MOST_TRIALS" not in line and "MODEL_GUID" not in line]
    limited[-1:-1] = [f"#define MOST_TRIALS {most_trials}", f'#define MODEL_GUID "{GUID}"']
    code["model.h"] = "\n".join(limited) + "\n"
    for name, text in code.items():
        (folder / name).write_text(text)


_GENERATED = ("model.h", "tables.h", "equations.c", "dop853_coefficients.h")
