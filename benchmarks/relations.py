"""Random fast and narrow relations: which crossings the solvers and FMUs miss.

    python benchmarks/relations.py [COUNT]

States move on a unit circle, so that the motion is known. A relation of them is up to 200 times
faster than they are, or true for a small part of a radian. Crossings count whose excursions are
deeper than 1e-5 of the relation's size on both sides; they are found by samples, 2000 in the
shortest period and 400 in a width. A run is right if it has as many events, up to those that are
shallower.
"""

import itertools
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

import cosim

STOP, DEPTH, NUMBERS = 6.0, 1e-5, 8
Relation = Callable[[Any, Any, Any, Any], Any]  # of x, v, numbers and a module of functions
FAST: dict[str, Relation] = {
    "sine": lambda x, v, p, m: m.sin(p[0] * x + p[1]) - p[2],
    "two sines": lambda x, v, p, m: m.sin(p[0] * x + p[1]) + m.cos(p[3] * v + p[4]) - 2 * p[2],
    "product": lambda x, v, p, m: m.sin(p[0] * x) * m.cos(p[3] * v + p[1]) - p[2],
    "of a product": lambda x, v, p, m: m.sin(p[0] * x * v + p[1]) - p[2] * (1 + x / 2),
    "of a square": lambda x, v, p, m: m.cos(p[0] * x**2 + p[1] * v) - p[2],
}
NARROW: dict[str, Relation] = {
    "disk": lambda x, v, p, m: 1 - ((x - p[0]) / p[2]) ** 2 - ((v - p[1]) / p[2]) ** 2,
    "Gauss": lambda x, v, p, m: m.exp(-(((x - p[0]) / p[2]) ** 2)) - 0.5,
    "Lorentz": lambda x, v, p, m: 1 / (1 + ((x * v - p[0] * p[1]) / p[2]) ** 2) - 0.5,
    "window": lambda x, v, p, m: m.tanh((x - p[0]) / p[2]) - m.tanh((x - p[0]) / p[2] - 1) - 0.5,
    "strip": lambda x, v, p, m: p[2] - m.fabs(x * p[1] - v * p[0]),
}


def model(relation: Relation) -> Any:
    """Return a model that counts how often a relation becomes true, and false."""
    laws = cosim.Model("relation", stop_time=STOP, output_interval=STOP / 10)
    x, v = laws.state("x", "1", 0.0, "sine"), laws.state("v", "1", 1.0, "cosine")
    n, m = laws.discrete("n", "1", 0.0, "begins"), laws.discrete("m", "1", 0.0, "ends")
    p = [laws.parameter(f"p{i}", "1", 0.5, f"number {i}") for i in range(NUMBERS)]
    laws.derivative(x, v)
    laws.derivative(v, -x)
    value = relation(x, v, p, ca)
    laws.when(value > 0, {n: n + 1}, name="begins")
    laws.when(value < 0, {m: m + 1}, name="ends")
    return laws.freeze()


def numbers(kind: str, random: np.random.Generator) -> np.ndarray:
    p = random.uniform(-1, 1, NUMBERS)
    if kind in FAST:
        p[[0, 3]] = 10 ** random.uniform(0.5, np.log10(200), 2)
    else:
        turn = random.uniform(0.1, 6)
        off = random.uniform(-0.9, 0.9)
        p[2] = 10 ** random.uniform(-3.5, -1.7)
        p[:2] = np.sin(turn) + off * p[2] / 2, np.cos(turn)
    return p


def excursions(relation: Relation, p: np.ndarray, narrow: bool) -> tuple[np.ndarray, ...]:
    """Return the begins and ends of the excursions above 0: of the deep ones, and of all."""
    fastest = 2 * max(p[0], p[3]) + 2  # rad/s
    step = p[2] / 400 if narrow else 2 * np.pi / fastest / 2000
    t = np.linspace(0, STOP, int(STOP / step) + 1)
    f = relation(np.sin(t), np.cos(t), p, np)
    edges = np.flatnonzero(np.diff(f > 0))
    bounds = np.concatenate(([0], edges + 1, [len(t)]))
    depths = np.maximum.reduceat(np.abs(f), bounds[:-1])
    depths[[0, -1]] = np.inf  # what begins or ends with the run is no excursion
    deep = depths > DEPTH * np.abs(f).max()
    certain = deep[:-1] & deep[1:]
    at = t[edges] - f[edges] * np.diff(t)[edges] / np.diff(f)[edges]
    return at[certain], at


def engines(dae: Any, path: Path) -> Iterator[tuple[str, Callable[[dict[str, float]], Any]]]:
    for solver in ("dop853", "cvodes"):
        yield solver, lambda p, s=solver: cosim.simulate(dae, solver=s, start_values=p)
    for solver in ("rk4", "ode8"):
        fixed = {"solver": solver, "step_size": 0.02}
        yield solver, lambda p, o=fixed: cosim.simulate(dae, start_values=p, **o)
    for interface in ("CoSimulation", "ModelExchange"):
        options = {"interface": interface, "relative_tolerance": 1e-8}
        yield (
            f"FMU, {interface}",
            lambda p, o=options: cosim.simulate_fmu(path, start_values=p, **o),
        )


def main(count: int) -> None:
    random, folder = np.random.default_rng(3), Path(tempfile.mkdtemp())
    kinds = {**FAST, **NARROW}
    models = {kind: model(relation) for kind, relation in kinds.items()}
    files = {
        kind: cosim.export_fmu(dae, folder / f"{i}.fmu", outputs=["n", "m"])
        for i, (kind, dae) in enumerate(models.items())
    }
    missed, crossings = dict[str, int](), 0
    for kind in itertools.islice(itertools.cycle(kinds), count):
        p = numbers(kind, random)
        deep, every = excursions(kinds[kind], p, kind in NARROW)
        crossings += len(deep)
        values = {f"p{i}": float(value) for i, value in enumerate(p)}
        for name, run in engines(models[kind], files[kind]):
            try:
                final = run(values).final
                found = int(final["n"] + final["m"])
            except cosim.CosimError as error:
                print(kind, p.tolist(), name, error)
                found = -1
            wrong = not len(deep) <= found <= len(every)
            missed[name] = missed.get(name, 0) + wrong
            if wrong:
                print(kind, p.tolist(), name, found, len(deep), len(every))
    print(f"of {count} relations with {crossings} crossings, with a wrong number of events:")
    for name, number in missed.items():
        print(f"{name:22} {number:4}")


if __name__ == "__main__":
    given = [int(word) for word in sys.argv[1:] if word.isdigit()]
    main((given or [200])[0])
