"""The trial of co-simulation against model exchange under another solver, Runge and Kutta's."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from cosim.arrays import Vector
from cosim.fmi.check.finding import TRIAL_RULES, Finding
from cosim.fmi.check.parsed import Described
from cosim.fmi.check.trials.bench import Bench, Note, Session, Skipped, altered
from cosim.fmi.run.instance import enter_continuous_time

_STEPS = 40  # communication steps
_CHANGE = 20  # of them are made before parameters change
_SHARE = 1e-4  # of a range: a difference that counts
_DOUBLINGS = 7  # of the number of Runge-Kutta steps


def motion(bench: Bench, kind: str) -> Iterator[Finding | Note]:
    """Co-simulation moves as model exchange does, also with other inputs and parameters."""
    if kind != "CoSimulation" or "ModelExchange" not in bench.described.interfaces:
        raise Skipped("it compares co-simulation with model exchange")
    if bench.fmpy.numberOfEventIndicators:
        raise Skipped("it has events, which this trial does not locate")
    course = _Course(bench, bench.reals("input", "continuous"), bench.reals("parameter", "tunable"))
    Skipped.when(not course.outputs or not bench.states(), "it has no continuous outputs")
    try:
        found, exact = course.co_simulated(), course.exchanged()
    except Skipped:
        raise
    except Exception:  # it may reject values
        course = replace(course, inputs=[], parameters=[])
        found, exact = course.co_simulated(), course.exchanged()
    Skipped.when(not len(found), "it ends by itself before")
    difference, rows = np.abs(found - exact[: len(found)]).max(axis=0), slice(len(found))
    ratio = difference / course.allowed(exact)
    worst = int(np.argmax(ratio))
    if ratio[worst] <= 1:
        changed = len(course.inputs) + len(course.parameters)
        yield Note(f"{ratio[worst]:.2g} of the difference that counts, {changed} values changed")
        return
    facts = f"it differs by {difference[worst]:.2g} from model exchange with another solver"
    rule = TRIAL_RULES["moves-otherwise"]
    if not bench.internal_step(kind):
        finer = np.abs(course.co_simulated(2)[rows] - exact[rows]).max(axis=0)[worst]
        facts += f", with half the step by {finer:.2g}"
        euler = np.abs(course.integrated(1, euler=True)[rows] - found)[:, worst].max()
        if min(finer / 0.7, euler / 0.01) < difference[worst]:
            rule = TRIAL_RULES["moves-coarsely"]
            if course.follows and course.inputs and replace(course, held=True).agrees():
                rule = TRIAL_RULES["moves-otherwise"]
                facts += ", and agrees if inputs are constant in steps: it ignores derivatives"
    spread = np.ptp(exact[:, worst])
    yield rule.at(course.outputs[worst].name, f"{facts} (range: {spread:.2g})")


@dataclass(frozen=True)
class _Course:
    """A run over equal communication steps.

    Attributes:
        bench: The FMU.
        inputs: They rise over the run.
        parameters: They change within the run.
        held: Inputs are constant in each step, although the FMU takes their derivatives.
    """

    bench: Bench
    inputs: list[Described]
    parameters: list[Described]
    held: bool = False

    @property
    def outputs(self) -> list[Described]:
        return self.bench.reals("output", "continuous")

    def agrees(self) -> bool:
        """Return whether no difference from model exchange counts."""
        found, exact = self.co_simulated(), self.exchanged()
        return bool((np.abs(found - exact[: len(found)]) <= self.allowed(exact)).all())

    @property
    def size(self) -> float:
        """Size of the steps, s."""
        return self.bench.step_size("CoSimulation")

    @property
    def follows(self) -> bool:
        """Whether inputs follow a line within a step; they are held otherwise."""
        offered = self.bench.offers("CoSimulation", "canInterpolateInputs")
        return not self.held and self.bench.second and offered

    def allowed(self, exact: Vector) -> Vector:
        """Return the difference of each output that its solver's tolerance or step explains."""
        nominal = [v.nominal for v in self.outputs]
        size = np.maximum(nominal, np.abs(exact).max(axis=0))
        allowed = _SHARE * np.ptp(exact, axis=0) + 10 * self.bench.tolerance * size
        if step := self.bench.internal_step("CoSimulation"):  # as of Euler's method, often
            coarse = self.integrated(round(self.size / step), euler=True)
            allowed += 2 * np.abs(coarse - exact).max(axis=0)
        return np.asarray(allowed)

    def exchanged(self) -> Vector:
        """Return the outputs in model exchange, (steps, outputs), exact enough.

        Raises:
            Skipped: It has events, or is too stiff.
        """
        last = self.integrated(1)
        for doubling in range(1, _DOUBLINGS):
            found = self.integrated(2**doubling)
            noise = _SHARE * np.ptp(found, axis=0) / 10 + 1e-9 * np.abs(found).max()
            if (np.abs(found - last) <= noise).all():
                return found
            last = found
        raise Skipped("it is too stiff for explicit steps in model exchange")

    def co_simulated(self, parts: int = 1) -> Vector:
        """Return the outputs in co-simulation, (steps, outputs), each step in equal parts."""
        rows = []
        with self.bench.started("CoSimulation") as session:
            start, rise = self._line(session)
            slots = [int(v.reference) for v in self.inputs]
            for i in range(_STEPS * parts):
                if i == _CHANGE * parts:
                    self._change(session)
                at = i / parts if self.follows else i // parts
                session.put_all(self.inputs, start + at * rise)
                if self.follows and slots:
                    orders = [1] * len(slots)
                    session.instance.setRealInputDerivatives(slots, orders, rise / self.size)
                if not list(session.steps(self.size / parts, 1)):
                    break
                if (i + 1) % parts == 0:
                    rows.append(session.values(self.outputs))
        return np.array(rows)

    def integrated(self, parts: int, *, euler: bool = False) -> Vector:
        """Return the outputs in model exchange, each step in equal parts of a simple method."""
        rows, h = [], self.size / parts
        states, rates = zip(*self.bench.states(), strict=True)
        with self.bench.started("ModelExchange") as session:
            begin = self.bench.start
            if session.next_event < begin + _STEPS * self.size:
                raise Skipped("it has time events, which this trial does not locate")
            start, rise = self._line(session)
            x = session.values(states)

            def slope(at: float, x: Vector) -> Vector:
                session.instance.setTime(begin + at * self.size)
                session.put_all(self.inputs, start + (at if self.follows else step) * rise)
                session.put_states(x)
                return session.values(rates)

            for step in range(_STEPS):
                if step == _CHANGE and self.parameters:
                    session.instance.enterEventMode()
                    self._change(session)
                    enter_continuous_time(session.instance)
                for part in range(parts):
                    t, middle, end = (step + (part + c) / parts for c in (0, 0.5, 1))
                    k = slope(t, x)
                    if not euler:
                        k2 = slope(middle, x + h / 2 * k)
                        k3 = slope(middle, x + h / 2 * k2)
                        k = (k + 2 * k2 + 2 * k3 + slope(end, x + h * k3)) / 6
                    x = x + h * k
                slope(step + 1, x)
                rows.append(session.values(self.outputs))
        return np.array(rows)

    def _line(self, session: Session) -> tuple[Vector, Vector]:
        """Return the inputs at the start, and how much they rise in a step."""
        start = session.values(self.inputs)
        ends = [altered(v, value, 0.1) for v, value in zip(self.inputs, start, strict=True)]
        return start, (np.array(ends) - start) / _STEPS

    def _change(self, session: Session) -> None:
        now = session.values(self.parameters)
        new = [altered(v, value, 0.02) for v, value in zip(self.parameters, now, strict=True)]
        session.put_all(self.parameters, new)
