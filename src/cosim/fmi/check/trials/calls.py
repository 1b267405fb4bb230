"""Trials of functions that importers call beside those that read variables and make steps."""

import ctypes
from collections.abc import Iterator
from contextlib import suppress

import numpy as np

from cosim.arrays import Vector
from cosim.fmi.check.finding import TRIAL_RULES, Finding
from cosim.fmi.check.trials.bench import MOST_NAMES, Bench, Session, Skipped, altered
from cosim.fmi.check.trials.derivatives import need_model_exchange
from cosim.fmi.check.trials.start import moved

_NOISE = 1e-12  # of numbers that two functions give


def exchange(bench: Bench, kind: str) -> Iterator[Finding]:
    """Functions of all states at once agree with the variables; a completed step moves nothing."""
    need_model_exchange(kind)
    states, rates = zip(*bench.states(), strict=True)
    rule = TRIAL_RULES["exchange"]
    with bench.session(kind) as session:
        session.start()
        if session.next_event < session.start_time:
            yield rule.at(kind, f"its next event is at {session.next_event:.6g} s, in the past")
        nominals = _all(session, "getNominalsOfContinuousStates", len(states))
        if not (np.isfinite(nominals) & (nominals > 0)).all():
            yield rule.at(kind, f"a state has the nominal value {nominals.min():g}")
        _all(session, "getEventIndicators", bench.fmpy.numberOfEventIndicators or 0)
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
            found = _all(session, function, len(own))
            allowed = _NOISE * np.maximum(np.abs(expected), 1.0)
            wrong = ~((np.abs(found - expected) <= allowed) & (np.abs(own - expected) <= allowed))
            for i in np.flatnonzero(wrong)[:MOST_NAMES]:
                fault = f"{function} gives {found[i]:.10g}, its variable is {own[i]:.10g}"
                yield rule.at(variables[i].name, fault)


def _all(session: Session, function: str, size: int) -> Vector:
    """Return what a function gives for all states or event indicators."""
    found = (ctypes.c_double * size)()
    getattr(session.instance, function)(found, size)
    return np.array(found)


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
