"""Random hybrid models: a few structures whose numbers are drawn, each with its exact course.

All numbers are parameters or start values, so that a structure is compiled once.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from random import Random

import casadi as ca
import numpy as np
from helpers.linear_hybrid import Contact, Course, Every, LinearHybrid, TooManyEvents, When

import cosim
from casadi_models.dae import Dae

STOP = 3.0  # s
ENOUGH = 1e-3  # margin and gap of a course that every solver sees alike


@dataclass(frozen=True)
class Family:
    """Models of one structure.

    Args:
        names: Of states and discrete variables, as in y.
        build: Gives a model its equations, with the numbers as parameters.
        numbers: Draws start values and parameters.
        law: The same equations as matrices.
    """

    names: tuple[str, ...]
    build: Callable[[cosim.Model, Callable[[str], ca.SX]], None]
    numbers: Callable[[Random], dict[str, float]]
    law: Callable[[dict[str, float]], LinearHybrid]


def _vector(size: int, **entries: float) -> np.ndarray:
    """Return a vector of zeros but for entries by position, as `_3=0.5`."""
    row = np.zeros(size)
    for place, value in entries.items():
        row[int(place[1:])] = value
    return row


def _assigning(size: int, **rows: np.ndarray) -> np.ndarray:
    """Return the identity but for rows by position."""
    new = np.eye(size)
    for place, row in rows.items():
        new[int(place[1:])] = row
    return new


def _with_sines(rows: list[np.ndarray], w: float) -> np.ndarray:
    """Return a matrix whose last three rows are those of sin, cos and 1."""
    size = len(rows) + 3
    s = _vector(size, **{f"_{size - 2}": w})
    c = _vector(size, **{f"_{size - 3}": -w})
    return np.array([*rows, s, c, np.zeros(size)])


def _number(random: Random, low: float, high: float) -> float:
    return round(random.uniform(low, high), 3)


# A mass that rests with friction until a growing force moves it: y = x, v, sin, cos, 1


def _release(model, p):
    x, v = model.state("x", "m", 0.0, "place"), model.state("v", "m/s", 0.0, "speed")
    model.derivative(x, v)
    force = p("a") * ca.sin(p("w") * model.t) - p("k") * x
    model.derivative(v, force - p("mu") * ca.sign(v))


def _release_numbers(random):
    mu, k = _number(random, 0.1, 0.6), _number(random, 0.5, 5)
    return {
        "x": round(random.uniform(-0.9, 0.9) * mu / k, 4), "v": 0.0, "mu": mu, "k": k,
        "a": _number(random, 0.5, 2.5), "w": _number(random, 0.8, 4),
    }  # fmt: skip


def _release_law(n):
    rows = [_vector(5, _1=1), _vector(5, _0=-n["k"], _2=n["a"])]
    return LinearHybrid(
        _with_sines(rows, n["w"]), [Contact(_vector(5, _1=-n["mu"]), _vector(5, _1=1))]
    )


# Three blocks on each other, with dry friction between all and to the ground: y = x, v, u, s, ...


def _contacts(model, p):
    x, v = model.state("x", "m", 0.0, "place"), model.state("v", "m/s", 0.0, "lowest speed")
    u, s = model.state("u", "m/s", 0.0, "middle speed"), model.state("s", "m/s", 0.0, "top speed")
    model.derivative(x, v)
    push = p("a") * ca.sin(p("w") * model.t) - p("k") * x - p("mu") * ca.sign(v)
    lower, upper = p("b") * ca.sign(v - u), p("c") * ca.sign(u - s)
    model.derivative(v, push - lower)
    model.derivative(u, lower - upper)
    model.derivative(s, upper)


def _contacts_numbers(random):
    ranges = {
        "x": (-1, 1), "v": (-1, 1), "u": (-1, 1), "s": (-1, 1), "a": (1, 4), "w": (1, 5),
        "k": (0.5, 4), "b": (0.2, 1.5), "c": (0.1, 1), "mu": (0.1, 0.8),
    }  # fmt: skip
    return {name: _number(random, *ends) for name, ends in ranges.items()}


def _contacts_law(n):
    none = np.zeros(7)
    flow = _with_sines([_vector(7, _1=1), _vector(7, _0=-n["k"], _4=n["a"]), none, none], n["w"])
    contacts = [
        Contact(_vector(7, _1=-n["mu"]), _vector(7, _1=1)),
        Contact(_vector(7, _1=-n["b"], _2=n["b"]), _vector(7, _1=1, _2=-1)),
        Contact(_vector(7, _2=-n["c"], _3=n["c"]), _vector(7, _2=1, _3=-1)),
    ]
    return LinearHybrid(flow, contacts)


# A relay with hysteresis, a sampler, a reset, and a chain of counters: y = x, z, r, h, n, q, ...


def _control(model, p):
    x, z = model.state("x", "1", 0.0, "state"), model.state("z", "1", 0.0, "state")
    r, h = model.discrete("r", "1", 1.0, "relay"), model.discrete("h", "1", 0.0, "sample")
    n, q = model.discrete("n", "1", 0.0, "count"), model.discrete("q", "1", 0.0, "count of counts")
    model.derivative(x, z)
    model.derivative(
        z, p("a") * ca.sin(p("w") * model.t) - p("k") * x - p("d") * z + p("b") * r + h
    )
    model.when(x > p("up"), {r: -1}, name="off")
    model.when(x < -p("up"), {r: 1}, name="on")
    model.when(z > p("fast"), {z: p("e") * z, n: n + 1}, name="reset")
    model.when(n > 1.5, {n: 0, q: q + 1, x: x - 0.25}, name="chain")
    model.every(p("T"), {h: p("g") * x}, name="sample")


def _control_numbers(random):
    ranges = {
        "x": (-0.2, 0.2), "z": (-0.2, 0.2), "a": (0, 2), "w": (1, 6), "k": (1, 20), "d": (0, 0.5),
        "b": (1, 4), "up": (0.1, 0.4), "fast": (0.4, 1.2), "e": (-0.6, 0.6), "T": (0.11, 0.47),
        "g": (-1, 1),
    }  # fmt: skip
    return {name: _number(random, *ends) for name, ends in ranges.items()}


def _control_law(n):
    none = np.zeros(9)
    rates = _vector(9, _0=-n["k"], _1=-n["d"], _2=n["b"], _3=1, _6=n["a"])
    flow = _with_sines([_vector(9, _1=1), rates, none, none, none, none], n["w"])
    whens = [
        When("off", _vector(9, _0=1, _8=-n["up"]), _assigning(9, _2=_vector(9, _8=-1))),
        When("on", _vector(9, _0=-1, _8=-n["up"]), _assigning(9, _2=_vector(9, _8=1))),
        When("reset", _vector(9, _1=1, _8=-n["fast"]),
             _assigning(9, _1=_vector(9, _1=n["e"]), _4=_vector(9, _4=1, _8=1))),
        When("chain", _vector(9, _4=1, _8=-1.5),
             _assigning(9, _0=_vector(9, _0=1, _8=-0.25), _4=none, _5=_vector(9, _5=1, _8=1))),
    ]  # fmt: skip
    sample = Every("sample", n["T"], _assigning(9, _3=_vector(9, _0=n["g"])))
    return LinearHybrid(flow, (), whens, [sample])


# A mass on a belt that hits a stop, with a sampled force: y = x, v, h, n, sin, cos, 1


def _impacts(model, p):
    x, v = model.state("x", "m", 0.0, "place"), model.state("v", "m/s", 0.0, "speed")
    h, n = model.discrete("h", "N", 0.0, "sampled force"), model.discrete("n", "1", 0.0, "hits")
    model.derivative(x, v)
    push = p("a") * ca.sin(p("w") * model.t)
    model.derivative(v, push + h - p("k") * x - p("mu") * ca.sign(v - p("belt")))
    model.when(x > p("stop"), {v: -p("e") * v, n: n + 1}, name="hit")
    model.every(p("T"), {h: p("g") * x}, name="sample")


def _impacts_numbers(random):
    ranges = {
        "x": (-0.4, 0.2), "v": (-1, 1), "a": (1, 4), "w": (1, 5), "k": (1, 8), "mu": (0.1, 0.8),
        "belt": (-0.5, 0.5), "stop": (0.25, 0.5), "e": (0.3, 0.9), "T": (0.11, 0.47), "g": (-2, 2),
    }  # fmt: skip
    return {name: _number(random, *ends) for name, ends in ranges.items()}


def _impacts_law(n):
    none = np.zeros(7)
    rates = _vector(7, _0=-n["k"], _2=1, _4=n["a"])
    contact = Contact(_vector(7, _1=-n["mu"]), _vector(7, _1=1, _6=-n["belt"]))
    new = _assigning(7, _1=_vector(7, _1=-n["e"]), _3=_vector(7, _3=1, _6=1))
    hit = When("hit", _vector(7, _0=1, _6=-n["stop"]), new)
    sample = Every("sample", n["T"], _assigning(7, _2=_vector(7, _0=n["g"])))
    flow = _with_sines([_vector(7, _1=1), rates, none, none], n["w"])
    return LinearHybrid(flow, [contact], [hit], [sample])


FAMILIES = {
    "release": Family(("x", "v"), _release, _release_numbers, _release_law),
    "contacts": Family(("x", "v", "u", "s"), _contacts, _contacts_numbers, _contacts_law),
    "control": Family(
        ("x", "z", "r", "h", "n", "q"), _control, _control_numbers, _control_law
    ),
    "impacts": Family(("x", "v", "h", "n"), _impacts, _impacts_numbers, _impacts_law),
}  # fmt: skip


@cache
def model_of(family: str) -> Dae:
    """Return the model of a family."""
    model = cosim.Model(f"random_{family}", stop_time=STOP, output_interval=STOP / 200)
    numbers = FAMILIES[family].numbers(Random(0))

    def parameter(name: str) -> ca.SX:
        return model.parameter(name, "1", numbers[name], "a drawn number")

    FAMILIES[family].build(model, cache(parameter))
    return model.freeze()


@dataclass(frozen=True)
class Drawn:
    """Numbers of a model, by name, and its course."""

    numbers: dict[str, float]
    course: Course


@cache
def draw(family: str, seed: int) -> Drawn:
    """Return the first model after a seed whose course does not hang on rounding."""
    random = Random(f"{family} {seed}")
    kind = FAMILIES[family]
    while True:
        numbers = kind.numbers(random)
        start = [numbers.get(name, 1.0 if name == "r" else 0.0) for name in kind.names]
        try:
            course = kind.law(numbers).course(np.array([*start, 0, 1, 1]), STOP)
        except TooManyEvents:
            continue
        if min(course.margin, course.gap) > ENOUGH:
            return Drawn(numbers, course)
