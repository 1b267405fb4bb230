"""Masters in Python: loops that drive an FMU through fmpy's objects, with the steps of fmpy.

Without inputs, the numbers are those of `fmpy.simulate_fmu` bit for bit. Inputs follow a series
more closely: in model exchange at every evaluation, in co-simulation piece by piece. A step ends
at every sample, however close to an output time it is; fmpy moves samples there.
"""

import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import pairwise
from math import inf
from threading import current_thread, main_thread
from types import FrameType
from typing import Any

import numpy as np

from cosim.arrays import Vector
from cosim.errors import FmuError
from cosim.fmi.run.description import Interface
from cosim.fmi.run.deviations import Deviations
from cosim.fmi.run.instance import (
    access_to,
    enter_continuous_time,
    initialize,
    update_discrete_states,
)
from cosim.fmi.run.kept_rows import new_rows
from cosim.fmi.run.request import FmuRequest, MasterRun, nominals_of
from cosim.fmi.run.typed_values import REALS, is_continuous
from cosim.host.progress import doing
from cosim.model.growth import Growth
from cosim.model.inputs import InputSeries, moved_to, rounding_of
from cosim.model.times import one_time
from cosim.model.troughs import Trough

_STEPS_OF_A_RUN = 50  # the least number of steps of a run by CVODE, as in fmpy


def run_in_python(instance: Any, request: FmuRequest) -> MasterRun:
    """Initialize an FMU and run it; it is not terminated yet.

    Raises:
        Exception: A call of the FMU or the solver failed.
        FmuError: The FMU stopped before the stop time without ending the run.
        KeyboardInterrupt: The user pressed Ctrl-C.
    """
    exchange = request.interface is Interface.MODEL_EXCHANGE
    loop = _model_exchange if exchange else _co_simulation
    with _noticed_interrupts() as interrupts:
        try:
            initialize(instance, request.description, request.initial_values, **request.experiment)
            recorder = _Recorder(instance, request)
            with doing("running the FMU", recorder.fraction):
                stats, growth = loop(instance, request, recorder, interrupts)
        except Exception as error:
            if interrupts:
                raise KeyboardInterrupt from error
            raise
        if interrupts:
            raise KeyboardInterrupt
    return MasterRun(*recorder.recorded, stats, growth)


class _Recorder:
    """Records the outputs of a request at its communication points."""

    def __init__(self, instance: Any, request: FmuRequest) -> None:
        self._get = access_to(request.recorded, instance, request.description).get
        self.times = np.empty(len(request.points))
        self.rows = new_rows(request)
        self._count = 0

    def record(self, time: float) -> None:
        """Write the next row."""
        self.times[self._count] = time
        self.rows[self._count] = self._get()
        self._count += 1

    @property
    def recorded(self) -> tuple[Vector, Vector]:
        """The times, s, and a row of outputs for each."""
        return self.times[: self._count], self.rows[: self._count]

    def fraction(self) -> float:
        """Return how much of the run is done, 0 to 1."""
        return self._count / len(self.times)


def _ended(time: float, recorder: _Recorder) -> dict[str, Any]:
    """Record where an FMU ends its run, and return the time for the statistics."""
    if time > recorder.recorded[0][-1]:
        recorder.record(time)
    return {"stop_time": time}


def _stopped_early(time: float, request: FmuRequest) -> FmuError:
    return FmuError(f"the run ended at {time:g} s, before the stop time {request.stop:g} s")


def _model_exchange(
    instance: Any, request: FmuRequest, recorder: _Recorder, interrupts: Sequence[int]
) -> tuple[dict[str, Any], Growth | Trough | None]:
    """Integrate with CVODE from event to event and from output time to output time."""
    description, start = request.description, request.start
    time, *targets = request.points.tolist()
    next_event = enter_continuous_time(instance)
    clock = Clock(instance, request)
    solver = _solver(instance, request, clock, interrupts)
    needs_completed_step = description.modelExchange.needsCompletedIntegratorStep
    recorder.record(time)
    deviations = Deviations(instance, request, clock, every=True)
    deviations.note(time)
    stats: dict[str, Any] = {}
    for target in targets:
        while not stats:
            input_event = clock.next_event(time)
            goal = min(target, input_event)
            if goal > next_event and not one_time(goal, next_event, start):
                goal = next_event
            happens, _, reached = solver.step(time, goal)
            if not reached > time:
                raise _stopped_early(time, request)
            time = reached
            clock.set(time)
            happens |= goal == input_event or one_time(goal, next_event, start)
            ends = False
            if needs_completed_step:
                step_event, ends = instance.completedIntegratorStep()
                happens |= step_event
            deviations.note(time)
            if happens and not ends:
                deviations.pass_event(solver.steps)
                ends, next_event = _pass_event(instance, clock, solver, time)
                deviations.note(time)
            if ends and not one_time(time, request.stop, start):
                stats = _ended(time, recorder)
            elif goal == target and one_time(time, target, start):
                recorder.record(time)
                break
        if stats:
            break
    deviations.judge(solver.steps)
    stats |= {"rhs_calls": solver.rhs_calls, **_note(solver.many_steps)}
    return stats, deviations.found


