"""`linearize`: A, B, C, D and eigenvalues of a model or an FMU at a start, at rest, along a run."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from casadi import SX

from casadi_models.dae import Dae
from cosim.arrays import Truths, Vector
from cosim.codegen.initialization import law_of_knowns
from cosim.errors import InitialConditionError, UnknownName, UsageError
from cosim.fmi.run.linear import fmu_linear
from cosim.integrate.initial_values import algebraic_values
from cosim.integrate.initial_values import start_values as consistent_start
from cosim.integrate.simulate import simulate
from cosim.memo import kept_per_thread
from cosim.model.catalogue import load, no_such_output, observable
from cosim.model.values import Values, assign, listed, number
from cosim.study.linearize.linearization import Linearization

START, EQUILIBRIUM = "start", "equilibrium"
MOST_NEWTON_STEPS = 60  # of Newton's method
AT_REST = 1e-11  # rate in nominal values per second, at which a state is at rest


def linearize(
    model: Dae | str | os.PathLike[str],
    *,
    at: str | float = START,
    start_values: Mapping[str, float] | None = None,
    outputs: Sequence[str] | None = None,
    solver: str | None = None,
    relative_tolerance: float | None = None,
) -> Linearization:
    """Return the linear system near a state: x' = A x + B u, y = C x + D u.

    Args:
        model: A `Dae`, a model's name, or the file of an FMU, whose directional derivatives are
            taken.
        at: "start"; "equilibrium", which Newton's method looks for from the start on, states that
            influence nothing else may go on; or a time, s, of a run.
        start_values: Values by name that replace starts of states, parameters, or inputs.
        outputs: Names of y; all outputs of the model when None.
        solver, relative_tolerance: Of the run that leads to a time; see `simulate`.

    Raises:
        UnknownName: A name does not exist.
        UsageError: An FMU can be linearized at its start only.
        InitialConditionError: The start contradicts the constraints; or there is no equilibrium
            near it.
        CosimError: See `simulate` and `fmu_linear`.

    Example:
        >>> linearize("bar_on_frame/reduced", outputs=["theta"]).A.shape
        (4, 4)
    """
    if isinstance(at, str) and at not in (START, EQUILIBRIUM):
        raise UnknownName.among("linearize", "point", at, (START, EQUILIBRIUM, "a time in s"))
    if not isinstance(at, str):
        at = number("linearize", "at", at)
    if isinstance(model, str) and not model.endswith(".fmu"):
        model = load(model)
    if not isinstance(model, Dae):
        if at != START:
            raise UsageError(
                f"{model}: an FMU is linearized at its start; give start values, or the model"
            )
        return _linear_fmu(model, start_values, outputs)
    dae, values = model, assign(model, start_values)
    names = _output_names(dae, outputs)
    if isinstance(at, float):
        states = [v.name for v in dae.states]
        run = simulate(
            dae,
            start_values=start_values,
            stop_time=at,
            output_interval=abs(at) or 1.0,
            solver=solver,
            relative_tolerance=relative_tolerance,
            outputs=states,
        )
        return _of_dae(dae, names, run.values[-1], values, at, f"{at:g} s of a run")
    x, point = consistent_start(dae, 0.0, values), "its start"
    if at == EQUILIBRIUM:
        x, point = _equilibrium(dae, x, values)
    return _of_dae(dae, names, x, values, 0.0, point)


def cyclic_states(dae: Dae) -> tuple[int, ...]:
    """Return the states on which nothing depends but the rates of such states, in their order."""
    return _without_influence(_influence(dae))


def _influence(dae: Dae) -> Truths:
    """Return which rate depends on which state, directly or through algebraic unknowns."""

    def pattern(rows: SX, by: SX) -> Truths:
        sparsity = ca.jacobian_sparsity(rows, by)
        return np.array(ca.DM.ones(sparsity).full() != 0).reshape(sparsity.shape)

    through = np.outer(pattern(dae.ode, dae.z).any(axis=1), pattern(dae.alg, dae.x).any(axis=0))
    return pattern(dae.ode, dae.x) | through


def _without_influence(depends: Truths) -> tuple[int, ...]:
    """Return the columns on which no row depends but those of such columns."""
    every = range(len(depends))
    kept = list(every)
    while free := [i for i in kept if not depends[np.ix_(kept, [i])].any()]:
        kept = [i for i in kept if i not in free]
    return tuple(i for i in every if i not in kept)


def _linear_fmu(
    path: str | os.PathLike[str],
    start: Mapping[str, float] | None,
    outputs: Sequence[str] | None,
) -> Linearization:
    found = fmu_linear(path, start_values=start, outputs=outputs)
    n, m = len(found.states), len(found.outputs)
    J = found.jacobian
    A, B = J[:n, :n], J[:n, n:]
    return Linearization(
        found.model,
        found.states,
        found.inputs,
        found.outputs,
        A,
        B,
        J[n : n + m, :n],
        J[n : n + m, n:],
        0.0,
        found.x,
        found.u,
        found.y,
        found.rates,
        np.array(found.nominal),
        "the start of an FMU",
        tuple(found.states[i] for i in _without_influence(A != 0)),
    )


def _of_dae(
    dae: Dae, names: tuple[str, ...], x: Vector, values: Values, time: float, point: str
) -> Linearization:
    z = algebraic_values(dae, time, x, values)
    local = _at_point(dae, names, time, x, z, values)
    by_x, by_u = local.jacobian[:, : len(x)], local.jacobian[:, len(x) :]
    n = len(x)
    return Linearization(
        dae.full_name,
        tuple(v.name for v in dae.states),
        tuple(v.name for v in dae.inputs),
        names,
        by_x[:n],
        by_u[:n],
        by_x[n:],
        by_u[n:],
        time,
        x,
        values.u,
        local.outputs,
        local.rates,
        np.array([v.nominal for v in dae.states]),
        point,
        tuple(dae.states[i].name for i in cyclic_states(dae)),
    )


@dataclass(frozen=True)
class _Local:
    """Rates and outputs at a state, and their derivatives by states and inputs without z."""

    rates: Vector
    outputs: Vector
    jacobian: Vector


def _at_point(
    dae: Dae, names: tuple[str, ...], time: float, x: Vector, z: Vector, values: Values
) -> _Local:
    function = _jacobians(dae, names)
    rates, outputs, by_xu, by_z, alg_xu, alg_z = (
        np.array(block) for block in function.call([time, x, z, values.u, values.p])
    )
    if len(z):
        by_xu = by_xu - by_z @ np.linalg.solve(alg_z, alg_xu)
    return _Local(rates.ravel(), outputs.ravel(), by_xu)


@kept_per_thread(8)
def _jacobians(dae: Dae, names: tuple[str, ...]) -> ca.Function:
    """Return rates, outputs, and the partial derivatives of both and of the residual."""
    dae = dae.watching(names)
    expressions = dict(
        zip(
            (v.name for v in (*dae.states, *dae.algebraics, *dae.output_variables)),
            ca.vertsplit(ca.vertcat(dae.x, dae.z, dae.outputs)),
            strict=True,
        )
    )
    chosen = ca.densify(ca.vertcat(SX(0, 1), *(expressions[name] for name in names)))
    xu = ca.vertcat(dae.x, dae.u)
    both = ca.vertcat(dae.ode, chosen)
    blocks = [ca.jacobian(rows, by) for rows in (both, dae.alg) for by in (xu, dae.z)]
    return ca.Function(
        "jacobians",
        dae.arguments,
        [dae.ode, chosen, *map(ca.densify, blocks)],
        {"cse": True},
    )


def _equilibrium(dae: Dae, x: Vector, values: Values) -> tuple[Vector, str]:
    """Return the state at rest that Newton's method reaches, and how.

    Of states that depend on each other the smallest move is taken. What the equations keep at zero
    stays there. Cyclic states keep their value, and their rates are left alone.

    Raises:
        InitialConditionError: There is none near.
    """
    cyclic, driven = cyclic_states(dae), [bool(row.any()) for row in _influence(dae)]
    free = [i for i in range(len(x)) if i not in cyclic]
    # A rate that depends on no state is given: so is that state, e.g. a prescribed speed, unless
    # there is no rest with it
    try:
        return _rest(dae, x, values, free, [i for i in free if driven[i]])
    except InitialConditionError:
        return _rest(dae, x, values, free, free)


def _rest(
    dae: Dae, x: Vector, values: Values, resting: list[int], kept: list[int]
) -> tuple[Vector, str]:
    """Return where some states are at rest, some of them being moved, and how that was found."""
    sizes = np.array([v.nominal for v in dae.states])
    nominal = sizes[kept]
    residual = ca.vertcat(SX(0, 1), *(invariant.residual for invariant in dae.invariants))
    law = law_of_knowns(dae, "law", residual, ca.jacobian(residual, dae.x))

    def defect(x: Vector) -> tuple[Vector, Vector]:
        z = algebraic_values(dae, 0.0, x, values)
        local = _at_point(dae, (), 0.0, x, z, values)
        left, slope = (np.array(block) for block in law(0.0, x, values.u, values.p))
        rows = np.concatenate(((local.rates / sizes)[resting], left.ravel()))
        by_x = (local.jacobian[: len(x)] / sizes[:, None])[np.ix_(resting, kept)]
        return rows, np.vstack((by_x, slope[:, kept])) * nominal

    start, (rows, slope) = x, defect(x)
    for step in range(MOST_NEWTON_STEPS):
        if np.abs(rows).max(initial=0.0) <= AT_REST:
            moved = np.abs(x - start)[kept] / nominal
            if not moved.size or moved.max() == 0:
                return x, "its start, an equilibrium"
            most = kept[int(moved.argmax())]
            name, unit = dae.states[most].name, dae.states[most].unit
            return x, (
                f"an equilibrium, {step} steps of Newton's method from the start "
                f"({name} = {x[most]:.6g} {unit} instead of {start[most]:.6g})"
            )
        change = -np.linalg.lstsq(slope, rows, rcond=1e-12)[0] * nominal
        for _ in range(30):
            trial = x.copy()
            trial[kept] += change
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
        f"{dae.full_name}: no equilibrium is near the start: {what} cannot come to rest (rate "
        f"{rows[worst]:.3g} nominal values per second where Newton's method stops); start nearer "
        "to one, or set what drives the model"
    )


def _output_names(dae: Dae, outputs: Sequence[str] | None) -> tuple[str, ...]:
    if outputs is None:
        return tuple(v.name for v in dae.output_variables)
    names = listed(f"{dae.full_name}: outputs", outputs)
    for name in names:
        if name not in observable(dae):
            raise no_such_output(dae, name)
    return tuple(names)
