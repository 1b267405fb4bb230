"""Promised and true errors: `accuracy=` of random models and systems, against other programs.

    python benchmarks/promises.py [--systems 40] [--first 0] [KIND ...]

Kinds
    smooth          random smooth systems as one model
    hybrid          random models with friction, relays, samplers, impacts
    coupled         the same smooth systems, coupled as parts
    relay           a heated room and its relay as two parts
    sampled         a driven oscillator and its sampled controller as two parts
    spring          an oscillator that meets a one-sided spring of the other part
    play            the same with a stiff spring on both sides and 5 mm between
    foreign         smooth systems whose parts lack rollback, rates or derivatives

References are SciPy at 1e-11 for what is smooth or has kinks, and matrix exponentials with located
switches for the rest; near a switch a row counts for either side. Systems whose course hangs on
rounding, or that grow, are drawn again.

Columns: kept: share of runs, of those not refused, whose true error is at most what was asked;
worst: largest true error, in units of what was asked; refused: share; bound: share of runs whose
estimate is at least the true error; below: how many times the true error exceeds the estimate at
worst.
"""

import argparse
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from random import Random
from time import perf_counter
from typing import NamedTuple

import numpy as np

import cosim
from cosim.cli.tables import show_table
from cosim.errors import SolverError

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from helpers.coupled_springs import SpringWithGap
from helpers.linear_hybrid import Every, LinearHybrid, TooManyEvents, When
from helpers.random_hybrids import ENOUGH, FAMILIES, draw, model_of
from helpers.random_systems import SPAN, RandomSystem

ACCURACIES = (1e-3, 1e-6, 1e-8)
STOP = 3.0  # s, of the systems with events
NEAR = 1e-5  # s; rows so near a switch may lie on either side of it
LARGEST = 20.0  # of a course that does not grow


class Course(NamedTuple):
    """What a system does.

    Attributes:
        exact: Values by name, at the times of `time`.
        time: s.
        switches: Times of events, s.
    """

    exact: dict[str, np.ndarray]
    time: np.ndarray
    switches: np.ndarray


class Case(NamedTuple):
    """A way to simulate one system with an accuracy, and what the system does."""

    run: Callable[[float], cosim.Trajectory]
    course: Course


def _simulated(subject: object, **facts: object) -> Callable[[float], cosim.Trajectory]:
    if isinstance(subject, cosim.System):
        return lambda accuracy: subject.simulate(accuracy=accuracy, **facts)
    return lambda accuracy: cosim.simulate(subject, accuracy=accuracy, **facts)


def _smooth(seed: int, kind: str) -> Case | None:
    drawn = RandomSystem(seed)
    time = np.arange(101) * 0.02
    exact = drawn.solution(time)
    if max(np.abs(column).max() for column in exact.values()) > LARGEST:
        return None
    lacking = ("no rollback", "no rates", "no directional derivatives")
    random = Random(seed)
    abilities = {
        name: ", ".join(text for text in lacking if random.random() < 0.4) for name in drawn.parts
    }
    abilities = {name: text for name, text in abilities.items() if text}
    system = cosim.couple(
        drawn.parts, drawn.connections, abilities=abilities if kind == "foreign" else {}
    )
    subject = system.dae if kind == "smooth" else system
    return Case(
        _simulated(subject, stop_time=SPAN, output_interval=0.02),
        Course(exact, time, np.empty(0)),
    )


def _hybrid(seed: int) -> Case:
    family = [*FAMILIES][seed % len(FAMILIES)]
    drawn = draw(family, seed)
    columns = zip(FAMILIES[family].names, drawn.course.values.T, strict=False)
    switches = np.array([time for time, _ in drawn.course.events])
    facts = {"start_values": drawn.numbers}
    return Case(
        _simulated(model_of(family), **facts),
        Course(dict(columns), drawn.course.time, switches),
    )


def _course(law: LinearHybrid, start: list[float], names: dict[str, int]) -> Course | None:
    """Return the exact course of a law; None if it hangs on rounding or grows."""
    try:
        course = law.course(np.array(start, dtype=float), STOP)
    except TooManyEvents:
        return None
    if min(course.margin, course.gap) <= ENOUGH or np.abs(course.values).max() > LARGEST:
        return None
    exact = {name: course.values[:, place] for name, place in names.items()}
    return Course(exact, course.time, np.array([time for time, _ in course.events]))


def _part(name: str) -> cosim.Model:
    return cosim.Model(name, stop_time=STOP, output_interval=STOP / 200)


def _relay(seed: int) -> Case | None:
    """T' = heat q - loss T, R' = rate (T - R); q is 0 above `high` and 1 below `low` of R."""
    random = Random(seed)
    heat, loss = random.uniform(1, 4), random.uniform(0.2, 1)
    rate = random.uniform(2, 8)
    high, low = random.uniform(1.0, 1.4), random.uniform(0.5, 0.9)
    flow = np.array(
        [[-loss, 0, heat, 0], [rate, -rate, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]], dtype=float
    )

    def becomes(value: float) -> np.ndarray:
        new = np.eye(4)
        new[2] = [0, 0, 0, value]
        return new

    whens = [
        When("off", np.array([0, 1, 0, -high]), becomes(0)),
        When("on", np.array([0, -1, 0, low]), becomes(1)),
    ]
    found = _course(
        LinearHybrid(flow, (), whens), [0, 0, 1, 1], {"room.T": 0, "room.R": 1, "relay.q": 2}
    )
    if found is None:
        return None
    room, relay = _part("room"), _part("relay")
    T, R = room.state("T", "1", 0.0, "air"), room.state("R", "1", 0.0, "wall")
    on = room.input("on", "1", 0.0, "heating")
    room.derivative(T, heat * on - loss * T)
    room.derivative(R, rate * (T - R))
    seen = relay.input("seen", "1", 0.0, "temperature")
    q = relay.discrete("q", "1", 1.0, "heating")
    relay.when(seen > high, {q: 0}, name="off")
    relay.when(seen < low, {q: 1}, name="on")
    parts = {"room": room.freeze(), "relay": relay.freeze()}
    system = cosim.couple(parts, {"room.on": "relay.q", "relay.seen": "room.R"})
    return Case(_simulated(system), found)


