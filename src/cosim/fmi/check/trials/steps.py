"""Trials of an FMU's steps, of what it does to its process, and of calls beside its steps."""

import ctypes
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import chdir, suppress
from itertools import islice
from pathlib import Path
from time import monotonic

import numpy as np

from cosim.fmi.check.finding import TRIAL_RULES, Finding
from cosim.fmi.check.trials.bench import (
    MEMORY_GROWTH,
    MOST_NAMES,
    Bench,
    Note,
    Skipped,
    altered,
    memory_in_use,
)
from cosim.fmi.check.trials.derivatives import need_model_exchange
from cosim.fmi.check.trials.start import few_numbers, moved
from cosim.host.temporary import temporary_folder

MOST_MADE = 1_000_000
SIZE = 1 / 60  # s
_FOR_STEPS, _FOR_INSTANCES = 1 / 12, 1 / 24  # share of all time
_FEW_STEPS = 10
_MOST_INSTANCES = 10_000
_NOISE = 1e-12  # of numbers that two functions give


def steps(bench: Bench, kind: str) -> Iterator[Finding | Note]:
    """A million steps of 1/60 s, as far as the time allows, their ends summed up."""
    _needs_free_steps(bench, kind)
    end, made, looked = monotonic() + _FOR_STEPS * bench.timeout, 0, 0
    stop, outputs, used = bench.experiment("stopTime"), bench.outputs(), [memory_in_use()]
    with bench.session(kind) as session:
        session.start()
        try:
            for made, time in enumerate(session.steps(SIZE, MOST_MADE), start=1):
                if not np.isfinite(session.values(outputs)).all():
                    yield TRIAL_RULES["not-finite"].at(kind, f"not finite at {time:.6g} s")
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
        ends = session.start_time
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
        if done < _FEW_STEPS:
            raise Skipped("it ends by itself before")
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
    with bench.session(kind) as session:
        session.start()
        try:
            for i in range(int((until - session.start_time) / size) + 1):
                end = session.start_time + (i + 1) * size
                for _ in session.steps(end - session.time, 1):
                    session.time = end
        except Exception:
            return True
    return False


def _needs_free_steps(bench: Bench, kind: str) -> None:
    if kind != "CoSimulation":
        raise Skipped("it is a trial of co-simulation")
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
    """Memory does not grow with instances; `steps` looks whether it does with steps."""
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
    yield Note(f"{len(used) - 1} instances")


def exchange(bench: Bench, kind: str) -> Iterator[Finding]:
    """Functions of all states at once agree with the variables; a completed step moves nothing."""
    need_model_exchange(kind)
    states, rates = zip(*bench.states(), strict=True)
    rule = TRIAL_RULES["exchange"]
    with bench.session(kind) as session:
        session.start()
        if session.next_event < session.start_time:
            yield rule.at(kind, f"its next event is at {session.next_event:.6g} s, in the past")
        nominals = session.all_of("getNominalsOfContinuousStates", len(states))
        if not (np.isfinite(nominals) & (nominals > 0)).all():
            yield rule.at(kind, f"a state has the nominal value {nominals.min():g}")
        session.all_of("getEventIndicators", bench.fmpy.numberOfEventIndicators or 0)
        _, ends = session.instance.completedIntegratorStep()
        if ends:
            yield rule.at(kind, "it ends the run after a step of length 0")
        given = moved(session.values(states))
        session.put_states(given)
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


def settings(bench: Bench, kind: str) -> Iterator[Finding]:
    """Parameters and inputs keep the values that they are given before the start."""
    every = bench.reals("parameter") + bench.reals("input", "continuous")
    known = [v for v in every if "start" in v.texts]
    given = dict[str, float]()
    with bench.session(kind) as session:
        for variable in known:
            start = float(variable.texts["start"])
            session.put(variable, start)  # which none may reject
            with suppress(Exception):
                session.put(variable, value := altered(variable, start, 0.02))
                given[variable.name] = value
        try:
            session.start()
        except Exception as error:
            raise Skipped(f"it does not start with other parameters: {error}") from error
        for variable, value in zip(known, session.values(known), strict=True):
            wanted = given.get(variable.name, value)
            if not abs(value - wanted) <= _NOISE * abs(wanted):
                found = f"it was set to {wanted:.10g} before the start and is {value:.10g}"
                yield TRIAL_RULES["settings"].at(variable.name, found)


def calls(bench: Bench, kind: str) -> Iterator[Finding]:
    """It tells its version; its outputs can be read after the end, as the last step left them."""
    outputs = bench.outputs()
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
        last = session.values(outputs)
        instance.terminate()
        if session.values(outputs).tobytes() != last.tobytes():
            yield TRIAL_RULES["calls"].at(kind, "its outputs change at the end")
