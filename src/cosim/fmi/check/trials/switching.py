"""The trial of a whole run: co-simulation against model exchange under CVODE."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import product
from time import monotonic
from typing import Any

import numpy as np

from cosim.arrays import Vector
from cosim.errors import FmuError
from cosim.fmi.check.finding import TRIAL_RULES, Finding
from cosim.fmi.check.parsed import Described
from cosim.fmi.check.trials.bench import Bench, Note, Skipped, reject_lateness
from cosim.fmi.run.arrays import Access
from cosim.fmi.run.description import Interface, by_name
from cosim.fmi.run.instance import access_to, enter_continuous_time, update_discrete_states
from cosim.fmi.run.typed_values import NUMERIC
from cosim.model.times import one_time

_TIGHT = 1e-10  # relative tolerance of the reference
_SHARE = 1e-4  # of a range: a difference that counts
_INNER_STEPS = (1, 2, 5, 10)  # of a communication step, in solvers with steps of a fixed size
_FOR_IT = 1 / 6  # share of all time
_MOST_EVENTS = 1000  # at one time
_ROUNDING = 1e-9  # of a step
_CLOSER = 0.8  # error that steps of a quarter leave
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

    def run(self, kind: Interface, tolerance: float, size: float) -> tuple[Vector, Vector]:
        """Return times, s, (n,), a size apart, and outputs, (n, outputs)."""
        watch = self._watch if kind is Interface.MODEL_EXCHANGE else None
        return self.bench.run(kind, self.outputs, tolerance, size, self.end, watch)

    def stepped(self, size: float, *, euler: bool) -> Vector:
        """Return outputs, (n, outputs), in steps of one size whose events happen at their ends."""
        bench, rows = self.bench, list[Any]()
        states, rates = zip(*bench.states(), strict=True)
        indicators = bench.fmpy.numberOfEventIndicators or 0
        with bench.started("ModelExchange") as session:
            instance, next_event = session.instance, session.next_event
            recorded = self.access(instance)

            def slope(t: float, x: Vector) -> Vector:
                instance.setTime(t)
                session.put_states(x)
                return session.values(rates)

            signs = session.all_of("getEventIndicators", indicators) > 0
            for n in range(1, self.bench.step_count(size) + 1):
                reject_lateness(self.end)
                t, end = self.bench.start + (n - 1) * size, self.bench.start + n * size
                x = session.values(states)
                k = slope(t, x)
                if not euler:
                    k2 = slope(t + size / 2, x + size / 2 * k)
                    k3 = slope(t + size / 2, x + size / 2 * k2)
                    k = (k + 2 * k2 + 2 * k3 + slope(end, x + size * k3)) / 6
                slope(end, x + size * k)
                passed = session.all_of("getEventIndicators", indicators) > 0
                due = end >= next_event or one_time(end, next_event, bench.start)
                if (passed != signs).any() or due:
                    instance.enterEventMode()
                    next_event = enter_continuous_time(instance)
                    passed = session.all_of("getEventIndicators", indicators) > 0
                signs = passed
                rows.append(recorded.get())
        return np.array(rows, dtype=float)

    def access(self, instance: Any) -> Access:
        """Return what gets the outputs of an instance."""
        known = by_name(self.bench.fmpy)
        return access_to([known[v.name] for v in self.outputs], instance, self.bench.fmpy)

    def in_event_mode(self, size: float) -> Vector:
        """Return outputs, (n, outputs), in FMI 3.0 whose steps end early at events.

        Raises:
            FmuError: A step makes no progress.
        """
        bench, rows = self.bench, list[Any]()
        kind = Interface.CO_SIMULATION
        beyond = bench.internal_step(kind) or _ROUNDING * size  # which a step may end late
        with bench.started(kind, eventModeUsed=True, earlyReturnAllowed=True) as session:
            instance, time, events = session.instance, session.time, 0
            update_discrete_states(instance)
            instance.enterStepMode()
            recorded = self.access(instance)
            for n in range(1, bench.step_count(size) + 1):
                rows.append(recorded.get())
                end = bench.start + n * size
                while time < end:
                    reject_lateness(self.end)
                    event, ends, early, last = instance.doStep(time, end - time)
                    events = events + 1 if event and last <= time else 0
                    stays = early and last <= time and not event  # else a solver may lag behind
                    if stays or last > end + beyond or events > _MOST_EVENTS:
                        fault = f"a step from {time:.9g} to {end:.9g} s ends at {last:.9g} s"
                        raise FmuError(f"in event mode, {fault}")
                    time = last if early else end
                    if ends:
                        return np.array(rows, dtype=float)
                    if event:
                        instance.enterEventMode()
                        if update_discrete_states(instance)[0]:
                            return np.array(rows, dtype=float)
                        instance.enterStepMode()
            rows.append(recorded.get())
        return np.array(rows, dtype=float)

    def is_coarse(self, allowed: Vector) -> bool:
        """Return whether co-simulation makes steps of a fixed size with events at their ends.

        In FMI 2.0 the size need not be declared; parts of a communication step are tried. Shorter
        steps must come closer to model exchange.

        Raises:
            Skipped: The time is up.
        """
        self.end = monotonic() + _FOR_IT * self.bench.timeout
        size = self.bench.internal_step("CoSimulation") or self.bench.step_size("CoSimulation")
        try:
            found = self.run(Interface.CO_SIMULATION, self.bench.tolerance, size)[1][1:]

            def stepped(parts: int, euler: bool) -> Vector:
                return self.stepped(size / parts, euler=euler)[parts - 1 :: parts][: len(found)]

            for parts, euler in product(_INNER_STEPS, (True, False)):
                other = stepped(parts, euler)
                if (np.abs(found - other) > allowed).mean() <= _MOST:
                    exact = self.run(Interface.MODEL_EXCHANGE, _TIGHT, size)[1][1 : len(other) + 1]
                    error, finer = np.abs(other - exact), np.abs(stepped(4 * parts, euler) - exact)
                    return bool(finer.mean() < _CLOSER * error.mean())
        except Skipped:
            raise
        except Exception:  # of the FMU or the solver
            return False
        return False

    def _watch(self, instance: Any) -> None:
        """Compare the states before and after each update with what the update reports."""
        update: Callable[[], tuple[Any, ...]] = instance.updateDiscreteStates
        references = {state.name: int(state.reference) for state, _ in self.bench.states()}

        def watched() -> tuple[Any, ...]:
            reject_lateness(self.end)
            before = np.array(instance.getFloat64(list(references.values())))
            result = update()
            after = np.array(instance.getFloat64(list(references.values())))
            if not result[3]:
                changed = np.flatnonzero(before != after)
                for k in changed:
                    self.silent_jumps.setdefault(list(references)[k], float(after[k] - before[k]))
            return result

        instance.updateDiscreteStates = watched


def _both(runs: _Switching, size: float) -> tuple[tuple[Vector, Vector], tuple[Vector, Vector]]:
    """Return times, s, and outputs, a size apart, in model exchange and in co-simulation.

    Raises:
        FmuError: Only model exchange fails.
        Skipped: Co-simulation fails without events, which `steps` reports.
    """
    failure: Exception | None = None
    try:
        exact = runs.run(Interface.MODEL_EXCHANGE, _TIGHT, size)
    except Exception as error:
        if runs.bench.has_events or isinstance(error, Skipped):
            raise
        failure = error
    try:
        found = runs.run(Interface.CO_SIMULATION, runs.bench.tolerance, size)
    except Exception as error:
        if runs.bench.has_events:
            raise
        raise Skipped(f"it fails in co-simulation: {error}") from error
    if failure:
        raise FmuError(f"in model exchange, not in co-simulation: {failure}") from failure
    return exact, found


def switching(bench: Bench, kind: str) -> Iterator[Finding | Note]:
    """Co-simulation and model exchange agree over the default experiment, events included."""
    if kind != "CoSimulation" or "ModelExchange" not in bench.described.interfaces:
        raise Skipped("it compares co-simulation with model exchange")
    every = (v for v in bench.described.variables if v.causality == "output")
    numbers = [v for v in every if NUMERIC.fullmatch(v.kind) and not v.shape]
    runs = _Switching(bench, numbers, monotonic() + _FOR_IT * bench.timeout)
    if not runs.outputs or not bench.states():
        raise Skipped("it has neither states nor outputs that are numbers")
    size = bench.output_interval(kind)
    (times, exact), (reached, found) = _both(runs, size)
    for name, jump in runs.silent_jumps.items():
        text = f"it jumps by {jump:.3g} at an event that does not report changed states"
        yield TRIAL_RULES["silent-jump"].at(name, text)
    early, coarse = runs.run(Interface.MODEL_EXCHANGE, bench.tolerance, size)
    doubt = max(size, bench.step_size(kind)) * (1 + 1e-9) + 10 * abs(early[-1] - times[-1])
    if abs(reached[-1] - times[-1]) > doubt:
        text = f"it ends at {reached[-1]:.6g} s, model exchange at {times[-1]:.6g} s"
        yield TRIAL_RULES["ends-otherwise"].at(kind, text)
    rows = min(len(exact), len(coarse), len(found))
    rows -= rows < bench.step_count(size) + 1  # ends need not be at one time
    exact, coarse, found = exact[:rows], coarse[:rows], found[:rows]
    Skipped.when(not rows, "it ends by itself before")
    nominal = np.maximum([v.nominal for v in runs.outputs], np.abs(exact).max(axis=0))
    least = _SHARE * np.ptp(exact, axis=0) + 10 * bench.tolerance * nominal
    allowed = least + 10 * np.abs(coarse - exact)
    yield from _compared(runs, times, exact, found, allowed)
    if not bench.second and bench.offers(kind, "hasEventMode") and bench.has_events:
        stopped = runs.in_event_mode(size)[:rows]
        allowed = (allowed + 2 * np.abs(found - exact))[: len(stopped)]
        yield from _compared(runs, times, exact, stopped, allowed, "in event mode, ")


def _compared(
    runs: _Switching,
    times: Vector,
    exact: Vector,
    found: Vector,
    allowed: Vector,
    mode: str = "",
) -> Iterator[Finding | Note]:
    """Compare rows of outputs; steps of a fixed size may explain a difference."""
    bench, exact = runs.bench, exact[: len(found)]
    differs = (np.abs(found - exact) > allowed) | (np.isfinite(found) != np.isfinite(exact))
    shares = differs.mean(axis=0)
    worst = int(np.argmax(shares))
    if shares[worst] <= _MOST:
        yield Note(f"{mode}{len(found)} points, {shares[worst]:.1%} of them differ")
        return
    coarse_steps = not mode and runs.is_coarse(allowed.min(axis=0))
    if coarse_steps and (bench.internal_step("CoSimulation") or not bench.has_events):
        yield Note("the fixed step of its solver explains the differences")  # see `motion`
        return
    rule = "moves-coarsely" if coarse_steps else "switches-otherwise"
    yield TRIAL_RULES[rule].at(
        runs.outputs[worst].name,
        f"{mode}from {times[int(np.argmax(differs[:, worst]))]:.6g} s on, it differs from model "
        f"exchange with another solver, by up to {np.abs(found - exact)[:, worst].max():.2g} "
        f"(range: {np.ptp(exact[:, worst]):.2g})",
    )
