"""`reduce`: from a DAE and the wanted outputs to the DAE that computes them, and nothing more.

Structural passes over the sparsity of the equations; the result computes the wanted outputs by
the same expressions as before, so that trajectories stay the same on both roads.
"""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from casadi import SX
from numpy.typing import NDArray

from casadi_models.dae import Dae, Invariant, StartRule, Variable
from cosim.errors import UnknownName, UsageError
from cosim.model.catalogue import no_such_output, observable
from cosim.model.values import A_DAE, listed

Pattern = NDArray[np.bool_]


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


def reduce(dae: Dae, outputs: Sequence[str], *, freeze: Collection[str] = ()) -> Dae:
    """Return the DAE that the wanted outputs require.

    The passes: keep the wanted outputs; keep the states they depend on, through derivatives,
    algebraic unknowns and start values; drop algebraic unknowns, inputs and parameters that are
    left without influence; make frozen parameters numbers.

    Args:
        dae: The full model.
        outputs: Names of states, algebraic unknowns or outputs.
        freeze: Parameters that shall not change any more; their values become constants.

    Returns:
        A DAE whose `observed` names are `outputs` and whose `report` says what went and why.

    Raises:
        UnknownName: The model has no such output; another formulation that has it is named.
        UsageError: No output is wanted, or one is named twice; or an argument is no list.
    """
    if not isinstance(dae, Dae):
        raise UsageError.of_type("reduce", dae, A_DAE)
    if isinstance(freeze, str) or not isinstance(freeze, Collection):
        raise UsageError.of_type(f"{dae.full_name}: freeze", freeze, "a list of parameters")
    outputs = listed(f"{dae.full_name}: outputs", outputs)
    wanted = _checked(dae, outputs)
    frozen = _freeze(dae.watching(wanted), freeze)
    kept_y = [i for i, v in enumerate(frozen.output_variables) if v.name in wanted]
    observed = ca.vertcat(SX(0, 1), *(frozen.outputs[i] for i in kept_y))
    states, unknowns, equations = _closure(frozen, wanted, observed)
    rules = _kept_rules(frozen, states)
    needed = ca.vertcat(
        frozen.ode[states], frozen.alg[equations], observed, *(rule.expression for rule in rules)
    )
    inputs = _used(needed, frozen.u)
    parameters = _used(needed, frozen.p)
    ode, alg, shared = _shared(frozen.ode[states], frozen.alg[equations], observed)
    small = replace(
        frozen,
        x=_rows(frozen.x, states),
        z=_rows(frozen.z, unknowns),
        u=_rows(frozen.u, inputs),
        p=_rows(frozen.p, parameters),
        ode=ode,
        alg=alg,
        outputs=shared,
        states=_pick(frozen.states, states),
        algebraics=_pick(frozen.algebraics, unknowns),
        inputs=_pick(frozen.inputs, inputs),
        parameters=_pick(frozen.parameters, parameters),
        output_variables=_pick(frozen.output_variables, kept_y),
        start_rules=tuple(_renumbered(rule, states) for rule in rules),
        inertias=_kept_inertias(frozen, parameters),
        observed=tuple(outputs),
        x_start=tuple(frozen.x_start[i] for i in states),
        monitors=(),
        invariants=tuple(_kept_invariants(frozen, states, parameters)),
        closing=frozen.closing
        and replace(frozen.closing, residual=frozen.closing.residual[equations]),
    )
    small = replace(small, limits=_kept_limits(small))
    return replace(small, report=tuple(_report(dae, small, freeze)))


def _checked(dae: Dae, outputs: Sequence[str]) -> frozenset[str]:
    available = observable(dae)
    for name in outputs:
        if name not in available:
            raise no_such_output(dae, name)
    if len(set(outputs)) < len(outputs):
        twice = next(name for name in outputs if list(outputs).count(name) > 1)
        raise UsageError(f"{dae.full_name}: output '{twice}' is named twice; name it once")
    return frozenset(outputs)


def _freeze(dae: Dae, names: Collection[str]) -> Dae:
    known = {v.name: v for v in dae.parameters}
    for name in names:
        if name not in known:
            raise UnknownName.among(dae.full_name, "parameter", name, known)
    values = SX(dae.p)
    for i, parameter in enumerate(dae.parameters):
        if parameter.name in names:
            values[i] = parameter.start or 0.0
    margins = ca.vertcat(SX(0, 1), *(margin for margin, _ in dae.limits))
    drifts = [column for i in dae.invariants for column in (i.residual, i.sizes)]
    fixed = ca.substitute([dae.ode, dae.alg, dae.outputs, margins, *drifts], [dae.p], [values])
    rules = tuple(
        replace(rule, expression=ca.substitute(rule.expression, dae.p, values))
        for rule in dae.start_rules
    )
    closing = dae.closing and replace(
        dae.closing, residual=ca.substitute(dae.closing.residual, dae.p, values)
    )
    ode, alg, outputs, margins, *drifts = (ca.densify(column) for column in fixed)
    limits = tuple((margins[i], meaning) for i, (_, meaning) in enumerate(dae.limits))
    invariants = tuple(
        replace(invariant, residual=residual, sizes=sizes)
        for invariant, residual, sizes in zip(
            dae.invariants, drifts[::2], drifts[1::2], strict=True
        )
    )
    return replace(
        dae,
        ode=ode,
        alg=alg,
        outputs=outputs,
        start_rules=rules,
        limits=limits,
        invariants=invariants,
        closing=closing,
    )


