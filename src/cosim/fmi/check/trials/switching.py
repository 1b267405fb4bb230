"""The trial of FMUs with events: co-simulation against model exchange under CVODE."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cosim.arrays import Vector
from cosim.fmi.check.finding import TRIAL_RULES, Finding
from cosim.fmi.check.parsed import Described
from cosim.fmi.check.trials.bench import Bench, Note, Skipped
from cosim.fmi.run.instance import Interface, by_name, instantiated
from cosim.fmi.run.python_master import run_in_python
from cosim.fmi.run.request import FmuRequest

_POINTS = 211.3  # communication steps of a run: few of them end at an event
_TIGHT = 1e-10  # relative tolerance of the reference
_SHARE = 1e-4  # of a range: a difference that counts
_MOST = 0.02  # share of the points that may differ, as those between two times of one event


@dataclass
class _Switching:
    """The runs of an FMU with its own start values.

    Attributes:
        bench: The FMU.
        outputs: The recorded variables.
        silent_jumps: States that jumped at an event which did not report it, by how much.
    """

    bench: Bench
    outputs: list[Described]
    silent_jumps: dict[str, float] = field(default_factory=dict)

    def run(self, kind: Interface, tolerance: float) -> tuple[Vector, Vector]:
        """Return times, s, (n,), and outputs, (n, outputs)."""
        bench, known = self.bench, by_name(self.bench.fmpy)
        start = bench.experiment("startTime") or 0.0
        span = (bench.experiment("stopTime") or start + 1.0) - start
        size = span / _POINTS
        if not bench.offers("CoSimulation", "canHandleVariableCommunicationStepSize"):
            size = bench.step_size("CoSimulation")
        recorded = tuple(known[output.name] for output in self.outputs)
        times = (start, start + size * int(span / size * (1 - 1e-9)), size)
        request = FmuRequest(bench.fmpy, kind, {}, *times, recorded, tolerance=tolerance)
        with instantiated(bench.folder, bench.fmpy, kind, bench.name) as (instance, _):
            if kind is Interface.MODEL_EXCHANGE:
                self._watch(instance)
            found = run_in_python(instance, request)
        return found.times, found.rows

    def _watch(self, instance: Any) -> None:
        """Compare the states before and after each update with what the update reports."""
        second = self.bench.second
        name = "newDiscreteStates" if second else "updateDiscreteStates"
        update: Callable[[], tuple[Any, ...]] = getattr(instance, name)
        references = {state.name: int(state.reference) for state, _ in self.bench.states()}
        get = instance.getReal if second else instance.getFloat64

        def watched() -> tuple[Any, ...]:
            before = np.array(get(list(references.values())))
            result = update()
            after = np.array(get(list(references.values())))
            if not result[3]:
                changed = np.flatnonzero(before != after)
                for k in changed:
                    self.silent_jumps.setdefault(list(references)[k], float(after[k] - before[k]))
            return result

        setattr(instance, name, watched)


def switching(bench: Bench, kind: str) -> Iterator[Finding | Note]:
    """Co-simulation and model exchange agree over the default experiment, events included."""
    if kind != "CoSimulation" or "ModelExchange" not in bench.described.interfaces:
        raise Skipped("it compares co-simulation with model exchange")
    if not has_events(bench):
        raise Skipped("it has no events; `motion` compares it")
    every = (v for v in bench.outputs() if v.variability == "continuous")
    runs = _Switching(bench, list(every))
    if not runs.outputs or not bench.states():
        raise Skipped("it has no continuous outputs")
    times, exact = runs.run(Interface.MODEL_EXCHANGE, _TIGHT)
    for name, jump in runs.silent_jumps.items():
        text = f"it jumps by {jump:.3g} at an event that does not report changed states"
        yield TRIAL_RULES["silent-jump"].at(name, text)
    coarse = runs.run(Interface.MODEL_EXCHANGE, bench.tolerance)[1]
    found = runs.run(Interface.CO_SIMULATION, bench.tolerance)[1]
    rows = min(len(exact), len(coarse), len(found))
    if rows < len(exact):
        raise Skipped("it ends by itself before")
    size = np.maximum([v.nominal for v in runs.outputs], np.abs(exact).max(axis=0))
    allowed = _SHARE * np.ptp(exact, axis=0) + 10 * bench.tolerance * size
    allowed = allowed + 10 * np.abs(coarse - exact)
    differs = np.abs(found - exact) > allowed
    shares = differs.mean(axis=0)
    worst = int(np.argmax(shares))
    if shares[worst] <= _MOST:
        yield Note(f"{rows} points, {shares[worst]:.1%} of them differ")
        return
    first = int(np.argmax(differs[:, worst]))
    yield TRIAL_RULES["switches-otherwise"].at(
        runs.outputs[worst].name,
        f"from {times[first]:.6g} s on, it differs from model exchange with another solver, by up "
        f"to {np.abs(found - exact)[:, worst].max():.2g} (range: {np.ptp(exact[:, worst]):.2g})",
    )


def has_events(bench: Bench) -> bool:
    """Return whether model exchange has event indicators, or a time event within the experiment."""
    if bench.fmpy.numberOfEventIndicators:
        return True
    with bench.session("ModelExchange") as session:
        session.start()
        return session.next_event < (bench.experiment("stopTime") or session.start_time + 1.0)
