"""Trials of an FMU's steps, of what it does to its process, and of calls beside its steps."""

import ctypes
import os
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import chdir, suppress
from itertools import islice
from math import isclose
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np

from cosim.arrays import Vector
from cosim.fmi.check.finding import TRIAL_RULES, Finding
from cosim.fmi.check.parsed import Described
from cosim.fmi.check.trials.bench import (
    MEMORY_GROWTH,
    MOST_NAMES,
    Bench,
    Note,
    Session,
    Skipped,
    memory_in_use,
)
from cosim.fmi.check.trials.derivatives import need_model_exchange, offers_directional
from cosim.fmi.check.trials.start import few_numbers, moved
from cosim.fmi.run.typed_values import REALS
from cosim.host.temporary import temporary_folder

MOST_MADE = 1_000_000
SIZE = 1 / 60  # s
_FOR_STEPS, _FOR_INSTANCES = 1 / 12, 1 / 24  # share of all time
_FEW_STEPS = 10
_MOST_INSTANCES = 10_000
_MOST_LOOKS, _AT_ONCE = 400, 100  # at the memory; calls between two of them
_MOST_WITHOUT_UPDATE = 1000  # steps of one size
_NOISE = 1e-12  # of numbers that two functions give
_ROUNDING = 1e-6  # of a nominal value, as people write it
_REMEMBERED = 1e-6  # of a value: what iterations inside may leave of earlier calls


def steps(bench: Bench, kind: str) -> Iterator[Finding | Note]:
    """A million steps of 1/60 s, as far as the time allows, their ends summed up."""
    _needs_free_steps(bench, kind)
    end, made, looked = monotonic() + _FOR_STEPS * bench.timeout, 0, 0
    stop, used = bench.experiment("stopTime"), [memory_in_use()]
    with bench.started(kind) as session:
        recorded = session.access(bench.numbers(*REALS)).get
        try:
            for made, time in enumerate(session.steps(SIZE, MOST_MADE), start=1):
                if not np.isfinite(recorded()).all():
                    beyond = stop is not None and time > stop  # where what grows may overflow
                    found = f"not finite at {time:.6g} s"
                    yield Note(found) if beyond else TRIAL_RULES["not-finite"].at(kind, found)
                    return
                if made >= 2 * looked:
                    used, looked = [used[-1], memory_in_use()], made
                if monotonic() > end:
                    break
        except Exception as error:
            if stop is None or session.time + SIZE <= stop:
                fatal = "(fatal)" in str(error)  # after which no instance may be made
                own = fatal or _own_steps_fail(bench, kind, session.time + SIZE)
                found = f"a step of 1/60 s fails at {session.time:.6g} s: {error}"
                yield (TRIAL_RULES["failing"] if own else TRIAL_RULES["sums"]).at(kind, found)
                return
            if "(fatal)" not in str(error) and _own_steps_fail(bench, kind, stop - SIZE):
                found = f"after {made} steps ({error}), a new instance does not reach {stop:g} s"
                yield TRIAL_RULES["failing"].at(kind, found)
                return
            yield Note(f"{made} steps of 1/60 s, beyond its stop time; then: {error}")
            return
        if (growth := used[-1] - used[0]) > MEMORY_GROWTH:
            found = f"{growth / 1e6:.1f} MB are lost in the second half of {looked} steps"
            yield TRIAL_RULES["memory"].at(kind, found)
        yield Note(f"{made} steps of 1/60 s, to {session.time:.6g} s")