def _pass_event(instance: Any, clock: "Clock", solver: Any, time: float) -> tuple[bool, float]:
    """Let an FMU handle an event.

    Returns:
        Whether it ends the run, and the time of its next event, s.
    """
    instance.enterEventMode()
    clock.pass_event(time)
    ends, next_event = update_discrete_states(instance)
    if not ends:
        instance.enterContinuousTimeMode()
        solver.reset(time)
    return ends, next_event


def _note(many_steps: tuple[float, float] | None) -> dict[str, str]:
    """Return a note for the statistics on an interval in which CVODE took many steps."""
    from cosim.fmi.run.cvode import USUAL_STEPS

    if many_steps is None:
        return {}
    begin, end = many_steps
    note = f"CVODE took more than {USUAL_STEPS} steps between two outputs, from {begin:.6g} to "
    note += f"{end:.6g} s: a jump, or a singularity from which it may have continued along another "
    return {"note": f"{note}solution; compare with co-simulation"}


def _solver(instance: Any, request: FmuRequest, clock: "Clock", interrupts: Sequence[int]) -> Any:
    from cosim.fmi.run.cvode import Cvode

    description, start = request.description, request.start
    relative, closer = request.relative_tolerance, request.closer

    def nominals(values: Any, count: int) -> None:
        """Fill in the nominal values so that CVODE takes the absolute tolerance."""
        sizes = np.ctypeslib.as_array(values, (count,))
        sizes[:] = nominals_of(instance, count)
        if closer and clock.time < closer.until:
            sizes *= closer.shares

    return Cvode(
        interrupts,
        nx=description.numberOfContinuousStates,
        nz=description.numberOfEventIndicators,
        get_x=instance.getContinuousStates,
        set_x=instance.setContinuousStates,
        get_dx=instance.getContinuousStateDerivatives,
        get_z=instance.getEventIndicators,
        get_nominals=nominals,
        set_time=clock.set,
        input=clock,
        startTime=start,
        maxStep=min(request.max_step or inf, (request.stop - start) / _STEPS_OF_A_RUN),
        relativeTolerance=relative,
    )


class Followers:
    """Sets the inputs that follow a series: continuous ones at any time, others at events.

    Attributes:
        continuous: Places of the continuous inputs among all that follow.
        set_all, set_continuous: Set those inputs to the values of a row of all that follow.
    """

    def __init__(self, instance: Any, request: FmuRequest) -> None:
        variables = request.followers
        facts = instance, request.description, variables
        self.continuous = [i for i, v in enumerate(variables) if is_continuous(v)]
        self.set_all = _setter(*facts, range(len(variables)))
        self.set_continuous = _setter(*facts, self.continuous)


def _setter(
    instance: Any, description: Any, variables: Sequence[Any], places: Sequence[int]
) -> Callable[[Sequence[float]], None]:
    """Return what sets those variables that have some places in a row."""
    chosen = [(i, float if variables[i].type in REALS else int) for i in places]
    access = access_to([variables[i] for i in places], instance, description)
    return lambda row: access.set([kind(row[i]) for i, kind in chosen])


class Clock:
    """Sets the time of an FMU for model exchange, and the inputs that follow a series.

    The solver restarts at every sample of the series, so that it steps over no kink and no pulse.
    Between two jumps it sees one piece of the series, even where it evaluates beyond the jump.

    Attributes:
        time: The present time, s.
    """

    def __init__(self, instance: Any, request: FmuRequest) -> None:
        self._set_time, self._series = instance.setTime, request.inputs
        self._followers = Followers(instance, request)
        samples = _sample_times(self._series, request) if self._series else np.empty(0)
        ends = [request.closer.until] if request.closer else []
        self._events = np.union1d(samples, ends).tolist()
        self.time = self._start = request.start
        self._piece = self._series and _after(self._series, request.start, request.start)

    def set(self, time: float) -> None:
        """Set the time and the continuous inputs."""
        self.time = time
        self._set_time(time)
        if self._piece is not None:
            self._followers.set_continuous(_values(self._piece, time))

    def apply(self, time: float) -> None:
        """Do nothing: fmpy's solver calls it after `set`, which has set the inputs."""

    def next_event(self, time: float) -> float:
        """Return the time of the next sample, s; infinity if there is none."""
        after = time + rounding_of(time, self._start)
        return next((event for event in self._events if event > after), inf)

    def pass_event(self, time: float) -> None:
        """Follow the piece of the series that begins at an event."""
        if self._series is not None:
            self._piece = _after(self._series, time, self._start)
            self._followers.set_all(_values(self._piece, time))


