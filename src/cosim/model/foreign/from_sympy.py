"""`from_sympy`: import of equations of motion that `sympy.physics.mechanics` has formed."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from functools import reduce
from typing import Any

import casadi as ca
from casadi import SX

from casadi_models.dae import Dae, Model
from casadi_models.mechanics import matrices
from cosim.errors import UnknownName, UsageError
from cosim.host.optional_packages import optional_module
from cosim.model.foreign.casadi_system import System
from cosim.model.foreign.from_casadi import Facts, declare_system
from cosim.model.foreign.named_symbols import Symbol, identifier

_NAMES = "sin cos tan asin acos atan atan2 sinh cosh tanh asinh acosh atanh exp log sign"
_FUNCTIONS = {name: name for name in _NAMES.split()} | {"Abs": "fabs", "Min": "fmin", "Max": "fmax"}
_LAWS = "kinematics", "rates", "mass", "forcing", "closure", "slip", "auxiliary"
_LISTS = "q", "u", "multipliers", "dependent", "guessed", "zero", "forces"


class _CasadiPrinter:
    """Methods of a SymPy printer that returns SX instead of text."""

    who: str
    values: dict[Any, SX]  # of symbols
    _print: Callable[[Any], SX]

    def _print_Symbol(self, node: Any) -> SX:
        return self.values[node]

    def _print_Number(self, node: Any) -> SX:
        return SX(float(node))

    _print_NumberSymbol = _print_Number  # pi

    def _print_Add(self, node: Any) -> SX:
        factors = [term.args if term.is_Mul else (term,) for term in node.args]
        counts = Counter(f for own in factors for f in own if not f.is_Number)
        common, times = max(counts.items(), key=lambda item: item[1], default=(0, 1))
        if times == 1:
            return reduce(SX.__add__, map(self._print, node.args))
        inside = [x / common for x, own in zip(node.args, factors, strict=True) if common in own]
        outside = [x for x, own in zip(node.args, factors, strict=True) if common not in own]
        rest = self._print(node.func(*outside))
        return self._print(common) * self._print(node.func(*inside)) + rest

    def _print_Mul(self, node: Any) -> SX:
        return reduce(SX.__mul__, map(self._print, node.args))

    def _print_Pow(self, node: Any) -> SX:
        base, exponent = self._print(node.base), node.exp
        if exponent.is_Rational and exponent.q == 2:
            base, exponent = ca.sqrt(base), 2 * exponent
        return base ** self._print(exponent)

    def _print_Application(self, node: Any) -> SX:
        if type(node).__name__ not in _FUNCTIONS:
            return self.emptyPrinter(node)
        function = getattr(ca, _FUNCTIONS[type(node).__name__])
        arguments = [*map(self._print, node.args)]
        return reduce(function, arguments) if len(arguments) > 1 else function(*arguments)

    def emptyPrinter(self, node: Any) -> SX:
        name = type(node).__name__
        raise UsageError(f"{self.who}: SymPy's {name} has no CasADi form here; replace it")


def _printed(who: str, laws: Mapping[str, Any], values: Mapping[Any, SX]) -> dict[str, SX]:
    """Return matrices of SymPy as SX; common subexpressions are computed once."""
    sympy = optional_module("sympy", "sympy")
    printer: Any = type("Printer", (_CasadiPrinter, sympy.printing.printer.Printer), {})()
    plain = {leaf: sympy.Dummy() for leaf in values}  # cse would look into q(t)
    printer.who, printer.values = who, {plain[leaf]: value for leaf, value in values.items()}
    rows = [matrix.xreplace(plain) for matrix in laws.values()]
    common, rows = sympy.cse(rows, sympy.numbered_symbols(cls=sympy.Dummy), order="none")
    for symbol, expression in common:
        printer.values[symbol] = printer._print(expression)
    columns = [ca.vertcat(SX(0, 1), *map(printer._print, matrix)) for matrix in rows]
    shapes = [(max(matrix.cols, 1), matrix.rows) for matrix in rows]
    shaped = [ca.reshape(*both).T for both in zip(columns, shapes, strict=True)]
    return dict(zip(laws, shaped, strict=True))


def _formed(who: str, method: Any) -> tuple[dict[str, list[Any]], dict[str, Any]]:
    """Return what a method formed: lists of symbols, and the laws of `matrices` in SymPy."""
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
        lists = method.q, method.u, method.lam_vec, none, none, none, none
    else:
        slip = method._k_nh * method.u + method._f_nh if method._udep else none
        auxiliary = method.auxiliary_eqs if method._uaux else none
        found = method.mass_matrix_kin, method.forcing_kin, *motion, method._f_h, slip, auxiliary
        zero = [*method._uaux, *method._uaux.diff(mechanics.dynamicsymbols._t)]
        lists = method.q, method.u, none, method._udep, method._qdep, zero, none
    columns = {key: list(column) for key, column in zip(_LISTS, lists, strict=True)}
    return columns, dict(zip(_LAWS, found, strict=True))


def _label(key: Any) -> str:
    """Return the name of a variable: q of q(t), q_dot of its derivative; a text is a name."""
    order = getattr(key, "derivative_count", 0)
    return identifier(getattr(key.args[0] if order else key, "name", str(key))) + order * "_dot"


def _by_name(who: str, given: Any) -> dict[str, Any]:
    if not isinstance(given, Mapping | None):
        raise UsageError.of_type(who, given, "a dict by symbol or name")
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
    lists, laws = _formed(who, system)
    mappings = (parameters, start_values, units, meanings, nominals, outputs)
    given, starts, *facts, shown = (_by_name(who, mapping) for mapping in mappings)
    values = given | starts
    t = optional_module("sympy.physics.mechanics", "sympy").dynamicsymbols._t
    q, u, dependent, forces = (lists[key] for key in ("q", "u", "dependent", "forces"))
    for x in dependent:
        if _label(x) in values:
            raise UsageError(f"{who}: speed {x} depends on the others; give it no start value")
    lists["rates"] = [x.diff(t) for x in q]
    lists["unknown"] = [*(x.diff(t) for x in u), *lists["multipliers"]]
    own = {t}.union(*lists.values())
    acting = _others(who, [law for key, law in laws.items() if key != "auxiliary"], own, t)
    loads = _others(who, [laws["auxiliary"]], {*own, *acting}, t)
    forces += [x for x in loads if _label(x) not in values]
    sympy = optional_module("sympy", "sympy")
    for output in shown.values():
        if not isinstance(output, sympy.Expr):
            raise UsageError.of_type(f"{who}: outputs", output, "scalar expressions of SymPy")
    laws["outputs"] = sympy.Matrix([*shown.values()])
    others = _others(who, laws.values(), {*own, *forces}, t)
    functions = {f: order for f, order in others.items() if not f.is_Symbol}
    chain = [f.diff(t, k) for f, order in functions.items() for k in range(order)]
    speeds = [x for x in u if x not in dependent]
    kinds = {
        "t": [t],
        "x": [*q, *speeds, *chain],
        "z": lists["unknown"] if lists["multipliers"] else [],
        "u": [f.diff(t, order) for f, order in functions.items()],
        "p": [x for x in others if x.is_Symbol],
    }
    symbols = {x: SX.sym(_label(x)) for some in (*lists.values(), *kinds.values()) for x in some}
    of = {key: ca.vertcat(SX(0, 1), *(symbols[x] for x in xs)) for key, xs in lists.items()}
    named = {k: tuple(Symbol(_label(x), (1, 1), symbols[x]) for x in kinds[k]) for k in kinds}
    for key in given:
        if key not in (known := [symbol.name for some in named.values() for symbol in some]):
            raise UnknownName.among(who, "parameter", key, known)
    found = _printed(who, laws, symbols | dict.fromkeys(lists["zero"], SX(0)))
    try:
        found = matrices.solved(found, of)
        found["ode"] = ca.vertcat(found["ode"], *(symbols[x.diff(t)] for x in chain))
        names = [*map(_label, [*dependent, *forces]), *shown]
        rows = ca.vertsplit(ca.vertcat(found.pop("more"), found.pop("outputs")))
        whole = System(named, found, dict(zip(names, rows, strict=True)))
        times: dict[str, Any] = {"stop_time": stop_time, "output_interval": output_interval}
        model = Model(name, description=f"{name}, from SymPy", source="sympy", **times)
        x, found = declare_system(whole, Facts(who, values, *facts), model)
        n, guessed = len(q), [q.index(x) for x in lists["guessed"]]
        matrices.constrain(model, x[:n, :], x[n : n + len(speeds), :], found, guessed, values)
        return model.freeze()
    except ValueError as error:
        raise UsageError(f"from_sympy: {error}") from error
