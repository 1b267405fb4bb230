"""`linearized`: A, B, C, D of a model or an FMU near one state."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
from casadi import SX

from casadi_models.dae import Dae
from casadi_models.dae.hybrid import Hybrid
from cosim.arrays import Truths, Vector
from cosim.codegen.initialization import law_of_knowns
from cosim.errors import FmuError, InitialConditionError, UnknownName, UsageError
from cosim.fmi.archive import unpacked
from cosim.fmi.run.instance import (
    by_name,
    choose_interface,
    enter_continuous_time,
    initialize,
    instantiated,
    is_number,
    read_description,
)
from cosim.fmi.run.request import checked_values, output_names
from cosim.integrate.initial_values import algebraic_values
from cosim.integrate.initial_values import start_values as consistent_start
from cosim.integrate.kernel import settled
from cosim.integrate.keywords import requested
from cosim.integrate.modes import Instant, blended, hybrid, sliding
from cosim.integrate.outputs import recorded_columns
from cosim.integrate.run import run
from cosim.memo import cached_per_thread
from cosim.model.catalogue import load
from cosim.model.reduction import checked_outputs, pattern
from cosim.model.values import Values, assign, number
from cosim.study.linearize.linearization import Linearization, without_influence

START, EQUILIBRIUM = "start", "equilibrium"
MOST_NEWTON_STEPS = 60
SAME = 1e-9  # relative difference of equal linear systems
AT_REST = 1e-11  # largest rate of a state at rest, in nominal values per second


def linearized(
    model: Dae | str | os.PathLike[str],
    *,
    at: str | float = START,
    start_values: Mapping[str, float] | None = None,
    outputs: Sequence[str] | None = None,
    solver: str | None = None,
    relative_tolerance: float | None = None,
) -> Linearization:
    """Return the linear system near one state; see `linearize`."""
    if isinstance(at, str) and at not in (START, EQUILIBRIUM):
        raise UnknownName.among("linearize", "point", at, (START, EQUILIBRIUM, "a time in s"))
    if not isinstance(at, str):
        at = number("linearize", "at", at)
    if isinstance(model, str) and not model.endswith(".fmu"):
        model = load(model)
    if not isinstance(model, Dae):
        if at != START:
            raise UsageError(
                f"{model}: an FMU can be linearized at its initial state only; set start_values, "
                "or linearize the model"
            )
        return linearized_fmu(model, start_values, outputs)
    dae, values = model, assign(model, start_values)
    names = tuple(v.name for v in dae.output_variables)
    if outputs is not None:
        names = checked_outputs(dae, outputs)
    if isinstance(at, float):
        states = [v.name for v in dae.states]
        request = requested(
            dae,
            start_values=start_values,
            stop_time=at,
            output_interval=abs(at) or 1.0,
            solver=solver,
            relative_tolerance=relative_tolerance,
            outputs=states,
        )
        return _of_dae(dae, names, run(request).values[-1], values, at, f"{at:g} s of a run")
    x, point = consistent_start(dae, 0.0, values), "its initial state"
    if at == EQUILIBRIUM:
        x, point = _equilibrium(dae, x, values)
    return _of_dae(dae, names, x, values, 0.0, point)


def cyclic_states(dae: Dae) -> tuple[int, ...]:
    """Return the indices of the states that influence only each other."""
    return without_influence(_influence(dae))


def _influence(dae: Dae) -> Truths:
    """Return the sparsity of d(rate)/d(state), algebraic unknowns eliminated."""
    through = np.outer(pattern(dae.ode, dae.z).any(axis=1), pattern(dae.alg, dae.x).any(axis=0))
    return pattern(dae.ode, dae.x) | through


def _of_dae(
    dae: Dae, names: tuple[str, ...], x: Vector, values: Values, time: float, point: str
) -> Linearization:
    followed, u, edges = _followed(dae, time, x, values)
    n = len(x) + len(values.u)
    rates, outputs, jacobian = _at_point(followed, names, time, x, replace(values, u=u))
    for place, what in edges.items():
        other = np.where(np.arange(len(u)) == place, -u, u)
        change = _at_point(followed, names, time, x, replace(values, u=other))[2] - jacobian
        if not np.linalg.norm(change[:, :n]) <= SAME * np.linalg.norm(jacobian[:, :n]):
            raise InitialConditionError(
                f"{dae.full_name}: {what} is exactly at 0 at {point}, and the linear system is "
                "another one on each side; choose a state on one of them"
            )
    return Linearization.from_jacobian(
        jacobian[:, :n],
        depends=_influence(followed),
        model=dae.full_name,
        states=tuple(v.name for v in dae.states),
        inputs=tuple(v.name for v in dae.inputs),
        outputs=names,
        time=time,
        x=x,
        u=values.u,
        y=outputs,
        rates=rates,
        nominal=np.array([v.nominal for v in dae.states]),
        point=point,
    )


def _followed(
    dae: Dae, time: float, x: Vector, values: Values
) -> tuple[Dae, Vector, dict[int, str]]:
    """Return the equations that a run follows from a state, and their inputs.

    These are the inputs of the model and the modes of its relations. The last result are those of
    them, by position, that may have two values here, and what they are.
    """
    system = hybrid(dae)
    if system is None or not system.relations:
        return dae, values.u, {}
    z, still = algebraic_values(dae, time, x, values), np.zeros(len(values.u))
    at = Instant(time, x, z, values.u, still, np.ones(len(system.relations)))
    at, zero = settled(system, at, values.p)
    u, n = np.concatenate((values.u, at.modes)), len(values.u)
    edges = {n + i: system.described(i) for i in zero - at.sliding if not system.floors[i]}
    return _without_events(system, at.sliding), u, edges


@cached_per_thread(8)
def _without_events(system: Hybrid, slides: frozenset[int]) -> Dae:
    """Return frozen equations in which outputs follow what slides."""
    own = sliding(blended(system), slides)
    if not slides:
        return own.dae
    held, solved = own.modes[list(own.sliding)], own.solved
    return replace(own.dae, outputs=ca.substitute(own.dae.outputs, held, solved))


def _at_point(
    dae: Dae, names: tuple[str, ...], time: float, x: Vector, values: Values
) -> tuple[Vector, Vector, Vector]:
    """Return rates and outputs at a state, and their derivatives by states and inputs."""
    z, function = algebraic_values(dae, time, x, values), _jacobians(dae, names)
    rates, outputs, by_xu, by_z, alg_xu, alg_z = (
        np.array(block) for block in function.call([time, x, z, values.u, values.p])
    )
    if len(z):
        by_xu = by_xu - by_z @ np.linalg.solve(alg_z, alg_xu)
    return rates.ravel(), outputs.ravel(), by_xu


@cached_per_thread(8)
def _jacobians(dae: Dae, names: tuple[str, ...]) -> ca.Function:
    """Return the function of rates, outputs, and the partial derivatives of both and of alg."""
    dae = dae.watching(names)
    _, places = recorded_columns(dae, names)
    chosen = ca.densify(ca.vertcat(dae.x, dae.z, dae.outputs)[list(places)])
    xu = ca.vertcat(dae.x, dae.u)
    both = ca.vertcat(dae.ode, chosen)
    blocks = [ca.jacobian(rows, by) for rows in (both, dae.alg) for by in (xu, dae.z)]
    return ca.Function(
        "jacobians", dae.arguments, [dae.ode, chosen, *map(ca.densify, blocks)], {"cse": True}
    )


def _equilibrium(dae: Dae, x: Vector, values: Values) -> tuple[Vector, str]:
    """Return the equilibrium that Newton's method reaches, and its description.

    If several states can move, the step of least norm is taken. Invariants stay zero. Cyclic
    states retain their values, and their rates need not vanish.
    """
    cyclic, driven = cyclic_states(dae), [bool(row.any()) for row in _influence(dae)]
    free = [i for i in range(len(x)) if i not in cyclic]
    # A state whose rate depends on no state, e.g. a prescribed speed, retains its value, unless
    # there is no equilibrium with it
    try:
        return _rest(dae, x, values, free, [i for i in free if driven[i]])
    except InitialConditionError:
        return _rest(dae, x, values, free, free)


def _rest(
    dae: Dae, x: Vector, values: Values, resting: list[int], movable: list[int]
) -> tuple[Vector, str]:
    """Return the state in which the `resting` states are at rest, and its description.

    Newton's method changes the `movable` ones only; both are indices of states.
    """
    sizes = np.array([v.nominal for v in dae.states])
    nominal = sizes[movable]
    residual = ca.vertcat(SX(0, 1), *(invariant.residual for invariant in dae.invariants))
    law = law_of_knowns(dae, "law", residual, ca.jacobian(residual, dae.x))

    def defect(x: Vector) -> tuple[Vector, Vector]:
        followed, u, _ = _followed(dae, 0.0, x, values)
        rates, _, jacobian = _at_point(followed, (), 0.0, x, replace(values, u=u))
        left, slope = (np.array(block) for block in law(0.0, x, values.u, values.p))
        rows = np.concatenate(((rates / sizes)[resting], left.ravel()))
        by_x = (jacobian[: len(x)] / sizes[:, None])[np.ix_(resting, movable)]
        return rows, np.vstack((by_x, slope[:, movable])) * nominal

    start, (rows, slope) = x, defect(x)
    for step in range(MOST_NEWTON_STEPS):
        if np.abs(rows).max(initial=0.0) <= AT_REST:
            moved = np.abs(x - start)[movable] / nominal
            if not moved.size or moved.max() == 0:
                return x, "its initial state, an equilibrium"
            most = movable[int(moved.argmax())]
            name, unit = dae.states[most].name, dae.states[most].unit
            return x, (
                f"an equilibrium, {step} steps of Newton's method from the initial state "
                f"({name} = {x[most]:.6g} {unit} instead of {start[most]:.6g})"
            )
        change = -np.linalg.lstsq(slope, rows, rcond=1e-12)[0] * nominal
        for _ in range(30):
            trial = x.copy()
            trial[movable] += change
            found = defect(trial)
            if np.linalg.norm(found[0]) < np.linalg.norm(rows):
                break
            change = change / 2
        else:
            break
        x, (rows, slope) = trial, found
    worst = int(np.abs(rows).argmax())
    what = "a constraint" if worst >= len(resting) else dae.states[resting[worst]].name
    raise InitialConditionError(
        f"{dae.full_name}: there is no equilibrium near the initial state: {what} cannot come to "
        f"rest (its rate is {rows[worst]:.3g} nominal values per second where Newton's method "
        "stops); start nearer to an equilibrium, or change the parameters and inputs that drive "
        "the model"
    )


def linearized_fmu(
    path: str | os.PathLike[str],
    start_values: Mapping[str, float] | None,
    outputs: Sequence[str] | None,
) -> Linearization:
    """Initialize an FMU for model exchange and evaluate its directional derivatives.

    Its binary runs in this process: only run FMUs you trust. Values are in the FMU's units.

    Raises:
        FmuError: It is no FMU for model exchange, or has no directional derivatives, or failed.
        UnknownName, UsageError: A variable does not exist or cannot be set.
    """
    with unpacked(path) as folder:
        description = read_description(folder, path)
        choose_interface(folder, description, "ModelExchange", path)
        if not description.modelExchange.providesDirectionalDerivative:
            raise FmuError(f"{path} has no directional derivatives; linearize the model itself")
        variables = by_name(description)
        values = checked_values(path, variables, start_values or {})
        rates = [item.variable for item in description.derivatives]
        states = [rate.derivative for rate in rates]
        every = description.modelVariables
        inputs = [v for v in every if v.causality == "input" and is_number(v)]
        shown = [variables[name] for name in output_names(path, variables, outputs)]
        with instantiated(folder, description, "ModelExchange", path) as (instance, explained):
            try:
                initialize(instance, description, values, startTime=0.0)
                enter_continuous_time(instance, description)
                x, u, y, slopes = (
                    _values(instance, group) for group in (states, inputs, shown, rates)
                )
                jacobian = _jacobian(instance, (*rates, *shown), (*states, *inputs))
            except FmuError:
                raise
            except Exception as error:
                raise explained(error) from error
    return Linearization.from_jacobian(
        jacobian,
        model=description.modelName,
        states=tuple(v.name for v in states),
        inputs=tuple(v.name for v in inputs),
        outputs=tuple(v.name for v in shown),
        time=0.0,
        x=x,
        u=u,
        y=y,
        rates=slopes,
        nominal=np.array([float(v.nominal or 1.0) for v in states]),
        point="the initial state of an FMU",
    )


def _values(instance: Any, variables: Sequence[Any]) -> Vector:
    references = [v.valueReference for v in variables]
    if not references:
        return np.empty(0)
    getter = instance.getReal if hasattr(instance, "getReal") else instance.getFloat64
    return np.array(getter(references), dtype=float)


def _jacobian(instance: Any, unknowns: Sequence[Any], knowns: Sequence[Any]) -> Vector:
    rows = [v.valueReference for v in unknowns]
    columns = [
        instance.getDirectionalDerivative(rows, [known.valueReference], [1.0]) for known in knowns
    ]
    return np.array(columns, dtype=float).reshape(len(knowns), len(unknowns)).T
