"""`reduce`: from a DAE and the wanted outputs to the DAE that computes them, and nothing more.

Structural passes over the sparsity of the equations; the result computes the wanted outputs by
the same expressions as before, so that trajectories stay the same on both roads.
"""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace

import casadi as ca
from casadi import SX

from casadi_models.dae import Dae, Invariant, StartThrough, Variable
from cosim.errors import UsageError
from cosim.model.catalogue import no_such_output, observable
from cosim.model.reduction.freeze import frozen_at_start
from cosim.model.reduction.report import reduction_report
from cosim.model.reduction.structure import closure, used
from cosim.model.values import A_DAE, listed


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

    Example:
        >>> import cosim
        >>> small = reduce(cosim.load("bicycle"), ["phi", "delta"])
        >>> len(small.states), small.observed
        (6, ('phi', 'delta'))
    """
    if not isinstance(dae, Dae):
        raise UsageError.of_type("reduce", dae, A_DAE)
    if isinstance(freeze, str) or not isinstance(freeze, Collection):
        raise UsageError.of_type(f"{dae.full_name}: freeze", freeze, "a list of parameters")
    outputs = listed(f"{dae.full_name}: outputs", outputs)
    wanted = _checked(dae, outputs)
    frozen = frozen_at_start(dae.watching(wanted), freeze)
    kept_y = [i for i, v in enumerate(frozen.output_variables) if v.name in wanted]
    observed = ca.vertcat(SX(0, 1), *(frozen.outputs[i] for i in kept_y))
    states, unknowns, equations = closure(frozen, wanted, observed)
    rules = [rule for rule in frozen.start_rules if set(rule.states) <= set(states)]
    needed = ca.vertcat(
        frozen.ode[states], frozen.alg[equations], observed, *(rule.expression for rule in rules)
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
        output_variables=_pick(frozen.output_variables, kept_y),
        start_rules=tuple(
            replace(rule, states=tuple(map(states.index, rule.states))) for rule in rules
        ),
        start_outputs=(),
        inertias=_kept_inertias(frozen, parameters),
        observed=tuple(outputs),
        x_start=tuple(frozen.x_start[i] for i in states),
        drawing=frozen.drawing.with_numbers({v.name: v.start or 0.0 for v in frozen.parameters}),
        invariants=tuple(_kept_invariants(frozen, states, inputs, parameters)),
        closing=frozen.closing
        and replace(frozen.closing, residual=frozen.closing.residual[equations]),
    )
    ways = tuple(_kept_ways(small, frozen, states))
    limits = tuple(limit for limit in small.limits if _computable(small, limit[0]))
    monitors = tuple(monitor for monitor in small.monitors if _computable(small, monitor[1]))
    small = replace(small, limits=limits, start_outputs=ways, monitors=monitors)
    return replace(small, report=tuple(reduction_report(dae, small, freeze)))


def _checked(dae: Dae, outputs: Sequence[str]) -> frozenset[str]:
    available = observable(dae)
    for name in outputs:
        if name not in available:
            raise no_such_output(dae, name)
    if len(set(outputs)) < len(outputs):
        twice = next(name for name in outputs if list(outputs).count(name) > 1)
        raise UsageError(f"{dae.full_name}: output '{twice}' is named twice; name it once")
    return frozenset(outputs)


def _kept_inertias(dae: Dae, parameters: Sequence[int]) -> tuple[tuple[str, SX], ...]:
    kept = _chosen_rows(dae.p, parameters)
    names = {symbol.name() for symbol in ca.vertsplit(kept)}
    return tuple(
        (body, matrix)
        for body, matrix in dae.inertias
        if all(symbol.name() in names for symbol in ca.symvar(matrix))
    )


def _kept_ways(small: Dae, full: Dae, states: Sequence[int]) -> Iterator[StartThrough]:
    """Yield the outputs that still give a start; they keep no variable alive, either."""
    for way in full.start_outputs:
        if way.state in states and _computable(small, way.expression):
            yield replace(way, state=states.index(way.state))


def _computable(small: Dae, expression: SX) -> bool:
    symbols = ca.symvar(ca.vertcat(small.t, small.x, small.z, small.u, small.p))
    known = {symbol.element_hash() for symbol in symbols}
    return all(symbol.element_hash() in known for symbol in ca.symvar(expression))


def _kept_invariants(
    dae: Dae, states: Sequence[int], inputs: Sequence[int], parameters: Sequence[int]
) -> Iterator[Invariant]:
    """Yield the invariants of which everything is kept; a part of one is none."""
    for invariant in dae.invariants:
        everything = ca.vertcat(invariant.residual, invariant.sizes)
        needed = {*invariant.states, *used(everything, dae.x)}
        kept = ((dae.u, inputs), (dae.p, parameters))
        if needed <= {*states} and all({*used(everything, v)} <= {*rows} for v, rows in kept):
            yield replace(invariant, states=tuple(states.index(i) for i in invariant.states))


def _chosen_rows(column: SX, rows: Sequence[int]) -> SX:
    return ca.vertcat(SX(0, 1), *(column[i] for i in rows))


def _pick(variables: Sequence[Variable], rows: Sequence[int]) -> tuple[Variable, ...]:
    return tuple(variables[i] for i in rows)
