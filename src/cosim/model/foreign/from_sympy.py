"""`from_sympy`: import of equations of motion that `sympy.physics.mechanics` has formed."""

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import casadi as ca
from casadi import SX

from casadi_models.dae import Dae, Model
from casadi_models.dae.expressions import is_cheaper
from casadi_models.mechanics import kane, matrices
from cosim.errors import UnknownName, UsageError
from cosim.host.optional_packages import optional_module
from cosim.model.foreign.casadi_system import System
from cosim.model.foreign.from_casadi import Facts, declare_system
from cosim.model.foreign.named_symbols import Symbol, identifier
from cosim.model.foreign.sympy_bodies import inertias_and_loads
from cosim.model.foreign.sympy_printer import printed

_LAWS = "kinematics", "rates", "mass", "forcing", "closure", "slip", "auxiliary"
_DYNAMICS = {"mass", "forcing", "auxiliary"}
_LISTS = "q", "u", "multipliers", "dependent", "guessed", "held", "held_dot", "forces"


def _formed(who: str, method: Any) -> tuple[Any, dict[str, list[Any]], dict[str, Any]]:
    """Return a method, its lists of symbols, and the laws of `matrices` that it formed in SymPy."""
    sympy = optional_module("sympy", "sympy")
    mechanics = optional_module("sympy.physics.mechanics", "sympy")
    call = "kanes_equations or form_lagranges_equations"
    if isinstance(method, mechanics.System):
        method, call = method.eom_method, "form_eoms"
    elif not isinstance(method, mechanics.KanesMethod | mechanics.LagrangesMethod):
        raise UsageError.of_type(who, method, "a KanesMethod, a LagrangesMethod or a System")
    try:
        motion, n, none = (method.mass_matrix, method.forcing), len(method.q), sympy.Matrix()
    except (AttributeError, ValueError):
        raise UsageError(f"{who}: the equations are not formed; call {call}() first") from None
    if isinstance(method, mechanics.LagrangesMethod):
        mass = method.mass_matrix_full[n:, n:]  # its multipliers have the other sign than `eom`
        motion = mass[:, :n].row_join(-mass[:, n:]), method.forcing_full[n:, :]
        found = sympy.eye(n), method.u, *motion, method._hol_coneqs, method.coneqs, none
        lists = method.q, method.u, method.lam_vec, *5 * (none,)
    else:
        slip = method._k_nh * method.u + method._f_nh if method._udep else none
        auxiliary = method.auxiliary_eqs if method._uaux else none
        found = method.mass_matrix_kin, method.forcing_kin, *motion, method._f_h, slip, auxiliary
        held = method._uaux, method._uaux.diff(mechanics.dynamicsymbols._t)
        lists = method.q, method.u, none, method._udep, method._qdep, *held, none
    columns = {key: list(column) for key, column in zip(_LISTS, lists, strict=True)}
    return method, columns, dict(zip(_LAWS, found, strict=True))


def _label(key: Any) -> str:
    """Return the name of a variable: q of q(t), q_dot of its derivative; a text is a name."""
    order = getattr(key, "derivative_count", 0)
    return identifier(getattr(key.args[0] if order else key, "name", str(key))) + order * "_dot"


def _by_name(who: str, given: Any) -> dict[str, Any]:
    UsageError.reject(who, given, Mapping | None, "a dict by symbol or name")
    return {_label(key): value for key, value in (given or {}).items()}


def _others(who: str, laws: Iterable[Any], own: set[Any], t: Any) -> dict[Any, int]:
    """Return other symbols and functions of time, each with the order of its highest derivative."""
    core, found = optional_module("sympy.core.function", "sympy"), dict[Any, int]()
    kinds = core.AppliedUndef, core.Derivative
    leaves = set[Any]().union(*(m.free_symbols | m.atoms(*kinds) for m in laws))
    for leaf in sorted(leaves - own, key=_label):
        order = getattr(leaf, "derivative_count", 0)
        base = leaf.args[0] if order else leaf
        if base in own or not (base.is_Symbol or base.args == (t,)):
            raise UsageError(f"{who}: {leaf} is unknown to the method; replace it in the equations")
        found[base] = max(order, found.get(base, 0))
    return found