def stop(bench: Bench, kind: str) -> Iterator[Finding]:
    """A step ends a rounding error beyond the stop time; a whole step beyond it is rejected."""
    _needs_free_steps(bench, kind)
    size = bench.step_size(kind)
    with bench.session(kind) as session:
        ends = bench.start
        for _ in range(_FEW_STEPS):
            ends += size
        limit = np.nextafter(ends, -np.inf)  # which the last step exceeds by a rounding error
        session.start(stop_time=float(limit))
        try:
            done = len(list(session.steps(size, _FEW_STEPS)))
        except Exception as error:
            early = session.time < ends - 1.5 * size or "(fatal)" in str(error)
            if early or _own_steps_fail(bench, kind, float(ends)):
                raise
            found = (
                f"the last step ends {ends - limit:.1g} s beyond the stop time and fails: {error}"
            )
            yield TRIAL_RULES["rejected-end"].at(kind, found)
            return
        Skipped.when(done < _FEW_STEPS, "it ends by itself before")
        try:
            beyond = len(list(session.steps(size, 1)))
        except Exception:
            return
        if beyond:
            yield TRIAL_RULES["beyond"].at(
                kind, f"a step of {size:g} s beyond the stop time is made"
            )


def _own_steps_fail(bench: Bench, kind: str, until: float) -> bool:
    """Return whether steps of the FMU's own size fail to reach a time as well."""
    size = bench.step_size(kind)
    with bench.started(kind) as session:
        try:
            for i in range(int((until - bench.start) / size) + 1):
                end = bench.start + (i + 1) * size
                for _ in session.steps(end - session.time, 1):
                    session.time = end
        except Exception:
            return True
    return False


def _needs_free_steps(bench: Bench, kind: str) -> None:
    Skipped.when(kind != "CoSimulation", "it is a trial of co-simulation")
    if not bench.offers(kind, "canHandleVariableCommunicationStepSize"):
        raise Skipped("it may require steps of its own size")


def quiet(bench: Bench, kind: str) -> Iterator[Finding]:
    """It writes neither to standard output nor into the current folder."""
    rule = TRIAL_RULES["quiet"]
    c = ctypes.CDLL(None) if os.name == "posix" else ctypes.cdll.msvcrt
    sys.stdout.flush()
    c.fflush(None)
    with temporary_folder() as place, tempfile.TemporaryFile() as written:
        saved = os.dup(1)
        os.dup2(written.fileno(), 1)
        try:
            with chdir(place), bench.session(kind) as session:
                few_numbers(session)
            c.fflush(None)
        finally:
            os.dup2(saved, 1)
            os.close(saved)
        written.seek(0)
        if text := written.read():
            yield rule.at(kind, f"it writes {len(text)} bytes to standard output: {text[:40]!r}")
        for file in islice(Path(place).iterdir(), 1):
            yield rule.at(kind, f"it writes '{file.name}' into the current folder")


