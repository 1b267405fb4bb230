"""Trials of values of all types: those that the file names, that are set, and that a run has."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import groupby
from time import monotonic
from typing import Any

import numpy as np

from cosim.fmi.check.finding import TRIAL_RULES, Finding
from cosim.fmi.check.parsed import Described
from cosim.fmi.check.trials.bench import MOST_NAMES, Bench, Session, Skipped, altered
from cosim.fmi.run.arrays import Element, with_elements
from cosim.fmi.run.description import Interface
from cosim.fmi.run.instance import access_to, may_be_set
from cosim.fmi.run.typed_values import NUMERIC, RANGES, REALS, start_value

_ROUNDING = 1e-6  # of a start value, as people write it
_NOISE, _NOISE_32 = 1e-12, 1e-6  # of a number that is read back, and of a Float32
_FAR, _NEAR = 0.5, 0.02  # changes of settings, of their size
_LONGER = " \u00e4" + 40 * "x"  # than a text may be that is copied into a short array
_FOR_RUN = 1 / 24  # share of all time
_Value = float | bool | str


@dataclass(frozen=True)
class _Setting:
    """A variable, or an element of an array, that begins with the start value of the file.

    Attributes:
        variable: Of fmpy's description.
        facts: Of the file; of the whole array for an element.
    """

    variable: Any
    facts: Described

    @property
    def is_real(self) -> bool:
        return self.variable.type in REALS

    @property
    def start(self) -> _Value:
        found: _Value = start_value(self.variable)
        return bool(found) if self.variable.type == "Boolean" else found

    def other(self, share: float) -> _Value:
        """Return another value, where its type has one; of a real number, by a share of it."""
        start, declared = self.start, self.variable.declaredType
        if isinstance(start, str):
            return start + _LONGER
        if isinstance(start, bool):
            return not start
        if self.is_real:
            place = self.variable.place if isinstance(self.variable, Element) else 0
            return altered(self.facts, start, share * (1 + place / 100))
        if self.variable.type == "Enumeration":
            near = [int(item.value) for item in declared.items] if declared else []
        else:
            low, high = RANGES[self.variable.type]
            low = int(self.facts.texts.get("min", low))
            high = int(self.facts.texts.get("max", high))
            near = [int(v) for v in (start + 1, start - 1) if low <= v <= high]
        return next((value for value in near if value != start), start)

    def agrees(self, found: _Value, expected: _Value, rounding: float) -> bool:
        if not self.is_real:
            return found == expected
        noise = max(rounding, _NOISE_32 if self.variable.type == "Float32" else 0)
        return abs(float(found) - float(expected)) <= noise * abs(float(expected))


def _settings_of(bench: Bench) -> list[_Setting]:
    facts = {(v.kind, v.reference): v for v in bench.described.variables}
    found = list[_Setting]()
    for variable in with_elements(bench.fmpy).modelVariables:
        own = facts.get((variable.type, str(variable.valueReference)))
        text = variable.type == "String"
        if own is None or variable.dimensions or not may_be_set(variable):
            continue
        begins = own.causality in ("parameter", "input") or own.initial == "exact"
        if begins and (text or (NUMERIC.fullmatch(variable.type) and variable.start)):
            found.append(_Setting(variable, own))
    Skipped.when(not found, "it has no variable that begins with its start value")
    return found


def _read(session: Session, settings: Sequence[_Setting]) -> list[_Value]:
    variables = [one.variable for one in settings]
    found = access_to(variables, session.instance, session.bench.fmpy).get()
    return [v.decode(errors="replace") if isinstance(v, bytes) else v for v in found]


def _read_at_start(
    session: Session, settings: Sequence[_Setting]
) -> Iterator[tuple[_Setting, list[_Value]]]:
    """Initialize; yield values in initialization mode and after it, of settings the latter."""
    session.enter()
    early = list[_Value]()
    with suppress(Exception):  # not all can be read in initialization mode
        early = _read(session, settings)
    session.instance.exitInitializationMode()
    late = _read(session, settings)
    for one, before, after in zip(settings, early or late, late, strict=True):
        is_set = one.facts.causality in ("parameter", "input")
        yield one, [after] if is_set else [before, after]  # an event may change others


def defaults(bench: Bench, kind: str) -> Iterator[Finding]:
    """The library begins with the start values of the file."""
    with bench.session(kind) as session:
        for one, found in _read_at_start(session, _settings_of(bench)):
            start = one.start
            if not any(one.agrees(value, start, _ROUNDING) for value in found):
                text = f"the file says {_shown(start)}, the library {_shown(found[-1])}"
                yield TRIAL_RULES["defaults"].at(one.variable.name, text)


def settings(bench: Bench, kind: str) -> Iterator[Finding]:
    """What begins with its start value begins with another one that it is given."""
    try:
        findings = list(_set_by(bench, kind, _FAR))
    except Skipped:
        findings = list(_set_by(bench, kind, _NEAR))
    yield from findings
    yield from _set_in_a_run(bench, kind)


def _set_by(bench: Bench, kind: str, share: float) -> Iterator[Finding]:
    """Set variables before the start; only real numbers by a small share."""
    known = [one for one in _settings_of(bench) if one.facts.causality != "structuralParameter"]
    with bench.session(kind) as session:
        given = _changed(session, known, share)
        try:
            found = list(_read_at_start(session, known))
        except Exception as error:
            raise Skipped(f"it does not start with other values: {error}") from error
    for one, values in found:
        name = one.variable.name
        wanted = given.get(name, values[-1])
        if not any(one.agrees(value, wanted, _NOISE) for value in values):
            text = f"it was set to {_shown(wanted)} before the start and is {_shown(values[-1])}"
            yield TRIAL_RULES["settings"].at(name, text)


def _changed(session: Session, known: Sequence[_Setting], share: float) -> dict[str, _Value]:
    """Set other values, one variable at a time, then all in one call; return what is accepted."""
    accepted = list[tuple[list[_Setting], list[_Value]]]()

    def whole(one: _Setting) -> int:
        return id(one.variable.array if isinstance(one.variable, Element) else one.variable)

    def put(group: Sequence[_Setting], values: Sequence[_Value]) -> None:
        variables = [one.variable for one in group]
        access_to(variables, session.instance, session.bench.fmpy).set(values)

    def put_again() -> None:  # after a rejection no call but a reset is allowed
        session.instance.reset()
        for pair in accepted:
            put(*pair)

    for _, members in groupby(known, whole):
        group = list(members)
        put(group, [one.start for one in group])  # which none may reject
        if share != _FAR and not group[0].is_real:
            continue
        values = [one.other(share) for one in group]
        try:
            put(group, values)
            accepted.append((group, values))
        except Exception:
            put_again()
    every = [one for group, _ in accepted for one in group]
    new = [value for _, values in accepted for value in values]
    try:
        for group, _ in accepted:
            put(group, [one.start for one in group])
        put(every, new)
    except Exception:
        put_again()
    return {one.variable.name: value for one, value in zip(every, new, strict=True)}


def _set_in_a_run(bench: Bench, kind: str) -> Iterator[Finding]:
    """Set tunable parameters: in model exchange in event mode, in co-simulation between steps."""
    tunable = bench.reals("parameter", "tunable")
    for parameter in tunable[:MOST_NAMES]:  # a rejected call may end the instance
        with bench.started(kind) as session:
            if kind == Interface.MODEL_EXCHANGE:
                session.instance.enterEventMode()
            (value,) = session.values([parameter])
            try:
                session.put(parameter, value)
            except Exception as error:
                found = f"it is tunable, and rejected in a run: {error}"
                yield TRIAL_RULES["settings"].at(parameter.name, found)
                continue
            with suppress(Exception):  # it may reject a value
                session.put(parameter, wanted := altered(parameter, value, _NEAR))
                (value,) = session.values([parameter])
                if np.isfinite(wanted) and not abs(value - wanted) <= _NOISE * abs(wanted):
                    found = f"it was set to {wanted:.10g} in a run and is {value:.10g}"
                    yield TRIAL_RULES["settings"].at(parameter.name, found)


def _shown(value: _Value) -> str:
    return f"{value:.10g}" if isinstance(value, float) else repr(value)


def bounds(bench: Bench, kind: str) -> Iterator[Finding]:
    """What it computes stays within the bounds of the file over the default experiment."""
    if kind == Interface.MODEL_EXCHANGE and "CoSimulation" in bench.described.interfaces:
        raise Skipped("co-simulation shows it")
    every = (v for v in bench.described.variables if v.causality in ("output", "local"))
    limited = [v for v in every if bench.single(v) and {"min", "max"} & v.texts.keys()]
    Skipped.when(not limited, "no variable that it computes has bounds")
    end = monotonic() + _FOR_RUN * bench.timeout
    try:
        size = bench.output_interval(kind)
        times, rows = bench.run(Interface(kind), limited, bench.tolerance, size, end)
    except Exception as error:
        raise Skipped(f"it does not run: {error}") from error
    for variable, values in zip(limited, rows.T, strict=True):
        low, high = (float(variable.texts.get(e, d)) for e, d in (("min", "-inf"), ("max", "inf")))
        largest = np.abs(values[np.isfinite(values)]).max(initial=variable.nominal)
        noise = 10 * bench.tolerance * largest
        beyond = np.flatnonzero((values < low - noise) | (values > high + noise))
        if len(beyond):
            found = f"it is {values[beyond[0]]:.6g} at {times[beyond[0]]:.6g} s, out of its range "
            yield TRIAL_RULES["bounds"].at(variable.name, f"{found}{low:g} ... {high:g}")