def _closure(
    dae: Dae, wanted: frozenset[str], observed: SX
) -> tuple[list[int], list[int], list[int]]:
    """Return the positions of the states, algebraic unknowns and equations that are needed."""
    equation = _matching(dae)
    ode_x, ode_z = _pattern(dae.ode, dae.x), _pattern(dae.ode, dae.z)
    alg_x, alg_z = _pattern(dae.alg, dae.x)[equation], _pattern(dae.alg, dae.z)[equation]
    x = np.array([v.name in wanted for v in dae.states], dtype=bool)
    z = np.array([v.name in wanted for v in dae.algebraics], dtype=bool)
    x |= _pattern(observed, dae.x).any(axis=0)
    z |= _pattern(observed, dae.z).any(axis=0)
    while True:
        more_z = z | ode_z[x].any(axis=0) | alg_z[z].any(axis=0)
        more_x = x | ode_x[x].any(axis=0) | alg_x[z].any(axis=0)
        for rule in dae.start_rules:
            if more_x[list(rule.states)].any():
                more_x[list(rule.states)] = True
                more_x |= _pattern(rule.expression, dae.x).any(axis=0)
        if (more_x == x).all() and (more_z == z).all():
            break
        x, z = more_x, more_z
    unknowns = [int(i) for i in np.flatnonzero(z)]
    return [int(i) for i in np.flatnonzero(x)], unknowns, sorted(int(equation[i]) for i in unknowns)


def _matching(dae: Dae) -> NDArray[np.int_]:
    """Return for each algebraic unknown an equation of its own that depends on it."""
    equation = np.zeros(len(dae.algebraics), dtype=int)
    if dae.algebraics:
        _, rows, columns, *_ = ca.jacobian_sparsity(dae.alg, dae.z).btf()
        equation[list(columns)] = list(rows)
    return equation


def _pattern(expression: SX, variables: SX) -> Pattern:
    sparsity = ca.jacobian_sparsity(expression, variables)
    return np.array(ca.DM.ones(sparsity).full(), dtype=bool).reshape(sparsity.shape)


def _kept_rules(dae: Dae, states: Sequence[int]) -> list[StartRule]:
    return [rule for rule in dae.start_rules if set(rule.states) <= set(states)]


def _renumbered(rule: StartRule, states: Sequence[int]) -> StartRule:
    return replace(rule, states=tuple(states.index(i) for i in rule.states))


def _kept_inertias(dae: Dae, parameters: Sequence[int]) -> tuple[tuple[str, SX], ...]:
    kept = _rows(dae.p, parameters)
    names = {symbol.name() for symbol in ca.vertsplit(kept)}
    return tuple(
        (body, matrix)
        for body, matrix in dae.inertias
        if all(symbol.name() in names for symbol in ca.symvar(matrix))
    )


def _kept_limits(small: Dae) -> tuple[tuple[SX, str], ...]:
    """Return the limits that can still be evaluated: they keep no variable alive."""
    symbols = ca.symvar(ca.vertcat(small.t, small.x, small.z, small.u, small.p))
    known = {symbol.element_hash() for symbol in symbols}
    return tuple(
        (margin, meaning)
        for margin, meaning in small.limits
        if all(symbol.element_hash() in known for symbol in ca.symvar(margin))
    )


def _kept_invariants(
    dae: Dae, states: Sequence[int], parameters: Sequence[int]
) -> Iterator[Invariant]:
    """Yield the invariants of which everything is kept; a part of one is none."""
    for invariant in dae.invariants:
        everything = ca.vertcat(invariant.residual, invariant.sizes)
        needed = {*invariant.states, *_used(everything, dae.x)}
        if needed <= set(states) and set(_used(everything, dae.p)) <= set(parameters):
            yield replace(invariant, states=tuple(states.index(i) for i in invariant.states))


def _used(expression: SX, variables: SX) -> list[int]:
    used = _pattern(expression, variables).any(axis=0)
    return [int(i) for i in np.flatnonzero(used)]


def _shared(*columns: SX) -> list[SX]:
    return [ca.densify(ca.reshape(column, -1, 1)) for column in ca.cse(list(columns))]


def _rows(column: SX, rows: Sequence[int]) -> SX:
    return ca.vertcat(SX(0, 1), *(column[i] for i in rows))


def _pick(variables: Sequence[Variable], rows: Sequence[int]) -> tuple[Variable, ...]:
    return tuple(variables[i] for i in rows)


def _report(full: Dae, small: Dae, freeze: Collection[str]) -> Iterator[str]:
    if freeze:
        yield f"freeze: {', '.join(freeze)} became numbers"
    passes = (
        ("outputs", full.output_variables, small.output_variables, "not wanted"),
        ("states", full.states, small.states, "no wanted output depends on them"),
        ("algebraics", full.algebraics, small.algebraics, "nothing kept needs them"),
        ("inputs", full.inputs, small.inputs, "they act on nothing kept"),
        ("parameters", full.parameters, small.parameters, "they act on nothing kept"),
    )
    for what, before, after, why in passes:
        names = {v.name for v in after}
        gone = [v.name for v in before if v.name not in names and v.name not in freeze]
        if gone:
            yield f"{what}: {len(before)} -> {len(after)}; {', '.join(gone)}: {why}"
    watched = {meaning for _, meaning in small.limits}
    if gone := [meaning for _, meaning in full.limits if meaning not in watched]:
        yield f"limits: {len(full.limits)} -> {len(watched)}; not watched: {'; '.join(gone)}"
    everything = ca.vertcat(small.ode, small.alg, small.outputs)
    if not ca.depends_on(everything, small.t):
        yield "time: the equations do not depend on it"
    counts = [str(dae.operations(with_outputs=True)) for dae in (full, small)]
    yield f"operations: {' -> '.join(counts)}"
