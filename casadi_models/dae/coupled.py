"""Several models as one: inputs are replaced by the outputs that drive them."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import casadi as ca
from casadi import SX

from casadi_models.dae.drawing import WORLD, Drawing, World
from casadi_models.dae.frozen import Dae
from casadi_models.dae.invariants import Closing
from casadi_models.dae.packed import rewritten
from casadi_models.dae.starts import reject_disorder
from casadi_models.dae.variables import Experiment, Start, Variable


class Connection(NamedTuple):
    """An output that drives an input, each as (part, variable): input = factor output + offset."""

    input: tuple[str, str]
    output: tuple[str, str]
    factor: float
    offset: float


_COLUMNS = (("x", "states"), ("z", "algebraics"), ("u", "inputs"), ("p", "parameters"))


def joined(name: str, title: str, parts: Mapping[str, Dae], wires: Sequence[Connection]) -> Dae:
    """Return one model of all parts, with variables `part.variable`.

    A connected input becomes an output. The inputs of a loop of direct feedthrough become algebraic
    unknowns unless they follow from linear equations.

    Raises:
        ValueError: A loop has no solution, or start values would depend on one.
    """
    time = SX.sym("time")
    daes = [_renamed(part, dae, time) for part, dae in parts.items()]
    whole = _side_by_side(name, title, daes)
    if not wires:
        return whole
    names = [v.name for v in whole.inputs]
    places = [names.index(".".join(wire.input)) for wire in wires]
    driven = whole.u[places]
    sources = _sources(whole)
    laws = ca.vertcat(*(w.factor * sources[".".join(w.output)] + w.offset for w in wires))
    values, unknowns, residuals = _without_loops(laws, driven, [names[i] for i in places])
    wired = whole.rewritten(lambda all_laws: ca.substitute(all_laws, [driven], [values]))
    left = [i for i in range(len(names)) if i not in places]
    u = ca.vertcat(SX(0, 1), *(whole.u[i] for i in left))  # whole.u[[]] may be a row
    variables = [replace(whole.inputs[i], minimum=-ca.inf, maximum=ca.inf) for i in places]
    outputs = [(v, row) for v, row in zip(variables, ca.vertsplit(values), strict=True)]
    solved = [v for v in variables if v.name in unknowns]
    reject_disorder(wired.start_rules, wired.t, wired.x, u, wired.p)
    shown = [(_output(v), row) for v, row in outputs if v.name not in unknowns]
    closing = wired.closing
    if closing is not None and solved:
        closing = replace(closing, residual=ca.vertcat(closing.residual, *residuals))
    return replace(
        wired,
        u=u,
        inputs=tuple(whole.inputs[i] for i in left),
        z=ca.vertcat(wired.z, *(driven[i] for i, v in enumerate(variables) if v in solved)),
        alg=ca.densify(ca.vertcat(wired.alg, *residuals)),
        algebraics=(
            *wired.algebraics,
            *(replace(v, start=v.start or 0.0, start_kind=Start.GUESS) for v in solved),
        ),
        outputs=ca.densify(ca.vertcat(wired.outputs, *(row for _, row in shown))),
        output_variables=(*wired.output_variables, *(v for v, _ in shown)),
        observed=(*wired.observed, *(v.name for v in variables)),
        closing=closing,
    )


def _without_loops(laws: SX, driven: SX, names: Sequence[str]) -> tuple[SX, list[str], list[SX]]:
    """Return driven inputs without each other, where they are no unknowns of a loop.

    Returns:
        Their values, (n, 1), in which the unknowns of nonlinear loops stand for themselves; the
        names of these; their residuals.
    """
    depends = ca.Sparsity(ca.jacobian_sparsity(laws, driven))
    loops = _loops(depends)
    unknowns, residuals = list[str](), list[SX]()
    values = laws
    for loop in loops:
        u, rows = driven[loop], values[loop]
        slopes = ca.jacobian(rows, u)
        if ca.depends_on(ca.vec(slopes), u):
            unknowns += [names[i] for i in loop]
            residuals += ca.vertsplit(u - rows)
            solved = u
        else:
            matrix = SX.eye(len(loop)) - slopes
            constant = ca.Function("m", [ca.vertcat(*ca.symvar(matrix))], [matrix])
            if not ca.symvar(matrix) and abs(float(ca.det(ca.DM(constant(SX(0, 1)))))) < 1e-12:
                members = ", ".join(names[i] for i in loop)
                raise ValueError(f"the loop through {members} has no unique solution")
            solved = ca.solve(matrix, ca.substitute(rows, u, SX.zeros(len(loop))))
        values[loop] = solved
    unknown = [i for i, n in enumerate(names) if n in unknowns]
    rest = [i for i in range(len(names)) if i not in unknown]
    for _ in names:
        known = driven[rest]
        if not rest or not ca.depends_on(values[rest], known):
            break
        values[rest] = ca.substitute(values[rest], known, values[rest])
    residuals = [ca.substitute(r, driven[rest], values[rest]) for r in residuals]
    return values, unknowns, residuals


def _loops(depends: ca.Sparsity) -> list[list[int]]:
    """Return the strongly connected components of a square pattern that hold a cycle."""
    _, order, ends = depends.scc()
    found = [sorted(order[a:b]) for a, b in pairwise(ends)]
    return [loop for loop in found if len(loop) > 1 or depends.has_nz(loop[0], loop[0])]


def _sources(dae: Dae) -> dict[str, SX]:
    pairs = ((dae.states, dae.x), (dae.algebraics, dae.z), (dae.output_variables, dae.outputs))
    return {
        v.name: row
        for variables, column in pairs
        for v, row in zip(variables, ca.vertsplit(column), strict=True)
    }


def _output(variable: Variable) -> Variable:
    return replace(variable, start=None, start_kind=Start.CALCULATED)


def _renamed(part: str, dae: Dae, time: SX) -> Dae:
    """Return a model with symbols of its own but time; their names begin with that of the part."""
    old, new = [dae.t], [time]
    own = dict[str, Any]()
    for column, kind in _COLUMNS:
        variables = getattr(dae, kind)
        named = [replace(v, name=f"{part}.{v.name}") for v in variables]
        old.append(getattr(dae, column))
        new.append(ca.vertcat(SX(0, 1), *(SX.sym(v.name) for v in named)))
        own |= {column: new[-1], kind: tuple(named)}
    if dae.closing is not None:
        old.append(dae.closing.symbol)
        new.append(SX.sym(f"{part}.closing_rate"))

    def in_new_symbols(laws: list[SX]) -> list[SX]:
        return ca.substitute(laws, old, new)

    def named_variable(v: Variable) -> Variable:
        return replace(v, name=f"{part}.{v.name}")

    def with_longer_names(drawn: list[SX]) -> list[SX]:
        symbols = ca.symvar(ca.veccat(SX(0, 1), *drawn))
        moving = [s for s in symbols if s.name() != "time"]
        longer = [SX.sym(f"{part}.{s}") for s in moving]
        return ca.substitute(drawn, moving, longer) if moving else drawn

    changed = dae.rewritten(in_new_symbols)
    inertias = rewritten(dae.inertias, in_new_symbols)
    drawing = rewritten(dae.drawing, with_longer_names)  # it knows variables by name
    return replace(
        changed,
        name=part,
        t=time,
        **own,
        output_variables=tuple(map(named_variable, dae.output_variables)),
        monitors=tuple((named_variable(v), row) for v, row in changed.monitors),
        limits=tuple((row, f"{part}: {meaning}") for row, meaning in changed.limits),
        invariants=tuple(replace(i, meaning=f"{part}: {i.meaning}") for i in changed.invariants),
        events=tuple(replace(e, name=f"{part}: {e.name}") for e in changed.events),
        start_outputs=tuple(
            replace(s, variable=named_variable(s.variable)) for s in changed.start_outputs
        ),
        start_rules=tuple(
            replace(rule, meaning=f"{part}: {rule.meaning}") for rule in changed.start_rules
        ),
        inertias=tuple((f"{part}: {body}", matrix) for body, matrix in inertias),
        observed=tuple(f"{part}.{name}" for name in dae.observed),
        mode_names=tuple(replace(m, state=f"{part}.{m.state}") for m in dae.mode_names),
        drawing=_named_drawing(part, drawing),
    )


def _named_drawing(part: str, drawing: Drawing) -> Drawing:
    def named(body: str) -> str:
        return body if body in ("", WORLD) else f"{part}.{body}"

    return replace(
        drawing,
        bodies=tuple(replace(b, name=named(b.name)) for b in drawing.bodies),
        shapes=tuple(
            replace(s, name=f"{part}.{s.name}", body=named(s.body)) for s in drawing.shapes
        ),
        arrows=tuple(replace(a, name=f"{part}.{a.name}") for a in drawing.arrows),
        traces=tuple(replace(t, name=f"{part}.{t.name}") for t in drawing.traces),
        world=replace(drawing.world, follow=named(drawing.world.follow)),
        numbers={f"{part}.{name}": value for name, value in drawing.numbers.items()},
    )


def _side_by_side(name: str, title: str, daes: Sequence[Dae]) -> Dae:
    """Return one model of renamed parts that do not know of each other."""
    shifted, states = list[Dae](), 0
    for dae in daes:
        shifted.append(_with_states_from(dae, states))
        states += len(dae.states)

    def stacked(attribute: str) -> SX:
        return ca.vertcat(SX(0, 1), *(getattr(dae, attribute) for dae in shifted))

    def together(attribute: str) -> tuple[Any, ...]:
        return tuple(item for dae in shifted for item in getattr(dae, attribute))

    columns = ("x", "z", "u", "p", "ode", "alg", "outputs")
    tuples = (
        *("states", "algebraics", "inputs", "parameters", "output_variables", "start_rules"),
        *("inertias", "observed", "x_start", "limits", "invariants", "monitors", "start_outputs"),
        *("events", "smooth", "mode_names"),
    )
    laws: dict[str, Any] = {column: ca.densify(stacked(column)) for column in columns}
    laws |= {kind: together(kind) for kind in tuples}
    return Dae(
        name=name,
        formulation="",
        description=title or f"{len(daes)} coupled parts",
        source="",
        experiment=Experiment(
            max(dae.experiment.stop_time for dae in daes),
            min(dae.experiment.output_interval for dae in daes),
            min(dae.experiment.reference_tolerance for dae in daes),
        ),
        t=daes[0].t,
        closing=_closing(shifted),
        drawing=_together_in_one_world([dae.drawing for dae in daes]),
        **laws,
    )


def _together_in_one_world(drawings: Sequence[Drawing]) -> Drawing:
    """Return all drawings in the world of the first one that shows something."""
    seen: dict[str, Any] = {
        kind: tuple(item for drawing in drawings for item in getattr(drawing, kind))
        for kind in ("bodies", "shapes", "arrows", "traces")
    }
    seen["bodies"] = tuple({body.name: body for body in seen["bodies"]}.values())  # one world
    world = next((drawing.world for drawing in drawings if drawing), World())
    numbers = {name: value for drawing in drawings for name, value in drawing.numbers.items()}
    return Drawing(world=world, numbers=numbers, **seen)


def _with_states_from(dae: Dae, first: int) -> Dae:
    """Return a model whose positions of states count from another number on."""

    def moved(places: tuple[int, ...]) -> tuple[int, ...]:
        return tuple(first + place for place in places)

    return replace(
        dae,
        start_rules=tuple(replace(r, states=moved(r.states)) for r in dae.start_rules),
        start_outputs=tuple(replace(s, state=first + s.state) for s in dae.start_outputs),
        invariants=tuple(replace(i, states=moved(i.states)) for i in dae.invariants),
        events=tuple(replace(e, states=moved(e.states)) for e in dae.events),
    )


def _closing(daes: Sequence[Dae]) -> Closing | None:
    """Return how drift decays in all parts; their rates keep their ratios to the largest."""
    known = [dae.closing for dae in daes if dae.closing is not None]
    if not known:
        return None
    symbol, rate = SX.sym("closing_rate"), max(closing.rate for closing in known)
    residuals = []
    for dae in daes:
        residual = dae.alg
        if dae.closing is not None:
            share = dae.closing.rate / rate if rate else 1.0
            residual = ca.substitute(dae.closing.residual, dae.closing.symbol, share * symbol)
        residuals.append(residual)
    return Closing(rate, symbol, ca.vertcat(*residuals))
