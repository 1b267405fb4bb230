"""The trial of FMUs with events: co-simulation against model exchange under CVODE."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import product
from time import monotonic
from typing import Any

import numpy as np

from cosim.arrays import Vector
from cosim.fmi.check.finding import TRIAL_RULES, Finding
from cosim.fmi.check.parsed import Described
from cosim.fmi.check.trials.bench import Bench, Note, Skipped
from cosim.fmi.run.instance import Interface, by_name, enter_continuous_time, instantiated
from cosim.fmi.run.python_master import run_in_python
from cosim.fmi.run.request import FmuRequest

_POINTS = 211.3  # communication steps of a run: few of them end at an event
_TIGHT = 1e-10  # relative tolerance of the reference
_SHARE = 1e-4  # of a range: a difference that counts
_INNER_STEPS = (1, 2, 5, 10)  # of a communication step, in solvers with steps of a fixed size
_FOR_IT = 1 / 6  # share of all time
_MOST = 0.02  # share of the points that may differ, as those between two times of one event


@dataclass
class _Switching:
    """The runs of an FMU with its own start values.

    Attributes:
        bench: The FMU.
        outputs: The recorded variables.
        end: When to give up, by `monotonic`, s.
        silent_jumps: States that jumped at an event which did not report it, by how much.
    """

    bench: Bench
    outputs: list[Described]
    end: float
    silent_jumps: dict[str, float] = field(default_factory=dict)

    @property
    def start(self) -> float:
        """Begin of the default experiment, s."""
        return self.bench.experiment("startTime") or 0.0

    @property
    def span(self) -> float:
        """Length of the default experiment, s."""
        return (self.bench.experiment("stopTime") or self.start + 1.0) - self.start

    def run(self, kind: Interface, tolerance: float, size: float) -> tuple[Vector, Vector]:
        """Return times, s, (n,), a size apart, and outputs, (n, outputs)."""
        bench, known = self.bench, by_name(self.bench.fmpy)
        recorded = tuple(known[output.name] for output in self.outputs)
        stop = self.start + size * int(self.span / size * (1 + 1e-9))
        times = (self.start, stop, size)
        request = FmuRequest(bench.fmpy, kind, {}, *times, recorded, tolerance=tolerance)
        with instantiated(bench.folder, bench.fmpy, kind, bench.name) as (instance, _):
            if kind is Interface.MODEL_EXCHANGE:
                self._watch(instance)
            found = run_in_python(instance, request)
        return found.times, found.rows

    def stepped(self, size: float, *, euler: bool) -> Vector:
        """Return outputs, (n, outputs), in steps of one size whose events happen at their ends."""
        bench, rows = self.bench, list[Vector]()
        states, rates = zip(*bench.states(), strict=True)
        indicators = bench.fmpy.numberOfEventIndicators or 0
        with bench.session("ModelExchange") as session:
            session.start()
            instance, next_event = session.instance, session.next_event

            def slope(t: float, x: Vector) -> Vector:
                instance.setTime(t)
                session.put_states(x)
                return session.values(rates)

            signs = session.all_of("getEventIndicators", indicators) > 0
            for n in range(1, int(self.span / size * (1 + 1e-9)) + 1):
                self._reject_lateness()
                t, end = self.start + (n - 1) * size, self.start + n * size
                x = session.values(states)
                k = slope(t, x)
                if not euler:
                    k2 = slope(t + size / 2, x + size / 2 * k)
                    k3 = slope(t + size / 2, x + size / 2 * k2)
                    k = (k + 2 * k2 + 2 * k3 + slope(end, x + size * k3)) / 6
                slope(end, x + size * k)
                passed = session.all_of("getEventIndicators", indicators) > 0
                if (passed != signs).any() or end >= next_event * (1 - 1e-12):
                    instance.enterEventMode()
                    next_event = enter_continuous_time(instance)
                    passed = session.all_of("getEventIndicators", indicators) > 0
                signs = passed
                rows.append(session.values(self.outputs))
        return np.array(rows)

    def _reject_lateness(self) -> None:
        if monotonic() > self.end:
            raise Skipped("it has more events than there is time for; --timeout gives more")

    def is_coarse(self, allowed: Vector) -> bool:
        """Return whether co-simulation makes steps of a fixed size with events at their ends.

        In FMI 2.0 the size need not be declared; parts of a communication step are tried.
        """
        size = self.bench.internal_step("CoSimulation") or self.bench.step_size("CoSimulation")
        with suppress(Exception):
            found = self.run(Interface.CO_SIMULATION, self.bench.tolerance, size)[1][1:]
            for parts, euler in product(_INNER_STEPS, (True, False)):
                other = self.stepped(size / parts, euler=euler)[parts - 1 :: parts][: len(found)]
                if (np.abs(found - other) > allowed).mean() <= _MOST:
                    return True
        return False

    def _watch(self, instance: Any) -> None:
        """Compare the states before and after each update with what the update reports."""
        update: Callable[[], tuple[Any, ...]] = instance.updateDiscreteStates
        references = {state.name: int(state.reference) for state, _ in self.bench.states()}

        def watched() -> tuple[Any, ...]:
            self._reject_lateness()
            before = np.array(instance.getFloat64(list(references.values())))
            result = update()
            after = np.array(instance.getFloat64(list(references.values())))
            if not result[3]:
                changed = np.flatnonzero(before != after)
                for k in changed:
                    self.silent_jumps.setdefault(list(references)[k], float(after[k] - before[k]))
            return result

        instance.updateDiscreteStates = watched


def switching(bench: Bench, kind: str) -> Iterator[Finding | Note]:
    """Co-simulation and model exchange agree over the default experiment, events included."""
    if kind != "CoSimulation" or "ModelExchange" not in bench.described.interfaces:
        raise Skipped("it compares co-simulation with model exchange")
    if not bench.has_events:
        raise Skipped("it has no events; `motion` compares it")
    every = (v for v in bench.outputs() if v.variability == "continuous")
    runs = _Switching(bench, list(every), monotonic() + _FOR_IT * bench.timeout)
    if not runs.outputs or not bench.states():
        raise Skipped("it has no continuous outputs")
    size = runs.span / _POINTS
    if not bench.offers("CoSimulation", "canHandleVariableCommunicationStepSize"):
        size = bench.step_size("CoSimulation")
    times, exact = runs.run(Interface.MODEL_EXCHANGE, _TIGHT, size)
    for name, jump in runs.silent_jumps.items():
        text = f"it jumps by {jump:.3g} at an event that does not report changed states"
        yield TRIAL_RULES["silent-jump"].at(name, text)
    coarse = runs.run(Interface.MODEL_EXCHANGE, bench.tolerance, size)[1]
    found = runs.run(Interface.CO_SIMULATION, bench.tolerance, size)[1]
    rows = min(len(exact), len(coarse), len(found))
    if rows < len(exact):
        raise Skipped("it ends by itself before")
    nominal = np.maximum([v.nominal for v in runs.outputs], np.abs(exact).max(axis=0))
    allowed = _SHARE * np.ptp(exact, axis=0) + 10 * bench.tolerance * nominal
    differs = np.abs(found - exact) > allowed + 10 * np.abs(coarse - exact)
    shares = differs.mean(axis=0)
    worst = int(np.argmax(shares))
    if shares[worst] <= _MOST:
        yield Note(f"{rows} points, {shares[worst]:.1%} of them differ")
        return
    coarse_steps = runs.is_coarse(allowed)
    if coarse_steps and bench.internal_step("CoSimulation"):
        yield Note("the declared fixed step of its solver explains the differences")
        return
    rule = "moves-coarsely" if coarse_steps else "switches-otherwise"
    yield TRIAL_RULES[rule].at(
        runs.outputs[worst].name,
        f"from {times[int(np.argmax(differs[:, worst]))]:.6g} s on, it differs from model exchange "
        f"with another solver, by up to {np.abs(found - exact)[:, worst].max():.2g} "
        f"(range: {np.ptp(exact[:, worst]):.2g})",
    )