def _from_bodies(
    who: str,
    method: Any,
    laws: Mapping[str, Any],
    of: Mapping[str, SX],
    symbols: Mapping[Any, SX],
    moves: Mapping[Any, SX],
) -> dict[str, SX]:
    """Return the equations of a `KanesMethod` formed anew; `moves` are rates of others than q."""
    # printed apart: what the dynamics share with these laws would be written out for them
    found = printed(who, {key: law for key, law in laws.items() if key not in _DYNAMICS}, symbols)
    rates = ca.solve(found["kinematics"], found["rates"])
    known = dict(zip((x.diff() for x in method.q), ca.vertsplit(rates), strict=True))
    q = ca.vertcat(of["q"], *(symbols[x] for x in moves))
    inertias, loads = inertias_and_loads(who, method, {**symbols, **known}, q)
    u, dependent = of["u"], of["dependent"]
    system = kane.System(
        q=q,
        q_dot=ca.vertcat(rates, *moves.values()),
        free=u[: u.numel() - dependent.numel(), :],
        dependent=dependent,
        held=of["held"],
        constraints=found["slip"],
        inertias=inertias,
        loads=loads,
    )
    return matrices.solved(found, of, system)


def from_sympy(
    system: Any,
    parameters: Mapping[Any, Any] | None = None,
    start_values: Mapping[Any, Any] | None = None,
    outputs: Mapping[str, Any] | None = None,
    *,
    name: str = "model",
    units: Mapping[Any, str] | None = None,
    meanings: Mapping[Any, str] | None = None,
    nominals: Mapping[Any, float] | None = None,
    stop_time: float = 10.0,
    output_interval: float = 0.01,
) -> Dae:
    """Return the DAE of equations of motion that `sympy.physics.mechanics` has formed.

    Coordinates and speeds are states. Kane's dependent speeds are eliminated and become outputs.
    Lagrange's multipliers and, with them, the accelerations are algebraic unknowns. Other functions
    of time are inputs; where the equations contain derivatives of one, the highest is the input and
    the lower ones are states. Forces that occur in `auxiliary_eqs` only are outputs.

    Args:
        system: A `KanesMethod`, a `LagrangesMethod` or a `System` whose equations are formed.
        parameters: Values of all other symbols. Mappings take symbols or names: `q` for `q(t)`,
            `q_dot` for its derivative.
        start_values: Numbers, 0 by default; initial guesses of Kane's dependent coordinates.
            Constraints with multipliers determine states without a start value first, then the last
            ones, whose start values are initial guesses.
        outputs: Scalar expressions by name.
        name, units, meanings, nominals, stop_time, output_interval: See `from_casadi`.

    Raises:
        UsageError: The equations are not formed, or contain something without CasADi form.
        ParameterError: A parameter has no value, or a value is not a number.
        UnknownName: A value is given for what does not exist.
    """
    who = f"from_sympy({name})"
    method, lists, laws = _formed(who, system)
    mappings = (parameters, start_values, units, meanings, nominals, outputs)
    given, starts, *facts, shown = (_by_name(who, mapping) for mapping in mappings)
    values = given | starts
    laws["outputs"] = _column_of(who, shown)
    roles = _roles(who, lists, laws, values)
    symbols = {
        x: SX.sym(_label(x)) for xs in (*roles.lists.values(), *roles.kinds.values()) for x in xs
    }
    named = {
        kind: tuple(Symbol(_label(x), (1, 1), symbols[x]) for x in xs)
        for kind, xs in roles.kinds.items()
    }
    known = [symbol.name for some in named.values() for symbol in some]
    UnknownName.reject(who, "parameter", known, *given)
    try:
        found = _solved(who, method, laws, roles, symbols)
        names = [*map(_label, [*roles.lists["dependent"], *roles.lists["forces"]]), *shown]
        rows = ca.vertsplit(ca.vertcat(found.pop("more"), found.pop("outputs")))
        whole = System(named, found, dict(zip(names, rows, strict=True)))
        times: dict[str, Any] = {"stop_time": stop_time, "output_interval": output_interval}
        model = Model(name, description=f"{name}, from SymPy", source="sympy", **times)
        x, found = declare_system(whole, Facts(who, values, *facts), model)
        q = roles.lists["q"]
        positions, speeds = x[: len(q), :], x[len(q) : len(q) + len(roles.speeds), :]
        guessed = [q.index(position) for position in roles.lists["guessed"]]
        matrices.constrain(model, positions, speeds, found, guessed, values)
        return model.freeze()
    except ValueError as error:
        raise UsageError(f"from_sympy: {error}") from error


