"""Model reduction: remove what the requested outputs do not depend on."""

from collections.abc import Collection, Iterator, Sequence, Set
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from casadi import SX
from numpy.typing import NDArray

from casadi_models.dae import Dae, Invariant, Variable
from casadi_models.dae.events import Event
from casadi_models.dae.expressions import column, symbols
from cosim.errors import UnknownName, UsageError
from cosim.model.catalogue import model_of, no_such_output, observable
from cosim.model.values import listed


@dataclass(frozen=True)
class Size:
    """What a DAE costs: unknowns, and scalar operations of equations and outputs together."""

    states: int
    algebraics: int
    inputs: int
    parameters: int
    outputs: int
    operations: int


def size(dae: Dae) -> Size:
    """Count a DAE's variables, and its scalar operations with parameters being numbers."""
    return Size(
        len(dae.states),
        len(dae.algebraics),
        len(dae.inputs),
        len(dae.parameters),
        len(dae.output_variables),
        dae.operations(with_outputs=True),
    )


Pattern = NDArray[np.bool_]


def pattern(expression: SX, *variables: SX) -> Pattern:
    """Return which elements of an expression depend on which variables, (rows, variables)."""
    sparsity = ca.jacobian_sparsity(expression, ca.vertcat(*variables))
    return np.array(ca.DM.ones(sparsity).full(), dtype=bool).reshape(sparsity.shape)


def matching(dae: Dae) -> NDArray[np.int_]:
    """Return for each algebraic unknown an equation of its own that depends on it."""
    equation = np.zeros(len(dae.algebraics), dtype=int)
    if dae.algebraics:
        _, rows, columns, *_ = ca.jacobian_sparsity(dae.alg, dae.z).btf()
        equation[list(columns)] = list(rows)
    return equation


def used(expression: SX, variables: SX) -> list[int]:
    """Return the positions of the variables on which anything of an expression depends."""
    return [int(i) for i in np.flatnonzero(pattern(expression, variables).any(axis=0))]


def closure(dae: Dae, requested: Set[str], observed: SX) -> tuple[list[int], list[int], list[int]]:
    """Return the positions of the states, algebraic unknowns and equations that are needed."""
    equation = matching(dae)
    ode_x, ode_z = pattern(dae.ode, dae.x), pattern(dae.ode, dae.z)
    alg_x, alg_z = pattern(dae.alg, dae.x)[equation], pattern(dae.alg, dae.z)[equation]
    x = np.array([v.name in requested for v in dae.states], dtype=bool)
    z = np.array([v.name in requested for v in dae.algebraics], dtype=bool)
    x |= pattern(observed, dae.x).any(axis=0)
    z |= pattern(observed, dae.z).any(axis=0)
    while True:
        more_z = z | ode_z[x].any(axis=0) | alg_z[z].any(axis=0)
        more_x = x | ode_x[x].any(axis=0) | alg_x[z].any(axis=0)
        for rule in dae.start_rules:
            if more_x[list(rule.states)].any():
                more_x[list(rule.states)] = True
                more_x |= pattern(rule.expression, dae.x).any(axis=0)
        for event in dae.events:
            if event.message or more_x[list(event.states)].any():
                rows = [i for i, state in enumerate(event.states) if more_x[state]]
                law = ca.vertcat(event.condition, event.values[rows])
                more_x |= pattern(law, dae.x).any(axis=0)
                more_z = more_z | pattern(law, dae.z).any(axis=0)
        if (more_x == x).all() and (more_z == z).all():
            break
        x, z = more_x, more_z
    unknowns = [int(i) for i in np.flatnonzero(z)]
    return [int(i) for i in np.flatnonzero(x)], unknowns, sorted(int(equation[i]) for i in unknowns)


