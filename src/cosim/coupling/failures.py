"""Why a co-simulation failed: the sentence for each ending of fmu/master/coupling.h."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np

from cosim.arrays import Vector
from cosim.coupling.opened_part import OpenedPart
from cosim.errors import FmuError
from cosim.fmi.run.c_structures import Ending

_ZENO = "(Zeno)"  # in messages of FMUs made here
_STATUSES = {2: "discard", 3: "error", 4: "fatal"}


class CoupledEnding(IntEnum):
    """The end of a co-simulation, after those of `Ending`, as in fmu/master/interface.h."""

    LOOP_UNSOLVED = len(Ending)
    UNSETTLED = len(Ending) + 1
    NOISY = len(Ending) + 2


@dataclass(frozen=True)
class Wiring:
    """The connected variables in the order of the C code.

    Attributes:
        parts: By name.
        inputs: Part and variable of each input.
        sources: Part and variable of the output that drives each of them.
        is_model: Whether the system exists as one model, too.
    """

    parts: Mapping[str, OpenedPart]
    inputs: Sequence[tuple[str, str]]
    sources: Sequence[tuple[str, str]]
    is_model: bool = False


def failure(
    system: Any,
    wiring: Wiring,
    columns: Mapping[str, Sequence[str]],
    tables: Mapping[str, Vector],
    times: Vector,
) -> str:
    """Return why a run failed, in words that name the part.

    Args:
        system: The `System` of the C code, with its answers.
        wiring: What is connected.
        columns, tables: Names and rows of the recorded variables by part; a row that is not finite
            follows the complete ones.
        times: Output times, s.
    """
    time, how = f"{system.time:.9g} s", system.how
    has_input = 0 <= system.input < len(wiring.inputs)
    entry = ".".join(wiring.inputs[system.input]) if has_input else ""
    part, output = wiring.sources[system.input] if has_input else ("", "")
    shorter = "; give a shorter macro_step" if system.macro_step else ""
    if how == CoupledEnding.LOOP_UNSOLVED:
        return f"the loop of direct feedthrough through {entry} has no solution at {time}"
    if how == CoupledEnding.UNSETTLED:
        return (
            f"the iteration of the input {entry} diverges after {time}; give a shorter macro_step, "
            "or accuracy"
        )
    if how == CoupledEnding.NOISY:
        return (
            f"part '{list(wiring.parts)[system.part]}' returns outputs with a noise of about "
            f"{system.noise:.1g} of their size at {time}; allow a larger error, or give macro_step"
        )
    if how == Ending.NOT_A_NUMBER and has_input:
        return f"part '{part}': its output {output} is not finite after {time}{shorter}"
    if how == Ending.NOT_A_NUMBER:
        name, row = list(wiring.parts)[system.part], min(system.rows, len(times) - 1)
        place = int(np.argmin(np.isfinite(tables[name][row])))
        return (
            f"part '{name}': {columns[name][place]} is not finite at {times[row]:.9g} s; leave it "
            "out of the outputs if it has no value"
        )
    if how == Ending.STUCK:
        reason = f"events of the parts at {time} cause each other without end"
        return f"{reason}{_as_one_model(wiring)}"
    if how == Ending.STEP_VANISHED:
        reason = f": the input {entry} does not settle" if has_input else ""
        return f"the macro steps become too short at {time}{reason}"
    if how == Ending.CALL_FAILED and system.function and 0 <= system.part < len(wiring.parts):
        name = list(wiring.parts)[system.part]
        status = _STATUSES.get(system.status, "no status of the FMI")
        function = wiring.parts[name].calls.functions.named(system.function)
        call = f"{function} returned {system.status} ({status})"
        why = str(wiring.parts[name].explained(FmuError(call)))
        remedy = _as_one_model(wiring) if _ZENO in why else ""
        return f"part '{name}' failed after {time}: {why}{remedy}"
    return f"it failed at {time}"


def _as_one_model(wiring: Wiring) -> str:
    """Return the remedy where parts slide on each other, each of which sees one side only."""
    if not wiring.is_model:
        return ""
    return "; if the parts slide on each other, simulate them as one model, system.dae"