def _co_simulation(
    instance: Any, request: FmuRequest, recorder: _Recorder, interrupts: Sequence[int]
) -> tuple[dict[str, Any], None]:
    """Step from one communication point to the next."""
    points = request.points.tolist()
    step = _plain_step(instance)
    if request.inputs is not None:
        step = _step_with_inputs(instance, request, request.inputs, step)
    recorder.record(points[0])
    for begin, end in pairwise(points):
        reached, ends = step(begin, end)
        if interrupts:
            raise KeyboardInterrupt
        if ends and reached < points[-1]:
            return _ended(reached, recorder), None
        if reached < end:
            raise _stopped_early(reached, request)
        recorder.record(end)
    return {}, None


_Step = Callable[[float, float], tuple[float, bool]]  # begin, end -> time reached, whether it ends


def _plain_step(instance: Any) -> _Step:
    def step(begin: float, end: float) -> tuple[float, bool]:
        _, ends, early, last = instance.doStep(begin, end - begin)
        if early and not ends:
            raise FmuError("FMU returned early from doStep() but Early Return is not allowed.")
        is_known = ends and last >= begin  # it is 0 in files that do not tell where they end
        return (min(last, end) if is_known else end), ends

    return step


def _step_with_inputs(
    instance: Any, request: FmuRequest, series: InputSeries, step: _Step
) -> _Step:
    """Return a step whose inputs follow a series, in substeps that end at every sample.

    An FMU that can interpolate gets the slope of each piece; one that asks within its step gets the
    values. Another one gets the value at the piece's middle, which leaves an error of second order
    in the step; of first order if inputs jump within the step of an FMU whose steps have one size.
    """
    abilities, references = request.description.coSimulation, request.input_references
    followers = Followers(instance, request)
    any_step = abilities.canHandleVariableCommunicationStepSize
    samples = _sample_times(series, request)
    set_slopes = getattr(instance, "setRealInputDerivatives", None)
    slopes = set_slopes if abilities.canInterpolateInputs else None
    failures: list[Exception] = []  # of answers: ctypes drops what a callback raises

    def answer(piece: InputSeries, time: float) -> None:
        try:
            followers.set_continuous(_values(piece, time))
        except Exception as error:
            failures.append(error)

    def driven(begin: float, end: float) -> tuple[float, bool]:
        inner = samples[(samples > begin) & (samples < end)] if any_step else samples[:0]
        reached, ends = begin, False
        for a, b in pairwise([begin, *inner.tolist(), end]):
            piece = series.around((a + b) / 2)
            first, middle, last = piece.at(np.array([a, (a + b) / 2, b])).T
            followers.set_all((first if slopes else middle).tolist())
            if slopes and references:
                rates = (last - first)[followers.continuous] / (b - a)
                slopes(references, [1] * len(references), rates.tolist())
            instance.answer = partial(answer, piece)
            reached, ends = step(a, b)
            if failures:
                raise failures[0]
            if reached < b or ends:
                return reached, ends
        following = _after(series, end, request.start)
        if not slopes or following is not piece:
            followers.set_all(_values(following, end))
        return reached, ends

    return driven


def _sample_times(series: InputSeries, request: FmuRequest) -> Vector:
    """Return the times of the samples of a series, s; rounding moves none off an output time."""
    return np.unique(moved_to(request.points, series.time))


def _after(series: InputSeries, time: float, start: float) -> InputSeries:
    """Return the piece of a series between two jumps that follows a time of a run, s."""
    return series.around(time + rounding_of(time, start))


def _values(series: InputSeries, time: float) -> list[float]:
    values: list[float] = series.at(np.array([time]))[:, 0].tolist()
    return values


@contextmanager
def _noticed_interrupts() -> Iterator[list[int]]:
    """Collect the signals of Ctrl-C: ctypes forgets a KeyboardInterrupt raised in a callback.

    The second signal does what it usually does.
    """
    seen: list[int] = []
    usual = signal.getsignal(signal.SIGINT)
    if current_thread() is not main_thread() or not callable(usual):
        yield seen
        return

    def notice(number: int, frame: FrameType | None) -> None:
        seen.append(number)
        if len(seen) > 1:
            usual(number, frame)

    signal.signal(signal.SIGINT, notice)
    try:
        yield seen
    finally:
        signal.signal(signal.SIGINT, usual)
