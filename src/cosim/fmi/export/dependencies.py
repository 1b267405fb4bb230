"""What the unknowns of an FMU depend on, structurally; algebraic unknowns being solved for."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from casadi import SX

from casadi_models.dae import Dae, Variable
from cosim.model.reduction.structure import Pattern, matching, pattern


@dataclass(frozen=True)
class Dependencies:
    """What depends on what, structurally; rows in the order of the dependent variables.

    Attributes:
        running: Of [derivatives, algebraics, outputs] on [time, states, inputs, parameters].
        initial: Of [states, derivatives, algebraics, outputs] on [time, starts, inputs,
            parameters].
    """

    running: Pattern
    initial: Pattern


def structural_dependencies(dae: Dae) -> Dependencies:
    """Return the dependencies, algebraic unknowns being solved for."""
    known = [dae.t, dae.x, dae.u, dae.p]
    direct = _stack([pattern(e, *known) for e in (dae.ode, SX(0, 1), dae.outputs)], dae.algebraics)
    through = _solved_for(dae) @ pattern(dae.alg, *known)  # z on what is known
    for_z = [pattern(e, dae.z) for e in (dae.ode, dae.outputs)]
    nx, nz = len(dae.states), len(dae.algebraics)
    direct[:nx] |= for_z[0] @ through
    direct[nx : nx + nz] = through
    direct[nx + nz :] |= for_z[1] @ through

    start = _start_pattern(dae)  # x on [time, starts, u, p]
    is_start = np.zeros(direct.shape[1], dtype=bool)
    is_start[1 : 1 + nx] = True
    others = np.where(is_start, False, direct) | direct[:, is_start] @ start
    return Dependencies(direct, np.vstack((start, others)))


def _stack(patterns: Sequence[Pattern], algebraics: Sequence[Variable]) -> Pattern:
    ode, _, outputs = patterns
    return np.vstack((ode, np.zeros((len(algebraics), ode.shape[1]), dtype=bool), outputs))


def _solved_for(dae: Dae) -> Pattern:
    """Return which equations each algebraic unknown needs, (nz, nz).

    Every unknown is matched with an equation; an unknown needs its own equation and those of all
    unknowns that stand in it, and so on.
    """
    count = len(dae.algebraics)
    if not count:
        return np.zeros((0, 0), dtype=bool)
    equation = matching(dae)
    reach = pattern(dae.alg, dae.z)[equation] | np.eye(count, dtype=bool)
    for _ in range(count.bit_length()):
        reach = reach @ reach
    own = np.zeros((count, count), dtype=bool)
    own[np.arange(count), equation] = True
    return reach @ own


def start_parameters(dae: Dae) -> tuple[str, ...]:
    """Return the names of the parameters that calculated start values follow from."""
    pattern = _start_pattern(dae)[:, 1 + len(dae.states) + len(dae.inputs) :]
    return tuple(p.name for p, uses in zip(dae.parameters, pattern.T, strict=True) if uses.any())


def _start_pattern(dae: Dae) -> Pattern:
    """Return what each state's start depends on: [time, starts that are given, inputs, p]."""
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