def _sampled(seed: int) -> Case | None:
    """x'' = -k x - d x' + h; h = -g x at each multiple of a period."""
    random = Random(seed)
    k, d, g = random.uniform(1, 20), random.uniform(0.1, 1), random.uniform(-2, 2)
    period, x0 = random.uniform(0.11, 0.47), random.uniform(0.2, 1)
    flow = np.zeros((4, 4))
    flow[0, 1], flow[1] = 1, [-k, -d, 1, 0]
    new = np.eye(4)
    new[2] = [-g, 0, 0, 0]
    found = _course(
        LinearHybrid(flow, (), (), [Every("sample", period, new)]),
        [x0, 0, 0, 1],
        {"plant.x": 0, "plant.v": 1, "control.h": 2},
    )
    if found is None:
        return None
    plant, control = _part("plant"), _part("control")
    x, v = plant.state("x", "m", x0, "place"), plant.state("v", "m/s", 0.0, "speed")
    force = plant.input("force", "N", 0.0, "force")
    plant.derivative(x, v)
    plant.derivative(v, force - k * x - d * v)
    seen = control.input("seen", "m", 0.0, "place")
    h = control.discrete("h", "N", 0.0, "force")
    control.every(period, {h: -g * seen}, name="sample")
    parts = {"plant": plant.freeze(), "control": control.freeze()}
    system = cosim.couple(parts, {"plant.force": "control.h", "control.seen": "plant.x"})
    return Case(_simulated(system), found)


def _spring(seed: int, *, play: bool = False) -> Case:
    spring = SpringWithGap(seed, play=play)
    time = np.linspace(0, STOP, 201)
    return Case(_simulated(spring.system(STOP)), Course(spring.solution(time), time, np.empty(0)))


KINDS: dict[str, Callable[[int], Case | None]] = {
    "smooth": lambda seed: _smooth(seed, "smooth"),
    "hybrid": _hybrid,
    "coupled": lambda seed: _smooth(seed, "coupled"),
    "relay": _relay,
    "sampled": _sampled,
    "spring": _spring,
    "play": lambda seed: _spring(seed, play=True),
    "foreign": lambda seed: _smooth(seed, "foreign"),
}


def cases(kind: str, first: int, count: int) -> Iterator[tuple[int, Case]]:
    """Yield cases of a kind with their seeds."""
    seed = first
    while count:
        case = KINDS[kind](seed)
        if case is not None:
            yield seed, case
            count -= 1
        seed += 1


def true_error(course: Course, run: cosim.Trajectory) -> float:
    """Return the largest error of a run, by nominal values of 1; NaN where its rows differ."""
    if len(run) != len(course.time) or not np.allclose(run.time, course.time, rtol=0, atol=1e-9):
        at = np.searchsorted(run.time, course.time - 1e-9)
        if at.max() >= len(run) or not np.allclose(run.time[at], course.time, rtol=0, atol=1e-9):
            return np.nan
    else:
        at = np.arange(len(run))
    clear = np.ones(len(at), dtype=bool)
    if course.switches.size:
        clear = np.abs(np.subtract.outer(course.time, course.switches)).min(axis=1) > NEAR
    return max(np.abs(run[n][at] - right)[clear].max() for n, right in course.exact.items())


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("kinds", nargs="*", metavar="KIND", help="see above; all by default")
    parser.add_argument("--systems", type=int, default=40, help="of each kind (40)")
    parser.add_argument("--first", type=int, default=0, help="first seed (0)")
    parser.add_argument("--short", action="store_true", help="one system of each kind")
    options = parser.parse_args()
    rows = []
    for kind in options.kinds or KINDS:
        began = perf_counter()
        found = {accuracy: [] for accuracy in ACCURACIES}
        for seed, case in cases(kind, options.first, 1 if options.short else options.systems):
            for accuracy in ACCURACIES:
                try:
                    run = case.run(accuracy)
                except SolverError as error:
                    found[accuracy].append(None)
                    print(f"{kind} {seed} at {accuracy:g} refused: {error}"[:150], file=sys.stderr)
                    continue
                error = true_error(case.course, run)
                estimate = run.stats["error_estimate"]
                found[accuracy].append((error, estimate))
                if not error <= accuracy or error > estimate:
                    text = f"{kind} {seed} at {accuracy:g}: {error:.2e}, estimate {estimate:.2e}"
                    print(text, file=sys.stderr)
        for accuracy, results in found.items():
            returned = np.array([pair for pair in results if pair is not None])
            row = {"kind": kind, "accuracy": accuracy, "systems": len(results)}
            if len(returned):
                error, estimate = returned.T
                row |= {"kept": f"{np.mean(error <= accuracy):.1%}"}
                row |= {"worst": f"{(error / accuracy).max():.2g}"}
                row |= {"refused": f"{1 - len(returned) / len(results):.1%}"}
                row |= {"bound": f"{np.mean(estimate >= error):.1%}"}
                row |= {"below": f"{(error / np.maximum(estimate, 1e-300)).max():.2g}"}
            rows.append(row)
        print(f"{kind}: {perf_counter() - began:.0f} s", file=sys.stderr)
    show_table(rows)


if __name__ == "__main__":
    main()
