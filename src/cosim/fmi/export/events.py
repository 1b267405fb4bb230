"""Events of an FMU: frozen equations, and the functions and tables that the runtime needs."""

from collections.abc import Sequence
from dataclasses import replace
from warnings import warn

import casadi as ca
import numpy as np
from casadi import SX

from casadi_models.dae import Dae, Start, Variable
from casadi_models.dae.hybrid import Hybrid, hybrid
from cosim.arrays import Vector
from cosim.codegen.hybrid_laws import law_sizes, law_tables
from cosim.codegen.landmarks import landmarks
from cosim.codegen.pulses import pulse_parameters, pulse_times
from cosim.errors import UsageError

LEAST_STEPS = 50  # of the solver in a model's span


def fmu_pulses(dae: Dae) -> Vector:
    """Return the times at which steps must end for a solver to see all terms of time, s."""
    p = np.array([np.nan if v.start is None else v.start for v in dae.parameters], dtype=float)
    span = dae.experiment.stop_time
    sampled = pulse_times(dae, p, 0.0, span, span / LEAST_STEPS)
    return np.union1d(sampled, landmarks(dae).times)


def fmu_events(dae: Dae) -> Hybrid | None:
    """Return the frozen equations of a model; None if it has neither events nor pulses.

    Their last outputs are the event indicators: how far each argument is within its mode.

    Raises:
        UsageError: The equations cannot be frozen, or the model uses a reserved variable name.
    """
    try:
        system = hybrid(dae)
    except ValueError as error:
        raise UsageError(f"{dae.full_name}: {error}; give one of them another size") from None
    system = system.blended() if system else Hybrid(dae, (), (), ())
    places = landmarks(system.with_conditions())
    for name in places.passed:
        warn(
            f"{dae.full_name}: terms of {name} change in places that the FMU does not name; an "
            "importer's solver may step over some: give it a largest step",
            stacklevel=2,
        )
    system = system.watching_more(places.arguments, "place")
    if not (system.relations or system.events or len(fmu_pulses(system.dae))):
        return None
    smooth, modes = system.dae, ca.vertsplit(system.modes)
    rows, more = list[SX](), list[Variable]()
    for i, relation in enumerate(system.relations):
        if system.of_time[i]:
            continue
        value, mode, name = relation.argument, modes[i], f"event_indicator_{len(more) + 1}"
        meaning = f"positive while the mode of {system.described(i)} stays"
        rows.append(ca.fmin(value - mode, mode + 1 - value) if relation.floor else mode * value)
        more.append(Variable(name, "1", meaning, start_kind=Start.CALCULATED))
    names = {v.name for v in (*more, *smooth.inputs[len(dae.inputs) :])}
    for taken in {v.name for v in dae.variables} & names:
        raise UsageError(f"{dae.full_name} has a variable '{taken}' of its own; rename it")
    outputs = ca.densify(ca.vertcat(smooth.outputs, *rows))
    variables = (*smooth.output_variables, *more)
    return replace(system, dae=replace(smooth, outputs=outputs, output_variables=variables))


def event_sizes(system: Hybrid | None) -> str:
    """Return the sizes of events for model.h; empty without events."""
    if system is None:
        return ""
    sizes = law_sizes(system) | {
        "N_WATCHED": system.of_time.count(False),
        "N_PULSES": len(fmu_pulses(system.dae)),
    }
    return "".join(f"#define {name} {size}\n" for name, size in sizes.items())


def event_tables(system: Hybrid | None) -> str:
    """Return the tables of relations, events and pulses for tables.h; empty without events."""
    if system is None:
        return ""
    times, known = fmu_pulses(system.dae), landmarks(system.dae)
    pulses = [*map(repr, times.tolist()), "0.0"]
    sampled = {*pulse_parameters(system.dae)} if len(times) else set[str]()
    moving = sampled - {*known.followed} | {*known.given}
    places = [i for i, v in enumerate(system.dae.parameters) if v.name in moving]
    names = [literal(system.described(i)) for i in range(len(system.relations))]
    rules = [literal(event.name) for event in system.events]
    messages = [literal(event.message) if event.message else "NULL" for event in system.events]
    texts = {"relation_names": names, "rule_names": rules, "rule_messages": messages}
    return f"""
{law_tables(system)}
{"".join(_texts(name, own) for name, own in texts.items())}
static const double pulses[] = {{{", ".join(pulses)}}};
static const int pulse_parameters[] = {{{", ".join(map(str, [*places, -1]))}}};
"""


def _texts(name: str, texts: Sequence[str]) -> str:
    lines = "".join(f"    {text},\n" for text in (*texts, "NULL"))
    return f"static const char *const {name}[] = {{\n{lines}}};\n"


def literal(text: str) -> str:
    """Return a text as C literal, on one line."""
    escaped = " ".join(text.split()).replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'
