"""Events of an FMU: frozen equations, and the functions and tables that the runtime needs."""

from dataclasses import replace

import casadi as ca
import numpy as np
from casadi import SX

from casadi_models.dae import Dae, Start, Variable
from casadi_models.dae.hybrid import Hybrid, hybrid
from casadi_models.dae.relations import COMPARISONS
from cosim.arrays import Vector
from cosim.codegen.pulses import pulse_parameters, pulse_times
from cosim.errors import UsageError

LEAST_STEPS = 50  # of the solver in a model's span


def fmu_pulses(dae: Dae) -> Vector:
    """Return the times at which steps must end for a solver to see all terms of time, s."""
    p = np.array([np.nan if v.start is None else v.start for v in dae.parameters], dtype=float)
    span = dae.experiment.stop_time
    return pulse_times(dae, p, 0.0, span, span / LEAST_STEPS)


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
    if system is None:
        return Hybrid(dae, (), (), ()) if len(fmu_pulses(dae)) else None
    system = system.blended()
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


def event_functions(system: Hybrid) -> list[ca.Function]:
    """Return the functions that fmu/runtime/equations.h declares if there are events."""
    dae = system.dae
    alone = [int(own) * r.argument for own, r in zip(system.of_time, system.relations, strict=True)]
    times = ca.densify(ca.vertcat(SX(0, 1), *alone))
    violated = [invariant.residual for invariant in dae.invariants]
    defect = ca.norm_inf(ca.vertcat(*violated)) if violated else SX(0)
    timed = [times, ca.densify(ca.jtimes(times, dae.t, 1))]
    seen = system.watching("seen")
    symbols = seen.mx_in()
    arguments, rates, _, _, seconds, sizes, _ = seen.call(symbols, True)
    span = system.time_bounds
    over, ends = [*dae.arguments, span.length], [span.low, span.high]
    bounds = [ca.Function("model_bounds", over, ends, {"cse": True})] if span.relations else []
    return [
        ca.Function("model_relations", symbols, [arguments, rates, seconds, sizes]),
        system.rounding("model_rounding"),
        ca.Function("model_timed", dae.arguments, timed, {"cse": True}),
        ca.Function("model_conditions", dae.arguments, [*system.rules, defect], {"cse": True}),
        *bounds,
    ]


def event_sizes(system: Hybrid | None) -> str:
    """Return the sizes of events for model.h; empty without events."""
    if system is None:
        return ""
    n = len(system.time_bounds.relations)
    bounded = f"#define N_BOUNDED {n}\n" if n else ""
    return f"""#define N_MODES {len(system.relations)}
#define N_WATCHED {system.of_time.count(False)}
#define N_EVENTS {len(system.events)}
#define N_ASSIGNED {sum(len(event.states) for event in system.events)}
#define N_PULSES {len(fmu_pulses(system.dae))}
{bounded}"""


def event_tables(system: Hybrid | None) -> str:
    """Return the tables of relations, events and pulses for model.c; empty without events."""
    if system is None:
        return ""
    pulses = [*map(repr, fmu_pulses(system.dae).tolist()), "0.0"]
    moving = pulse_parameters(system.dae)
    places = [i for i, v in enumerate(system.dae.parameters) if v.name in moving]
    relations, events, assigned = "", "", list[int]()
    rows = ", ".join(map(str, system.time_bounds.relations))
    bounded = f"const int bounded[] = {{{rows}}};\n" if rows else ""
    for i, relation in enumerate(system.relations):
        at_zero = relation.at_zero if relation.operation in COMPARISONS else 0
        kinds = relation.floor, system.of_time[i], system.linear[i], system.of_input[i]
        facts = ", ".join(str(fact).lower() for fact in (*kinds, at_zero, system.in_laws[i]))
        relations += f"    {{{literal(system.described(i))}, {facts}}},\n"
    for event in system.events:
        message = literal(event.message) if event.message else "NULL"
        place = f"{len(assigned)}, {len(event.states)}, {str(event.sampled).lower()}"
        events += f"    {{{literal(event.name)}, {message}, {place}}},\n"
        assigned += event.states
    return f"""
const RelationInfo relations[] = {{
{relations}    {{NULL, false, false, false, false, 0, false}},
}};

const EventInfo events[] = {{
{events}    {{NULL, NULL, 0, 0, false}},
}};

const int assigned[] = {{{", ".join(map(str, [*assigned, -1]))}}};
const double pulses[] = {{{", ".join(pulses)}}};
const int pulse_parameters[] = {{{", ".join(map(str, [*places, -1]))}}};
{bounded}"""


def literal(text: str) -> str:
    """Return a text as C literal, on one line."""
    escaped = " ".join(text.split()).replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'
