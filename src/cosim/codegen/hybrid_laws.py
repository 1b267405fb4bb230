"""The laws of a model for the kernel of events (fmu/solvers/hybrid): functions and tables."""

from collections.abc import Collection, Sequence
from itertools import accumulate

import casadi as ca
from casadi import SX

from casadi_models.dae.expressions import column, replayed, symbols
from casadi_models.dae.hybrid import Hybrid
from cosim.memo import cached_per_thread

_ROUNDING = 1e-14  # relative, of a term
_SUMS = {ca.OP_ADD: 1, ca.OP_SUB: -1}


def law_functions(system: Hybrid) -> list[ca.Function]:
    """Return the functions of a model's relations and rules that fmu/runtime/equations.h declares.

    Args:
        system: Frozen equations.
    """
    dae = system.dae
    pairs = zip(system.of_time, system.relations, strict=True)
    times = column(int(own) * r.argument for own, r in pairs)
    defects = ca.vertcat(SX(0, 1), *(_defect(law.residual, dae.x) for law in dae.invariants))
    timed = [times, ca.densify(ca.jtimes(times, dae.t, 1))]
    seen = system.watching("seen")
    given = seen.mx_in()
    arguments, rates, _, _, seconds, sizes, ode = seen.call(given, True)
    span = system.time_bounds
    over, ends = [*dae.arguments, span.length], [span.low, span.high]
    bounds = [ca.Function("model_bounds", over, ends, {"cse": True})] if span.relations else []
    part = system.enclosures
    within, sides = [dae.t, *part.given, dae.u, dae.p], [part.low, part.high]
    if part.relations:
        bounds.append(ca.Function("model_enclosure", within, sides, {"cse": True}))
    decisions = [*system.rules, ca.densify(defects)]
    return [
        ca.Function("model_relations", given, [arguments, rates, seconds, sizes, ode]),
        system.rounding("model_rounding"),
        ca.Function("model_timed", dae.arguments, timed, {"cse": True}),
        ca.Function("model_conditions", dae.arguments, decisions, {"cse": True}),
        *bounds,
    ]


def _defect(residual: SX, x: SX) -> SX:
    """Return by how much states violate a constraint, beyond the rounding of its terms."""
    rounding = _ROUNDING * ca.fabs(ca.jacobian(residual, x)) @ ca.fabs(x)
    return ca.norm_inf(ca.fmax(ca.fabs(residual) - rounding, 0))


def law_sizes(system: Hybrid) -> dict[str, int]:
    """Return the sizes of the laws by the names of the kernel's macros."""
    return {
        "MODES": len(system.relations),
        "EVENTS": len(system.events),
        "ASSIGNED": sum(len(event.states) for event in system.events),
        "DEFECTS": len(system.dae.invariants),
        "BOUNDED": len(system.time_bounds.relations),
        "ENCLOSED": len(system.enclosures.relations),
    }


_FUNCTIONS = (
    "algebraic", "relations", "rounding", "timed", "conditions", "bounds", "enclosure", "inputs",
)  # fmt: skip
_TABLES = (
    "relation_table", "rule_table", "assigned_states", "adding", "barring", "bounded_ones",
    "enclosed_ones",
)  # fmt: skip


def law_tables(system: Hybrid, functions: Collection[ca.Function]) -> str:
    """Return the C tables of relations and rules; see fmu/solvers/hybrid/laws.h.

    `MODEL_LAWS` lists these and functions of the model in the order of fmu/solvers/model_laws.h.
    """
    known = {function.name() for function in functions}
    names = (f"model_{name}" for name in _FUNCTIONS)
    members = (*(name if name in known else "NULL" for name in names), *_TABLES)
    relations = [
        (r.floor, system.of_time[i], system.linear[i], system.of_input[i] + (i in system.resting),
         system.in_laws[i], r.at_zero)
        for i, r in enumerate(system.relations)
    ]  # fmt: skip
    barriers = _barriers(system)
    counts = [len(event.states) for event in system.events], [len(own) for own in barriers]
    first = [list(accumulate(sizes, initial=0)) for sizes in counts]
    rules = [
        (first[0][i], counts[0][i], first[1][i], counts[1][i], event.sampled, bool(event.message))
        for i, event in enumerate(system.events)
    ]
    numbers: dict[str, Sequence[int]] = {
        "int assigned_states": [state for event in system.events for state in event.states],
        "bool adding": added(system),
        "int barring": [i for own in barriers for i in own],
        "int bounded_ones": system.time_bounds.relations,
        "int enclosed_ones": system.enclosures.relations,
    }
    tables = [
        _rows("static const Relation relation_table", relations),
        _rows("static const Rule rule_table", rules),
        *(_numbers(f"static const {name}", values) for name, values in numbers.items()),
        f"#define MODEL_LAWS {{{', '.join(members)}}}",
    ]
    return "\n".join(tables) + "\n"


def _rows(head: str, rows: Sequence[tuple[int, ...]]) -> str:
    """Return a table that is not empty, as C knows no empty array."""
    width = 6  # members of either structure
    every = [*rows, (0,) * width]
    lines = (f"    {{{', '.join(str(int(value)) for value in row)}}},\n" for row in every)
    return f"{head}[] = {{\n{''.join(lines)}}};"


def _numbers(head: str, values: Sequence[int]) -> str:
    return f"{head}[] = {{{', '.join(str(int(value)) for value in (*values, 0))}}};"


@cached_per_thread(16)
def added(system: Hybrid) -> list[bool]:
    """Return for each assignment whether it adds to its state what does not depend on it."""
    states = ca.vertsplit(system.dae.x)
    return [
        _share_of(value, states[state]) == 1
        for event in system.events
        for state, value in zip(event.states, ca.vertsplit(event.values), strict=True)
    ]


def _share_of(value: SX, state: SX) -> float | None:
    """Return how often a state is a summand of a value; None if that depends on it otherwise."""
    used = list(symbols(value))
    if not used:
        return 0.0
    own = state.element_hash()

    def operation(code: int, terms: list[float | None]) -> float | None:
        if code in _SUMS and None not in terms:
            return float(terms[0] or 0) + _SUMS[code] * float(terms[1] or 0)
        return 0.0 if all(term == 0 for term in terms) else None

    (share,) = replayed(value, lambda leaf: float(leaf.element_hash() == own), operation)
    return share


@cached_per_thread(16)
def _barriers(system: Hybrid) -> list[list[int]]:
    """Return for each event the relations of its condition whose rates its assignments change."""
    dae, constant = system.dae, set(system.constant)
    unknown, moving = SX.sym("dz", dae.z.numel()), SX.sym("du", dae.u.numel())
    rates = ca.vertsplit(system.rates(system.arguments, unknown, moving))
    modes, states = ca.vertsplit(system.modes), ca.vertsplit(dae.x)
    found = list[list[int]]()
    for event in system.events:
        moved = ca.vertcat(SX(0, 1), *(states[i] for i in event.states if i not in constant))
        found.append(
            [
                i
                for i, relation in enumerate(system.relations)
                if not (relation.floor or system.of_time[i])
                and ca.depends_on(event.condition, modes[i])
                and moved.numel()
                and ca.depends_on(rates[i], moved)
            ]
        )
    return found
