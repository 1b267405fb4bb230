"""Why a co-simulation failed, by each ending of fmu/master/coupling.h, and notes on its run."""

from collections import Counter
from collections.abc import Collection, Iterator
from enum import IntEnum
from typing import Any

import numpy as np

from cosim.coupling.open_system import Rows
from cosim.coupling.settings import Method
from cosim.coupling.wiring import Wiring
from cosim.errors import FmuError, SolverError
from cosim.fmi.run.c_structures import Ending
from cosim.text import Violation

_ENDLESS = ("(Zeno)", "while an expression slides along 0")  # in messages of FMUs made here
_AT_ONCE, _NEAR = 1e-12, 1e-3  # distances of times, of the time since the start
_SOON = 8  # macro steps between events of parts that slide on each other
_LEVELS = ("floor", "ceil", "fmod", "remainder")  # of relations that may go on in one direction
_DISCARD = 2
_STATUSES = {_DISCARD: "discard", 3: "error", 4: "fatal"}


class EndlessEvents(SolverError):
    """Events of coupled parts that follow each other without end.

    Attributes:
        part: The one that has the last event.
    """

    def __init__(self, message: str, partial: Any, part: str) -> None:
        super().__init__(message, partial)
        self.part = part


class CoupledEnding(IntEnum):
    """The end of a co-simulation, after those of `Ending`, as in fmu/master/interface.h."""

    LOOP_UNSOLVED = len(Ending)
    UNSETTLED = len(Ending) + 1
    NOISY = len(Ending) + 2


def failure(system: Any, wiring: Wiring, rows: Rows | None = None) -> str:
    """Return why a run failed, in words that name the part.

    Args:
        system: The `System` of the C code, with its answers.
        wiring: What is connected.
        rows: What it has recorded, if anything; a row that is not finite follows the complete ones.
    """
    time, how = f"{system.time:.9g} s", system.how
    has_input = 0 <= system.input < len(wiring.inputs)
    entry = ".".join(wiring.inputs[system.input]) if has_input else ""
    part, output = wiring.sources[system.input] if has_input else ("", "")
    shorter = "; give a shorter macro_step, or accuracy" if system.macro_step else ""
    larger = "; allow a larger error, or give macro_step"
    if how == CoupledEnding.LOOP_UNSOLVED:
        return f"the loop of direct feedthrough that drives {entry} has no solution at {time}"
    if how == CoupledEnding.UNSETTLED:
        return f"the iteration of the input {entry} diverges after {time}{shorter or larger}"
    if how == CoupledEnding.NOISY:
        return (
            f"part '{list(wiring.parts)[system.part]}' returns outputs with a noise of about "
            f"{system.noise:.1g} of their size at {time}{larger}"
        )
    if how == Ending.NOT_A_NUMBER and has_input:
        return f"part '{part}': its output {output} is not finite after {time}{shorter}"
    if how == Ending.NOT_A_NUMBER and rows is not None:
        name, row = list(wiring.parts)[system.part], min(system.rows, len(rows.times) - 1)
        place = int(np.argmin(np.isfinite(rows.tables[name][row])))
        return (
            f"part '{name}': {rows.columns[name][place]} is not finite at {rows.times[row]:.9g} s; "
            "leave it out of the outputs if it has no value"
        )
    if how == Ending.STUCK:
        reason = f"events of the parts at {time} cause each other without end"
        return f"{reason}{as_models(wiring)}"
    if how == Ending.STEP_VANISHED:
        reason = f": the input {entry} does not settle{shorter or larger}" if has_input else ""
        if has_input and not wiring.parts[part].rolls_back:
            reason = (
                f": part '{part}', which cannot restore a state, returns an output {output} that "
                f"moves too far in each{larger}"
            )
        if has_input and (inside := wiring.parts[part].internal_step):
            reason = (
                f": the output {output} of part '{part}' changes by leaps only, each {inside:g} s, "
                "as its solver has steps of this length; allow a larger error, or leave accuracy "
                "out"
            )
        return f"the macro steps become too short at {time}{reason}"
    if how == Ending.CALL_FAILED and system.function and 0 <= system.part < len(wiring.parts):
        name = list(wiring.parts)[system.part]
        status = _STATUSES.get(system.status, "no status of the FMI")
        call = function = wiring.parts[name].function_name(system.function)
        call += f" returned {system.status} ({status})" if function.startswith("fmi") else " failed"
        why = wiring.parts[name].explained(FmuError(call))
        discards = system.status == _DISCARD and shorter
        remedy = as_models(wiring) if _is_endless(why) else shorter if discards else ""
        return f"part '{name}' failed after {time}: {why}{remedy}"
    return f"it failed at {time}"