def frozen_at_start(dae: Dae, names: Collection[str]) -> Dae:
    """Return the DAE with the start values of some parameters in their place.

    Raises:
        UnknownName: The model has no such parameter.
    """
    known = {v.name: v for v in dae.parameters}
    UnknownName.reject(dae.full_name, "parameter", known, *names)
    values = SX(dae.p)
    for i, parameter in enumerate(dae.parameters):
        if parameter.name in names:
            values[i] = parameter.start or 0.0
    return dae.rewritten(lambda laws: ca.substitute(laws, [dae.p], [values]))


def reduction_report(full: Dae, small: Dae, freeze: Collection[str]) -> Iterator[str]:
    """Yield a line for each pass: what was removed and why."""
    if freeze:
        yield f"freeze: {', '.join(freeze)} became numbers"
    passes = (
        ("outputs", full.output_variables, small.output_variables, "not requested"),
        ("states", full.states, small.states, "no requested output depends on them"),
        ("algebraics", full.algebraics, small.algebraics, "no remaining equation needs them"),
        ("inputs", full.inputs, small.inputs, "no remaining equation depends on them"),
        ("parameters", full.parameters, small.parameters, "no remaining equation depends on them"),
    )
    for what, before, after, why in passes:
        names = {v.name for v in after}
        gone = [v.name for v in before if v.name not in names and v.name not in freeze]
        if gone:
            yield f"{what}: {len(before)} -> {len(after)}; {', '.join(gone)}: {why}"
    watched = {meaning for _, meaning in small.limits}
    happening = {event.name for event in small.events}
    if gone := [event.name for event in full.events if event.name not in happening]:
        yield f"events: {', '.join(gone)}: no remaining equation depends on them"
    if gone := [meaning for _, meaning in full.limits if meaning not in watched]:
        yield f"limits: {len(full.limits)} -> {len(watched)}; not watched: {'; '.join(gone)}"
    everything = ca.vertcat(small.ode, small.alg, small.outputs)
    if not ca.depends_on(everything, small.t):
        yield "time: the equations do not depend on it"
    counts = [str(dae.operations(with_outputs=True)) for dae in (full, small)]
    yield f"operations: {' -> '.join(counts)}"


def checked_outputs(dae: Dae, outputs: Sequence[str]) -> tuple[str, ...]:
    """Return the names of outputs as a tuple.

    Raises:
        UnknownName: The model has no such output; another formulation that has it is named.
        UsageError: No output is named, one is named twice, or this is no list.
    """
    names, known = listed(f"{dae.full_name}: outputs", outputs), observable(dae)
    for i, name in enumerate(names):
        if name not in known:
            raise no_such_output(dae, name)
        if name in names[:i]:
            raise UsageError(f"{dae.full_name}: output '{name}' is named twice; name it once")
    return names


