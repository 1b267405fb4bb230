"""Promised and true errors: `accuracy=` of random models and systems, against other programs.

    python benchmarks/promises.py [--systems 40] [--first 0] [--log FILE] [KIND ...]

Kinds
    smooth          random smooth systems as one model
    hybrid          random models with friction, relays, samplers, impacts
    coupled         the same smooth systems, coupled as parts
    relay           a heated room and its relay as two parts
    sampled         a driven oscillator and its sampled controller as two parts
    spring          an oscillator that meets a one-sided spring of the other part
    play            the same with a stiff spring on both sides and 5 mm between
    foreign         smooth systems whose parts lack rollback, rates or derivatives
    integral        an oscillator cut between place and speed, two integrals in a loop; inputs are
                    constant within steps, and parts may lack rollback

References are SciPy at 3e-14 for what is smooth and at 1e-12 for kinks, and matrix exponentials
with located switches for the rest; near a switch a row counts for either side. Systems whose course
hangs on rounding, or that grow, are drawn again.

Columns: kept: share of runs, of those not refused, whose true error is at most what was asked;
worst: largest true error, in units of what was asked; refused: share; bound: share of runs whose
estimate is at least the true error; below: how many times the true error exceeds the estimate at
worst. Errors below 1e-12 may be those of the references: an estimate is not judged by them.
"""

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from random import Random
from time import perf_counter
from typing import NamedTuple

import numpy as np
from casadi import SX

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
REFERENCES = 1e-12  # what they may be wrong by


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


def _part(name: str, *numbers: str) -> tuple[cosim.Model, list[SX]]:
    """Return a model and parameters of it, so that all systems of a kind share compiled code."""
    model = cosim.Model(name, stop_time=STOP, output_interval=STOP / 200)
    return model, [model.parameter(number, "1", 1.0, number) for number in numbers]


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
        LinearHybrid(flow, (), whens),
        [0, 0, 1, 1],
        {"room.T": 0, "room.R": 1, "relay.q": 2, "relay.seen": 1},
    )
    if found is None:
        return None
    values = {"room.heat": heat, "room.loss": loss, "room.rate": rate}
    values |= {"relay.high": high, "relay.low": low}
    room, (heat, loss, rate) = _part("room", "heat", "loss", "rate")
    relay, (high, low) = _part("relay", "high", "low")
    T, R = room.state("T", "1", 0.0, "air"), room.state("R", "1", 0.0, "wall")
    on = room.input("on", "1", 0.0, "heating")
    room.derivative(T, heat * on - loss * T)
    room.derivative(R, rate * (T - R))
    seen = relay.input("seen", "1", 0.0, "temperature")
    q = relay.discrete("q", "1", 1.0, "heating")
    relay.when(seen > high, {q: 0}, name="off")
    relay.when(seen < low, {q: 1}, name="on")
    parts = {"room": room.freeze(), "relay": relay.freeze()}
    wires = {"room.on": "relay.q", "relay.seen": "room.R"}
    system = cosim.couple(parts, wires, start_values=values)
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
        {"plant.x": 0, "plant.v": 1, "control.h": 2, "control.seen": 0},
    )
    if found is None:
        return None
    values = {"plant.k": k, "plant.d": d, "plant.x": x0, "control.g": g}
    plant, (k, d) = _part("plant", "k", "d")
    control, (g,) = _part("control", "g")
    x, v = plant.state("x", "m", 1.0, "place"), plant.state("v", "m/s", 0.0, "speed")
    force = plant.input("force", "N", 0.0, "force")
    plant.derivative(x, v)
    plant.derivative(v, force - k * x - d * v)
    seen = control.input("seen", "m", 0.0, "place")
    h = control.discrete("h", "N", 0.0, "force")
    control.every(period, {h: -g * seen}, name="sample")
    parts = {"plant": plant.freeze(), "control": control.freeze()}
    wires = {"plant.force": "control.h", "control.seen": "plant.x"}
    system = cosim.couple(parts, wires, start_values=values)
    return Case(_simulated(system), found)


def _spring(seed: int, *, play: bool = False) -> Case:
    spring = SpringWithGap(seed, play=play)
    time = np.linspace(0, STOP, 201)
    return Case(_simulated(spring.system(STOP)), Course(spring.solution(time), time, np.empty(0)))