def notes_of(system: Any, wiring: Wiring) -> list[str]:
    """Return notes on what limits the accuracy of a run."""
    notes, noted = [], ".".join(wiring.inputs[system.noted]) if wiring.inputs else ""
    differ = (
        f"inputs and outputs differ by up to {system.mismatch:.1g} of their size; give a shorter "
        "macro_step, or accuracy"
    )
    every, remedy = f"of {system.macro_steps} macro steps", as_models(wiring)
    if system.unsettled:
        notes.append(f"{noted} did not settle in {system.unsettled} {every}: {differ}{remedy}")
    elif system.macro_step and system.mismatch >= 1:
        notes.append(differ)
    if system.jumps:
        notes.append(
            f"{noted} jumps as {system.jumps} {every} begin: its course there is left out; give a "
            "shorter macro_step, or accuracy"
        )
    inside = [n for n, p in wiring.parts.items() if not p.event_mode and p.instance.logged.events]
    if inside and system.macro_step:
        notes.append(
            f"events of {', '.join(inside)} happen within macro steps, so outputs that jump are of "
            "order 1; use FMI 3.0 with event mode, or give accuracy"
        )
    fixed = [name for name, part in wiring.parts.items() if not part.rolls_back]
    if fixed and not system.macro_step:
        notes.append(f"{', '.join(fixed)} cannot restore a state: no macro step could be rejected")
    held = system.method < list(Method).index(Method.EXTRAPOLATED)
    notes += leaps(wiring, [n for n, part in wiring.parts.items() if held or part.holds_inputs])
    if system.quantum and system.forced:
        long = ", ".join(n for n, p in wiring.parts.items() if p.internal_step or not p.any_step)
        notes.append(
            f"the steps of {long} have a fixed length, too long in {system.forced} {every}"
        )
    for name, part in wiring.parts.items() if not system.macro_step else ():
        if part.only_step and not part.any_step and part.holds_inputs:
            step = f"its only step, {part.only_step:g} s"
            notes.append(f"{name} holds its inputs within {step}: no estimate has what this causes")
    return notes


def leaps(wiring: Wiring, parts: Collection[str]) -> Iterator[str]:
    """Yield notes on continuous inputs of parts whose values jump over a short change of these."""
    moving = {own for own, held in zip(wiring.inputs, wiring.held, strict=False) if not held}
    for name in parts:
        for inputs, (time, place) in wiring.parts[name].instance.logged.leaps.items():
            if any((name, one) in moving for one in inputs.split(", ")):
                yield (
                    f"part '{name}': at {time} s, {inputs} jumps over a short change of the "
                    f"equations ({place}), as it is constant within steps; give a shorter "
                    "macro_step, another method, or accuracy"
                )


def violations(wiring: Wiring) -> Iterator[Violation]:
    """Yield the violated validity conditions of parts, of those steps that were not repeated."""
    for name, part in wiring.parts.items():
        for one in part.instance.logged.violations.counted:
            yield Violation(one.time, f"{name}: {one.what}")


def _is_endless(why: str) -> bool:
    return any(words in why for words in _ENDLESS)


def endless_part(system: Any, wiring: Wiring, why: str) -> str | None:
    """Return the part whose events follow each other without end, as where parts slide.

    Args:
        system: The `System` of the C code, with its answers.
        wiring: What is connected.
        why: Why the run failed; empty if it did not.
    """
    if system.part >= 0 and (system.how == Ending.STUCK or _is_endless(why)):
        return str(list(wiring.parts)[system.part])
    vanished = system.how == Ending.STEP_VANISHED
    if vanished and system.input >= 0:  # an event that is taken back is not logged
        for ends in (wiring.sources, wiring.inputs):
            name = str(ends[system.input][0])
            if wiring.parts[name].event_mode:
                return name
    for name, opened in wiring.parts.items():
        found = dict[str, list[float]]()
        for time, event in opened.instance.logged.events if opened.event_mode else ():
            found.setdefault(event, []).append(time)
        for times in found.values():
            thrice = zip(times, times[2:], strict=False)
            if any(c - a <= _AT_ONCE * (c - system.start) for a, c in thrice) or (
                vanished and system.time - times[-1] <= _NEAR * (system.time - system.start)
            ):
                return name
    return None


def repeats(wiring: Wiring, parts: Collection[str], macro_step: float) -> Counter[tuple[str, str]]:
    """Return how many events of some parts follow one of the same relation soon, by both."""
    found = Counter[tuple[str, str]]()
    for name in parts:
        last = dict[str, float]()
        for time, event in wiring.parts[name].instance.logged.events:
            if not event.startswith(_LEVELS):
                found[name, event] += time - last.get(event, -np.inf) <= _SOON * macro_step
                last[event] = time
    return found


def sliding(wiring: Wiring, part: str) -> str:
    """Return what a run with a given macro step says of a part that slides on others."""
    return (
        f"a relation of part '{part}' slides along 0 by what other parts do: no macro step is "
        f"short enough for that{as_models(wiring) or '; give accuracy'}"
    )


def as_models(wiring: Wiring) -> str:
    """Return the remedy where parts slide on each other, each of which sees one side only."""
    if not wiring.unknown:
        return ""
    return (
        "; if the parts slide on each other, couple them as models: the equations of "
        f"{', '.join(wiring.unknown)} are not known"
    )