def reduce(dae: Dae | str, outputs: Sequence[str], *, freeze: Collection[str] = ()) -> Dae:
    """Return the smallest DAE that computes the requested outputs.

    The passes: select the requested outputs; keep the states they depend on, through derivatives,
    algebraic unknowns and start values; drop algebraic unknowns, inputs and parameters that are
    left without influence; make frozen parameters numbers.

    Args:
        dae: The full model, or its name.
        outputs: Names of states, algebraic unknowns or outputs.
        freeze: Parameters that become constants, with their start values.

    Returns:
        A DAE whose `observed` names are `outputs` and whose `report` says what was removed and why.

    Raises:
        UnknownName: The model has no such output; another formulation that has it is named.
        UsageError: No output is requested, or one is named twice; or an argument is no list.

    Example:
        >>> import cosim
        >>> small = reduce(cosim.load("bicycle"), ["phi", "delta"])
        >>> len(small.states), small.observed
        (6, ('phi', 'delta'))
    """
    dae = model_of("reduce", dae)
    if isinstance(freeze, str) or not isinstance(freeze, Collection):
        raise UsageError.of_type(f"{dae.full_name}: freeze", freeze, "a list of parameters")
    outputs = checked_outputs(dae, outputs)
    requested = frozenset(outputs)
    frozen = frozen_at_start(dae.watching(requested), freeze)
    selected = [i for i, v in enumerate(frozen.output_variables) if v.name in requested]
    observed = ca.vertcat(SX(0, 1), *(frozen.outputs[i] for i in selected))
    states, unknowns, equations = closure(frozen, requested, observed)
    rules = [rule for rule in frozen.start_rules if set(rule.states) <= set(states)]
    events = [_remaining_event(event, states) for event in frozen.events]
    events = [event for event in events if event.message or event.states]
    invariants = tuple(_remaining_invariants(frozen, states))
    needed = ca.vertcat(
        frozen.ode[states],
        frozen.alg[equations],
        observed,
        *(rule.expression for rule in rules),
        *(law for event in events for law in (event.condition, event.values)),
        *(law for invariant in invariants for law in (invariant.residual, invariant.sizes)),
    )
    inputs = used(needed, frozen.u)
    parameters = used(needed, frozen.p)
    ode, alg, shared = (
        ca.densify(ca.reshape(column, -1, 1))
        for column in ca.cse([frozen.ode[states], frozen.alg[equations], observed])
    )
    small = replace(
        frozen,
        x=_chosen_rows(frozen.x, states),
        z=_chosen_rows(frozen.z, unknowns),
        u=_chosen_rows(frozen.u, inputs),
        p=_chosen_rows(frozen.p, parameters),
        ode=ode,
        alg=alg,
        outputs=shared,
        states=_pick(frozen.states, states),
        algebraics=_pick(frozen.algebraics, unknowns),
        inputs=_pick(frozen.inputs, inputs),
        parameters=_pick(frozen.parameters, parameters),
        output_variables=_pick(frozen.output_variables, selected),
        start_rules=tuple(
            replace(rule, states=tuple(map(states.index, rule.states))) for rule in rules
        ),
        start_outputs=(),
        observed=outputs,
        x_start=tuple(frozen.x_start[i] for i in states),
        drawing=frozen.drawing.with_numbers({v.name: v.start or 0.0 for v in frozen.parameters}),
        invariants=invariants,
        events=tuple(events),
        closing=frozen.closing
        and replace(frozen.closing, residual=frozen.closing.residual[equations]),
    )
    start_outputs = tuple(
        replace(rule, state=states.index(rule.state))
        for rule in frozen.start_outputs
        if rule.state in states and _computable(small, rule.expression)
    )
    small = replace(
        small,
        start_outputs=start_outputs,
        inertias=tuple(pair for pair in small.inertias if _computable(small, pair[1])),
        limits=tuple(pair for pair in small.limits if _computable(small, pair[0])),
        monitors=tuple(pair for pair in small.monitors if _computable(small, pair[1])),
        smooth=tuple(
            column(row for row in ca.vertsplit(rows) if _computable(small, row))
            for rows in small.smooth
        ),
    )
    return replace(small, report=tuple(reduction_report(dae, small, freeze)))


def _remaining_event(event: Event, states: Sequence[int]) -> Event:
    """Return an event that assigns to the remaining states alone."""
    rows = [row for row, state in enumerate(event.states) if state in states]
    places = tuple(states.index(event.states[row]) for row in rows)
    return replace(event, states=places, values=_chosen_rows(event.values, rows))


def _computable(small: Dae, expression: SX) -> bool:
    return symbols(expression).keys() <= symbols(ca.vertcat(*small.arguments)).keys()


def _remaining_invariants(dae: Dae, states: Sequence[int]) -> Iterator[Invariant]:
    """Yield the invariants all of whose states remain."""
    for invariant in dae.invariants:
        everything = ca.vertcat(invariant.residual, invariant.sizes)
        if {*invariant.states, *used(everything, dae.x)} <= {*states}:
            yield replace(invariant, states=tuple(states.index(i) for i in invariant.states))


def _chosen_rows(column: SX, rows: Sequence[int]) -> SX:
    return ca.vertcat(SX(0, 1), *(column[i] for i in rows))


def _pick(variables: Sequence[Variable], rows: Sequence[int]) -> tuple[Variable, ...]:
    return tuple(variables[i] for i in rows)
