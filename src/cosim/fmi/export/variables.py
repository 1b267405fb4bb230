"""The variables of an FMU in the order of their value references, and what depends on what."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from math import inf

import numpy as np
from casadi import SX

from casadi_models.dae import Dae, Start, Variable
from casadi_models.units import UNITS, Unit
from cosim.model.reduction.structure import Pattern, matching, pattern


class Role(Enum):
    """What a variable is in the FMU; the names are those of the C runtime."""

    TIME = "independent"
    STATE = "state"
    DERIVATIVE = "derivative"
    ALGEBRAIC = "algebraic"
    INPUT = "input"
    PARAMETER = "parameter"
    OUTPUT = "output"


@dataclass(frozen=True)
class FmuVariable:
    """A variable of the FMU; its value reference is its position in the list.

    Attributes:
        name, meaning, unit, display_unit, start, start_kind, nominal, minimum, maximum: See
            `casadi_models.Variable`.
        role: What it is.
        observed: Whether it is an output of the FMU, which importers record.
        derivative_of: Value reference of the state, for a derivative.
    """

    name: str
    meaning: str
    unit: str
    role: Role
    display_unit: str | None = None
    start: float | None = None
    start_kind: Start = Start.CALCULATED
    nominal: float = 1.0
    minimum: float = -inf
    maximum: float = inf
    observed: bool = False
    derivative_of: int | None = None


def fmu_variables(dae: Dae) -> tuple[FmuVariable, ...]:
    """Return time, states, derivatives, algebraics, inputs, parameters, outputs, in this order."""
    return tuple(_variables(dae))


def _variables(dae: Dae) -> Iterator[FmuVariable]:
    observed = frozenset(dae.observed)
    yield FmuVariable("time", "simulation time", "s", Role.TIME)
    for state, start in zip(dae.states, dae.x_start, strict=True):
        yield _plain(state, Role.STATE, observed, start)
    for i, state in enumerate(dae.states):
        yield FmuVariable(
            f"der({state.name})",
            f"time derivative of {state.name}",
            rate_unit(state.unit)[0],
            Role.DERIVATIVE,
            derivative_of=1 + i,
        )
    for algebraic in dae.algebraics:
        yield _plain(algebraic, Role.ALGEBRAIC, observed, algebraic.start)
    for variable in dae.inputs:
        yield _plain(variable, Role.INPUT, frozenset(), variable.start)
    for parameter in dae.parameters:
        yield _plain(parameter, Role.PARAMETER, frozenset(), parameter.start)
    for output in dae.output_variables:
        yield _plain(output, Role.OUTPUT, observed, None)


def _plain(
    variable: Variable, role: Role, observed: frozenset[str], start: float | None
) -> FmuVariable:
    return FmuVariable(
        variable.name,
        variable.meaning,
        variable.unit,
        role,
        variable.display_unit,
        start,
        variable.start_kind,
        variable.nominal,
        variable.minimum,
        variable.maximum,
        variable.name in observed,
    )


def rate_unit(unit: str) -> tuple[str, Unit]:
    """Return name and definition of a unit per second."""
    base = dict(UNITS[unit].base)
    base["s"] = base.get("s", 0) - 1
    rate = Unit(UNITS[unit].factor, tuple((k, n) for k, n in base.items() if n))
    for name, known in UNITS.items():
        if known.factor == rate.factor and known.measures_like(rate):
            return name, known
    return f"{unit}/s", rate


@dataclass(frozen=True)
class Dependencies:
    """What depends on what, structurally; rows in the order of the dependent variables.

    Attributes:
        running: Of [derivatives, algebraics, outputs] on [time, states, inputs].
        initial: Of [states, derivatives, algebraics, outputs] on [time, starts, inputs,
            parameters].
    """

    running: Pattern
    initial: Pattern


def dependencies(dae: Dae) -> Dependencies:
    """Return the dependencies, algebraic unknowns being solved for."""
    known = [dae.t, dae.x, dae.u, dae.p]
    direct = _stack([pattern(e, *known) for e in (dae.ode, SX(0, 1), dae.outputs)], dae.algebraics)
    through = _solved_for(dae) @ pattern(dae.alg, *known)  # z on what is known
    for_z = [pattern(e, dae.z) for e in (dae.ode, dae.outputs)]
    nx, nz = len(dae.states), len(dae.algebraics)
    direct[:nx] |= for_z[0] @ through
    direct[nx : nx + nz] = through
    direct[nx + nz :] |= for_z[1] @ through

    start = _start_pattern(dae)  # x on [starts, p]
    on_x = direct[:, 1 : 1 + nx]
    nu = len(dae.inputs)
    initial = np.zeros((nx + len(direct), 1 + nx + nu + len(dae.parameters)), dtype=bool)
    initial[:nx, 1 : 1 + nx] = start[:, :nx]
    initial[:nx, 1 + nx + nu :] = start[:, nx:]
    initial[nx:, 0] = direct[:, 0]
    initial[nx:, 1 : 1 + nx] = on_x @ start[:, :nx]
    initial[nx:, 1 + nx : 1 + nx + nu] = direct[:, 1 + nx : 1 + nx + nu]
    initial[nx:, 1 + nx + nu :] = direct[:, 1 + nx + nu :] | (on_x @ start[:, nx:])
    return Dependencies(direct[:, : 1 + nx + nu], initial)


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


def _start_pattern(dae: Dae) -> Pattern:
    """Return what each state's start depends on: the starts that are given, the parameters."""
    nx = len(dae.states)
    result = np.hstack((np.eye(nx, dtype=bool), np.zeros((nx, len(dae.parameters)), dtype=bool)))
    for rule in dae.start_rules:
        law = pattern(rule.expression, dae.x, dae.p)
        own = list(rule.states)
        on_x = law[:, :nx]
        if rule.implicit:
            on_x[:, own] = False
        needs = on_x @ result
        needs[:, nx:] |= law[:, nx:]
        result[own] = needs.any(axis=0) if rule.implicit else needs
    return result