def _column_of(who: str, outputs: Mapping[str, Any]) -> Any:
    """Return the expressions of outputs as a column of SymPy."""
    sympy = optional_module("sympy", "sympy")
    for output in outputs.values():
        UsageError.reject(f"{who}: outputs", output, sympy.Expr, "scalar expressions of SymPy")
    return sympy.Matrix([*outputs.values()])


@dataclass(frozen=True)
class _Roles:
    """SymPy's symbols by their roles.

    Attributes:
        t: The time.
        lists: The symbols of the method by the names of `_LISTS`, its "rates" dq/dt, and its
            "unknown" accelerations and multipliers.
        speeds: The independent speeds.
        chain: Inputs and their derivatives that are states, as a higher derivative occurs.
        kinds: The symbols of the DAE: t, x, z, u, p.
    """

    t: Any
    lists: Mapping[str, list[Any]]
    speeds: list[Any]
    chain: list[Any]
    kinds: Mapping[str, list[Any]]


def _roles(
    who: str, lists: Mapping[str, list[Any]], laws: Mapping[str, Any], values: Mapping[str, Any]
) -> _Roles:
    """Return the roles of all symbols in the laws, of which some have values."""
    t = optional_module("sympy.physics.mechanics", "sympy").dynamicsymbols._t
    q, u, dependent = lists["q"], lists["u"], lists["dependent"]
    for x in dependent:
        if _label(x) in values:
            raise UsageError(f"{who}: speed {x} depends on the others; give it no start value")
    rates = [x.diff(t) for x in q]
    unknown = [*(x.diff(t) for x in u), *lists["multipliers"]]
    own = {t, *rates, *unknown}.union(*lists.values())
    moving = [law for key, law in laws.items() if key not in ("auxiliary", "outputs")]
    acting = _others(who, moving, own, t)
    loads = _others(who, [laws["auxiliary"]], own, t)
    forces = [x for x in loads if x not in acting and _label(x) not in values]
    others = _others(who, laws.values(), {*own, *forces}, t)
    functions = {f: order for f, order in others.items() if not f.is_Symbol}
    chain = [f.diff(t, k) for f, order in functions.items() for k in range(order)]
    speeds = [x for x in u if x not in dependent]
    kinds = {
        "t": [t],
        "x": [*q, *speeds, *chain],
        "z": unknown if lists["multipliers"] else [],
        "u": [f.diff(t, order) for f, order in functions.items()],
        "p": [x for x in others if x.is_Symbol],
    }
    lists = {**lists, "forces": forces, "rates": rates, "unknown": unknown}
    return _Roles(t, lists, speeds, chain, kinds)


def _solved(
    who: str, method: Any, laws: Mapping[str, Any], roles: _Roles, symbols: Mapping[Any, SX]
) -> dict[str, SX]:
    """Return the equations in CasADi: those of SymPy or, if they are cheaper, of the bodies."""
    lists = roles.lists
    of = {key: ca.vertcat(SX(0, 1), *(symbols[x] for x in xs)) for key, xs in lists.items()}
    printable = {**symbols, **dict.fromkeys(lists["held_dot"], SX(0))}
    found = matrices.solved(printed(who, laws, printable), of)
    mechanics = optional_module("sympy.physics.mechanics", "sympy")
    if isinstance(method, mechanics.KanesMethod):
        moves = {x: symbols[x.diff(roles.t)] for x in roles.chain} | {roles.t: SX(1)}
        with suppress(ValueError, UsageError):  # SymPy's equations need less than the bodies
            anew = _from_bodies(who, method, laws, of, printable, moves)
            columns = [ca.vertcat(form["ode"], form["more"]) for form in (anew, found)]
            found = anew if is_cheaper(*columns) else found
    found["ode"] = ca.vertcat(found["ode"], *(symbols[x.diff(roles.t)] for x in roles.chain))
    return found