def memory(bench: Bench, kind: str) -> Iterator[Finding | Note]:
    """Memory does not grow with instances and calls; `steps` looks whether it does with steps."""
    if bench.offers(kind, "canBeInstantiatedOnlyOncePerProcess"):
        raise Skipped("it can be instantiated once per process only")
    end, used = monotonic() + _FOR_INSTANCES * bench.timeout, [memory_in_use()]
    with bench.session(kind) as session:
        while len(used) <= _MOST_INSTANCES and monotonic() < end:
            session.start()
            try:
                session.instantiate_bare(logger=True)
            except Exception as error:
                raise Skipped(f"it does not instantiate again: {error}") from error
            used.append(memory_in_use())
    if (growth := used[-1] - used[len(used) // 2]) > MEMORY_GROWTH:
        found = f"{growth / 1e6:.1f} MB are lost in {len(used) // 2} instances"
        yield TRIAL_RULES["memory"].at(kind, found)
    yield from _leaking_calls(bench, kind, _FOR_INSTANCES * bench.timeout)
    yield Note(f"{len(used) - 1} instances")


def _leaking_calls(bench: Bench, kind: str, seconds: float) -> Iterator[Finding]:
    """Repeat each call that importers make often on one instance, for some time in all."""
    inputs, states = bench.reals("input", "continuous"), bench.reals("output")
    with suppress(Skipped):
        states = [state for state, _ in bench.states()]
    with bench.started(kind) as session:
        instance, values = session.instance, session.values(inputs)

        def store() -> None:
            state = instance.getFMUState()
            instance.setFMUState(state)
            instance.freeFMUState(state)

        stores = bench.offers(kind, "canGetAndSetFMUstate", "canGetAndSetFMUState")
        differentiates = offers_directional(bench, kind) and inputs and states
        calls: dict[str, Callable[[], object]] = {
            "getting values": lambda: session.values(states),
            "setting inputs": lambda: session.put_all(inputs, values),
        }
        if stores:
            calls["storing and restoring its state"] = store
        if differentiates:
            calls["directional derivatives"] = lambda: session.slopes(states, inputs[0])
        for name, call in calls.items():
            end, used = monotonic() + seconds / len(calls), list[int]()
            with suppress(Exception):  # what fails is for other trials
                while len(used) <= _MOST_LOOKS and monotonic() < end:
                    for _ in range(_AT_ONCE):
                        call()
                    used.append(memory_in_use())
            half = len(used) // 2
            if half and (growth := used[-1] - used[half]) > MEMORY_GROWTH:
                found = f"{growth / 1e6:.1f} MB are lost in {_AT_ONCE * half} calls: {name}"
                yield TRIAL_RULES["memory"].at(kind, found)


def exchange(bench: Bench, kind: str) -> Iterator[Finding]:
    """Functions of all states at once agree with the variables; a completed step moves nothing."""
    need_model_exchange(kind)
    states, rates = zip(*bench.states(), strict=True)
    rule = TRIAL_RULES["exchange"]
    with bench.started(kind) as session:
        if session.next_event < bench.start:
            yield rule.at(kind, f"its next event is at {session.next_event:.6g} s, in the past")
        nominals = session.all_of("getNominalsOfContinuousStates", len(states))
        if not (np.isfinite(nominals) & (nominals > 0)).all():
            yield rule.at(kind, f"a state has the nominal value {nominals.min():g}")
        for state, nominal in zip(states, nominals, strict=True):
            if "nominal" in state.texts and not isclose(nominal, state.nominal, rel_tol=_ROUNDING):
                text = f"its nominal value is {nominal:g}, in the file {state.nominal:g}"
                yield TRIAL_RULES["nominals"].at(state.name, text)
        indicators = bench.fmpy.numberOfEventIndicators or 0
        session.all_of("getEventIndicators", indicators)
        if not bench.second:
            counts = ("ContinuousStates", len(states)), ("EventIndicators", indicators)
            for name, count in counts:
                number = ctypes.c_size_t()
                getattr(session.instance, f"fmi3GetNumberOf{name}")(
                    session.instance.component, ctypes.byref(number)
                )
                if number.value != count:
                    fault = f"fmi3GetNumberOf{name} gives {number.value}, its file lists {count}"
                    yield rule.at(kind, fault)
        yield from _remembered(session, [*rates, *bench.reals("output", "continuous")])
        discrete = [*bench.reals("output", "discrete"), *bench.reals("local", "discrete")]
        before = session.values(discrete)
        _, ends = session.instance.completedIntegratorStep()
        if ends:
            yield rule.at(kind, "it ends the run after a step of length 0")
        given = moved(session.values(states))
        session.put_states(given)
        after = session.values(discrete)
        changed = (after != before) & ~(np.isnan(after) & np.isnan(before))
        for i in np.flatnonzero(changed)[:MOST_NAMES]:
            yield rule.at(discrete[i].name, "it is discrete, and changes with a state at no event")
        session.instance.completedIntegratorStep()
        slopes = "getDerivatives" if bench.second else "getContinuousStateDerivatives"
        for function, variables in ("getContinuousStates", states), (slopes, rates):
            own = session.values(variables)
            expected = given if variables is states else own
            found = session.all_of(function, len(own))
            allowed = _NOISE * np.maximum(np.abs(expected), 1.0)
            wrong = ~((np.abs(found - expected) <= allowed) & (np.abs(own - expected) <= allowed))
            for i in np.flatnonzero(wrong)[:MOST_NAMES]:
                fault = f"{function} gives {found[i]:.10g}, its variable is {own[i]:.10g}"
                yield rule.at(variables[i].name, fault)


def _remembered(session: Session, variables: Sequence[Described]) -> Iterator[Finding]:
    """Reach one time from a near and from a far time: variables do not remember the way."""
    size = 0.1 * session.bench.step_size(session.kind)
    start, found = session.bench.start, list[Vector]()
    if session.next_event <= start + 50 * size:
        return
    for before in (start, start + 50 * size):
        session.instance.setTime(before)
        session.values(variables)
        session.instance.setTime(start + size)
        found.append(session.values(variables))
    session.instance.setTime(start)
    allowed = _REMEMBERED * np.maximum(np.abs(found[1]), [v.nominal for v in variables])
    same = (np.abs(found[0] - found[1]) <= allowed) | np.isnan(found).all(axis=0)
    for i in np.flatnonzero(~same)[:MOST_NAMES]:
        text = f"it is {found[0][i]:.10g} and {found[1][i]:.10g} at one time, after other times"
        yield TRIAL_RULES["exchange"].at(variables[i].name, text)


def calls(bench: Bench, kind: str) -> Iterator[Finding]:
    """It tells its version; its outputs can be read after the end, as the last step left them."""
    outputs = bench.reals("output")
    with bench.session(kind) as session:
        instance = session.instance
        second = {"fmi2GetVersion": "2.0", "fmi2GetTypesPlatform": "default"}
        names = second if bench.second else {"fmi3GetVersion": "3.0"}
        for name, expected in names.items():
            function = instance.dll[name]
            function.restype = ctypes.c_char_p
            if (said := (function() or b"").decode(errors="replace")) != expected:
                yield TRIAL_RULES["calls"].at(name, f"it is '{said}', not '{expected}'")
        session.start()
        instance.setDebugLogging(False, [])
        if kind == "CoSimulation" and not bench.second:
            yield from _answers_of_a_step(session)
        last = session.values(outputs)
        instance.terminate()
        if session.values(outputs).tobytes() != last.tobytes():
            yield TRIAL_RULES["calls"].at(kind, "its outputs change at the end")
    if bench.offers(kind, "providesIntermediateUpdate"):
        yield from _updates(bench, kind)


def _updates(bench: Bench, kind: str) -> Iterator[Finding]:
    """Steps of FMI 3.0 call the importer back, at times within them."""
    times = list[float]()
    names = [int(v.reference) for v in bench.reals("input", "continuous")]
    callback: dict[str, Any] = {
        "intermediateUpdate": lambda _environment, time, *_: times.append(time),
        "requiredIntermediateVariables": names,
    }
    size, longer = bench.output_interval(kind), 1
    if bench.offers(kind, "canHandleVariableCommunicationStepSize"):
        longer = 2  # than those of the solver inside
    with bench.started(kind, **callback) as session:
        begin = session.time
        for _ in range(_MOST_WITHOUT_UPDATE):
            if times or session.time + size > bench.start + bench.span:
                break
            if not list(session.steps(size, 1)):
                break
            size *= longer
        end = session.time
    noise = 1e-9 * max(abs(end), end - begin)
    wrong = [time for time in times if not begin - noise <= time <= end + noise]
    if wrong:
        found = f"it updates at {wrong[0]:.9g} s in steps from {begin:g} to {end:.9g} s"
        yield TRIAL_RULES["calls"].at("fmi3IntermediateUpdateCallback", found)
    elif not times and end > begin:
        found = f"no step calls it, from {begin:g} to {end:.9g} s"
        yield TRIAL_RULES["updates"].at("fmi3IntermediateUpdateCallback", found)


def _answers_of_a_step(session: Session) -> Iterator[Finding]:
    """Make a step of FMI 3.0 and check what it returns; its solver may be behind the step's end."""
    begin, size = session.time, session.bench.step_size(session.kind)
    _, ends, early, last = session.instance.doStep(begin, size)
    if early and not ends:
        yield TRIAL_RULES["calls"].at("fmi3DoStep", "it returns early, which was not allowed")
    end = begin + size
    if not begin < last <= end + 1e-9 * abs(end) and not ends:
        found = f"lastSuccessfulTime is {last:.9g} s after the step from {begin:g} to "
        yield TRIAL_RULES["calls"].at("fmi3DoStep", f"{found}{end:.9g} s")
