"""Structural dependencies of outputs and derivatives, and tunable parameters."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from casadi import SX

from casadi_models.dae import Dae
from casadi_models.dae.hybrid import Hybrid
from casadi_models.units import UNITS
from cosim.errors import UnknownName, UsageError
from cosim.model.reduction import Pattern, matching, pattern


@dataclass(frozen=True)
class Dependencies:
    """Structural dependencies; one row for each dependent variable.

    Attributes:
        running: Dependencies of [derivatives, algebraics, outputs] on [time, states, inputs,
            parameters].
        initial: Dependencies of [states, derivatives, algebraics, outputs] on [time, start values,
            inputs, parameters].
    """

    running: Pattern
    initial: Pattern


def structural_dependencies(dae: Dae) -> Dependencies:
    """Return the dependencies of a model with its algebraic unknowns solved for."""
    known = [dae.t, dae.x, dae.u, dae.p]
    through = _solved_for(dae) @ pattern(dae.alg, *known)  # z on the knowns
    ode, outputs = (
        pattern(e, *known) | pattern(e, dae.z) @ through for e in (dae.ode, dae.outputs)
    )
    direct, nx = np.vstack((ode, through, outputs)), len(dae.states)
    start = _start_pattern(dae)  # x on [time, starts, u, p]
    is_start = np.zeros(direct.shape[1], dtype=bool)
    is_start[1 : 1 + nx] = True
    others = np.where(is_start, False, direct) | direct[:, is_start] @ start
    return Dependencies(direct, np.vstack((start, others)))


def without_modes(depends: Dependencies, system: Hybrid) -> Dependencies:
    """Return the dependencies of frozen equations, whose modes are no knowns.

    Between events they are constant. At the start, they follow from the arguments of all relations,
    of which the last outputs are made.
    """
    count, nx = len(system.relations), len(system.dae.states)
    last = 1 + nx + len(system.dae.inputs)
    modes = slice(last - count, last)
    watched = count - sum(system.of_time)
    of_time = [
        r.argument for r, alone in zip(system.relations, system.of_time, strict=True) if alone
    ]
    dae, initial = system.dae, depends.initial.copy()
    known = [dae.t, dae.x, dae.u, dae.p]
    start = np.vstack(
        (initial[len(initial) - watched :], pattern(ca.vertcat(SX(0, 1), *of_time), *known))
    )
    initial[initial[:, modes].any(axis=1)] |= start.any(axis=0)
    return Dependencies(*(np.delete(p, modes, axis=1) for p in (depends.running, initial)))


def _solved_for(dae: Dae) -> Pattern:
    """Return the equations that each algebraic unknown depends on, (nz, nz).

    Every unknown is matched with an equation. It depends on that equation, on the equations of all
    unknowns in it, and so on.
    """
    count = len(dae.algebraics)
    equation = matching(dae)
    reach = pattern(dae.alg, dae.z)[equation] | np.eye(count, dtype=bool)
    for _ in range(count.bit_length()):
        reach = reach @ reach
    return reach[:, np.argsort(equation)]  # from unknowns to the equations of their own


def _start_pattern(dae: Dae) -> Pattern:
    """Return the dependencies of start values on [time, exact start values, inputs, p]."""
    nx, others = len(dae.states), len(dae.inputs) + len(dae.parameters)
    result = np.eye(nx, 1 + nx + others, 1, dtype=bool)
    for rule in dae.start_rules:
        law = pattern(rule.expression, dae.t, dae.x, dae.u, dae.p)
        own = list(rule.states)
        on_x = law[:, 1 : 1 + nx].copy()
        law[:, 1 : 1 + nx] = False
        if rule.implicit:
            on_x[:, own] = False
        needs = on_x @ result | law
        result[own] = needs.any(axis=0) if rule.implicit else needs
    return result


ALL = "all"
WHY_IDLE = "nothing follows from it after the start"


def fixed_parameters(dae: Dae) -> Mapping[str, str]:
    """Return the parameters that are fixed by default, with the reason."""
    reasons = {}
    starting = _start_pattern(dae)[:, 1 + len(dae.states) + len(dae.inputs) :]
    happening = (part for event in dae.events for part in (event.condition, event.values))
    equations = ca.vertcat(dae.ode, dae.alg, dae.outputs, *happening)
    used = ca.which_depends(equations, dae.p, 1, False) if dae.parameters else ()
    for parameter, needed, starts in zip(dae.parameters, used, starting.T, strict=True):
        base = dict(UNITS[parameter.unit].base)
        if not needed:
            reasons[parameter.name] = WHY_IDLE
        elif starts.any():
            reasons[parameter.name] = "start values follow from it"
        elif base.get("kg") and not base.get("s"):
            reasons[parameter.name] = "a change of inertia would add momentum from nowhere"
    return reasons


def tunable_parameters(dae: Dae, wanted: Sequence[str] | None) -> tuple[str, ...]:
    """Return the names of the parameters that may change during a run.

    Args:
        wanted: Names of parameters; `[ALL]` for all that have an influence during a run; when
            None, these without inertias and without those that start values are calculated from.

    Raises:
        UnknownName: The model has no such parameter.
        UsageError: It has no influence during a run.
    """
    names, fixed = [p.name for p in dae.parameters], fixed_parameters(dae)
    if wanted is None:
        return tuple(name for name in names if name not in fixed)
    if tuple(wanted) == (ALL,):
        return tuple(name for name in names if fixed.get(name) != WHY_IDLE)
    for name in wanted:
        UnknownName.reject(dae.full_name, "parameter", names, name)
        if fixed.get(name) == WHY_IDLE:
            raise UsageError(
                f"{dae.full_name}: {name} cannot be tunable, as {WHY_IDLE}; set it before a run"
            )
    return tuple(wanted)
