"""Equations of motion that are given as matrices: elimination, multipliers, drift, monitors.

    N q' = r,    M (u', multipliers) = f,    closure(q) = 0,    slip(q, u) = 0

Laws are columns and matrices by name: `kinematics` N, `rates` r, `mass` M, `forcing` f, `closure`,
`slip`, and residuals `auxiliary`, which are linear in forces that do no work. Where speeds depend
on others, and with multipliers, the last rows of M and f are d(slip)/dt = 0. Without multipliers, a
`kane.System` may stand for M, f and `auxiliary`.

Source  Kane & Levinson, Dynamics, 1985; Baumgarte, Comput. Methods Appl. Mech. Eng. 1, 1972.
"""

from collections.abc import Collection, Mapping, Sequence

import casadi as ca
from casadi import DM, SX

from casadi_models.dae import Model
from casadi_models.mechanics import conditions, kane
from casadi_models.mechanics.mechanism import CLOSING_RATE
from casadi_models.mechanics.slopes import determined, in_sizes_of_units

CLOSED, ROLLING = "the configuration constraints hold", "the velocity constraints hold"


def solved(
    laws: Mapping[str, SX], of: Mapping[str, SX], system: kane.System | None = None
) -> dict[str, SX]:
    """Return the laws with `ode` of q and the independent speeds, and what belongs to it.

    With multipliers, `residual` determines the unknowns. Without, everything is a function of q and
    the independent speeds, and `more` are the dependent speeds and the forces that do no work.

    Args:
        laws: See the module; others may use the same symbols.
        of: Symbols, columns: `q`, `u` (the last ones `dependent`), `rates` (q'), `unknown` (u',
            `multipliers`), `forces`, and the auxiliary speeds `held` at zero.
        system: In the same symbols; its constrained speeds are `held`.

    Raises:
        ValueError: There are more auxiliary equations or fewer than forces.
    """
    if of["multipliers"].numel():
        return _with_multipliers(laws, of)
    return _eliminated(laws, of) if system is None else _projected(laws, of, system)


def _with_multipliers(laws: Mapping[str, SX], of: Mapping[str, SX]) -> dict[str, SX]:
    return dict(laws) | {
        "ode": ca.vertcat(laws["rates"], of["unknown"][: of["u"].numel(), :]),
        "residual": laws["mass"] @ of["unknown"] - laws["forcing"],
        "more": SX(0, 1),
    }


def _eliminated(laws: Mapping[str, SX], of: Mapping[str, SX]) -> dict[str, SX]:
    n = of["u"].numel() - of["dependent"].numel()
    mass, forcing = laws["mass"], laws["forcing"]
    relation = -ca.solve(mass[n:, n:], mass[n:, :n])
    offset = ca.solve(mass[n:, n:], forcing[n:, :])
    reduced = ca.triu2symm(ca.triu(mass[:n, :n] + mass[:n, n:] @ relation))
    free = ca.ldl_solve(forcing[:n, :] - mass[:n, n:] @ offset, *ca.ldl(reduced))
    solution = kane.Accelerations(free, relation @ free + offset, relation, reduced)
    return _in_states(laws, of, solution, laws["auxiliary"])


def _projected(laws: Mapping[str, SX], of: Mapping[str, SX], system: kane.System) -> dict[str, SX]:
    solution, residual = kane.accelerations(system), SX(0, 1)
    if system.held.numel():
        multipliers = kane.constraint_loads(system, solution.unknown)
        residual = kane.reactions(system, solution.unknown, multipliers)
    return _in_states(laws, of, solution, residual)


def _in_states(
    laws: Mapping[str, SX], of: Mapping[str, SX], solution: kane.Accelerations, auxiliary: SX
) -> dict[str, SX]:
    """Eliminate all that depends on q and the independent speeds."""
    dependent, held, forces = of["dependent"], of["held"], of["forces"]
    free = of["u"][: solution.free.numel(), :]
    rates = ca.solve(laws["kinematics"], laws["rates"])
    at_rest = _root(ca.substitute(laws["slip"], free, SX.zeros(free.numel())), dependent)
    found = dict(laws) | {
        "ode": ca.vertcat(rates, solution.free),
        "mass": solution.mass,
        "slope": ca.jacobian(laws["slip"], dependent),
        "more": ca.vertcat(dependent, forces),
    }
    for symbols, values in (
        (forces, _root(auxiliary, forces)),
        (ca.vertcat(of["rates"], of["unknown"]), ca.vertcat(rates, solution.unknown)),
        (dependent, solution.relation @ free + at_rest),
        (held, SX.zeros(held.numel())),
    ):
        rows = ca.substitute([*found.values()], [symbols], [values])
        found = dict(zip(found, rows, strict=True))
    return found


def _root(residual: SX, unknown: SX) -> SX:
    """Return the unknowns, (n, 1), that make residuals zero which are linear in them."""
    if residual.numel() != unknown.numel():
        names = ", ".join(symbol.name() for symbol in ca.vertsplit(unknown)) or "none"
        raise ValueError(f"{residual.numel()} auxiliary equations do not determine {names}")
    at_zero = ca.substitute(residual, unknown, SX.zeros(unknown.numel()))
    return -ca.solve(ca.jacobian(residual, unknown), at_zero)


def constrain(
    model: Model,
    q: SX,
    u: SX,
    laws: Mapping[str, SX],
    guessed: Sequence[int] = (),
    given: Collection[str] = (),
) -> None:
    """Declare starts that satisfy the constraints, drift control and monitors.

    Args:
        model: Has q, u and `ode`; with multipliers, the unknowns.
        q, u: Its coordinates and independent speeds.
        laws: From `solved`, in the model's symbols.
        guessed: Coordinates that `closure` determines at the start, without multipliers.
        given: Names of states that the constraints determine last, with multipliers.

    Raises:
        ValueError: A constraint repeats others.
    """
    n, closure, slip = u.numel(), laws["closure"], laws["slip"]
    mass = laws["mass"][:n, :n]
    conditions.watch_masses(model, mass)
    if closure.numel():
        model.invariant("position_drift", q, closure, CLOSED)
    if guessed:
        model.start_equation(q[list(guessed)], closure, CLOSED)
    if "residual" not in laws:
        if slip.numel():
            conditions.watch_elimination(model, laws["slope"])
        return
    gaps = ca.vertcat(closure, SX.zeros(slip.numel() - closure.numel()))
    rate = model.closing_rate(CLOSING_RATE)
    model.equation(laws["residual"] + ca.vertcat(SX.zeros(n), 2 * rate * slip + rate**2 * gaps))
    sizes = conditions.equal_energies(mass)
    model.invariant("velocity_drift", u, slip, ROLLING, sizes=sizes)
    place = DM([variable.start or 0.0 for variable in model.declared(q)])

    def at_start(expression: SX) -> DM:
        return ca.Function("start", [q], [model.numbers(expression, but=q)])(place)

    conditions.watch_constraints(model, ca.jacobian(slip, u), mass, at_start)
    for states, law, meaning in ((q, closure, CLOSED), (u, slip, ROLLING)):
        without = [variable.name not in given for variable in model.declared(states)]
        order = sorted(range(n), key=without.__getitem__)
        slopes = at_start(ca.jacobian(law, states))
        slopes = in_sizes_of_units(slopes, [variable.unit for variable in model.declared(states)])
        found, left = determined(slopes[:, order])
        if left:
            raise ValueError(f"constraint {left[0] + 1} repeats others at the start; leave it out")
        if found:
            model.start_equation(states[[order[i] for i in found]], law, meaning)