def _integral(seed: int) -> Case | None:
    """x' = v in one part, v' = -k x - d v in the other."""
    random = Random(seed)
    k, d = random.uniform(0.5, 20), random.uniform(0, 0.6)
    x0, v0 = random.uniform(-1, 1), random.uniform(-1, 1)
    found = _course(
        LinearHybrid(np.array([[0, 1], [-k, -d]]), (), ()),
        [x0, v0],
        {"place.x": 0, "speed.v": 1},
    )
    if found is None:
        return None
    values = {"place.x": x0, "speed.v": v0, "speed.k": k, "speed.d": d}
    place, _ = _part("place")
    speed, (k, d) = _part("speed", "k", "d")
    x, v = place.state("x", "m", 1.0, "place"), speed.state("v", "m/s", 0.0, "speed")
    place.derivative(x, place.input("v", "m/s", 0.0, "speed"))
    speed.derivative(v, -k * speed.input("x", "m", 0.0, "place") - d * v)
    parts = {"place": place.freeze(), "speed": speed.freeze()}
    wires = {"place.v": "speed.v", "speed.x": "place.x"}
    lacking = "no rates, no interpolation"
    abilities = {n: lacking + ", no rollback" * (random.random() < 0.5) for n in parts}
    system = cosim.couple(parts, wires, start_values=values, abilities=abilities)
    return Case(_simulated(system), found)


KINDS: dict[str, Callable[[int], Case | None]] = {
    "smooth": lambda seed: _smooth(seed, "smooth"),
    "hybrid": _hybrid,
    "coupled": lambda seed: _smooth(seed, "coupled"),
    "relay": _relay,
    "sampled": _sampled,
    "spring": _spring,
    "play": lambda seed: _spring(seed, play=True),
    "foreign": lambda seed: _smooth(seed, "foreign"),
    "integral": _integral,
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


class Log:
    """The runs of this benchmark, in a CSV file if there is one, so that none is repeated.

    A row has kind, seed, accuracy, true error and estimate; these two are empty if it was refused.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        lines = path.read_text().splitlines() if path and path.exists() else []
        self._known = {tuple(row[:3]): row for row in (line.split(",") for line in lines)}

    def row(self, kind: str, seed: int, case: Case, accuracy: float) -> list[str]:
        """Return the row of a run."""
        key = kind, str(seed), f"{accuracy:g}"
        if key not in self._known:
            self._known[key] = [*key, *_measured(" ".join(key), case, accuracy)]
            if self._path:
                with self._path.open("a") as log:
                    print(*self._known[key], sep=",", file=log)
        return self._known[key]


def _measured(name: str, case: Case, accuracy: float) -> list[str]:
    """Return the true error and the estimate of a run; empty texts if it was refused."""
    try:
        run = case.run(accuracy)
    except SolverError as error:
        print(f"{name} refused: {error}"[:150], file=sys.stderr)
        return ["", ""]
    error, estimate = true_error(case.course, run), run.stats["error_estimate"]
    if not error <= accuracy or error > estimate:
        print(f"{name}: {error:.2e}, estimate {estimate:.2e}", file=sys.stderr)
    return [f"{error:.3g}", f"{estimate:.3g}"]


def _shares(kind: str, rows: Sequence[Sequence[str]]) -> Iterator[dict[str, object]]:
    """Yield the rows of the table for one kind."""
    for accuracy in ACCURACIES:
        results = [row[3:5] for row in rows if float(row[2]) == accuracy]
        returned = np.array([[float(n) for n in pair] for pair in results if pair[0]])
        row: dict[str, object] = {"kind": kind, "accuracy": accuracy, "systems": len(results)}
        if len(returned):
            error, estimate = returned.T
            row |= {"kept": f"{np.mean(error <= accuracy):.1%}"}
            row |= {"worst": f"{(error / accuracy).max():.2g}"}
            row |= {"refused": f"{1 - len(returned) / len(results):.1%}"}
            judged = np.where(error > REFERENCES, error, 0)
            row |= {"bound": f"{np.mean(estimate >= judged):.1%}"}
            row |= {"below": f"{(judged / np.maximum(estimate, 1e-300)).max():.2g}"}
        yield row


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("kinds", nargs="*", metavar="KIND", help="see above; all by default")
    parser.add_argument("--systems", type=int, default=40, help="of each kind (40)")
    parser.add_argument("--first", type=int, default=0, help="first seed (0)")
    parser.add_argument("--short", action="store_true", help="one system of each kind")
    parser.add_argument("--log", type=Path, help="CSV file of the runs; its runs are not repeated")
    options = parser.parse_args()
    table, log = list[dict[str, object]](), Log(options.log)
    for kind in options.kinds or KINDS:
        began = perf_counter()
        systems = cases(kind, options.first, 1 if options.short else options.systems)
        rows = [log.row(kind, *one, accuracy) for one in systems for accuracy in ACCURACIES]
        print(f"{kind}: {perf_counter() - began:.0f} s", file=sys.stderr)
        table += _shares(kind, rows)
    show_table(table)


if __name__ == "__main__":
    main()
