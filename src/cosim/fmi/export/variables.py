"""Variables of an FMU: roles, start values, bounds, structured names."""

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from math import inf, isfinite
from typing import Any

import casadi as ca
import numpy as np

from casadi_models.dae import Dae, Start, Variable
from casadi_models.dae.expressions import at_irregular_place
from casadi_models.dae.hybrid import hybrid
from casadi_models.units import UNITS, Unit, quotient_name
from cosim.codegen.functions import equations
from cosim.codegen.initialization import start_function
from cosim.errors import UsageError
from cosim.memo import cached_per_thread
from cosim.model.values import own_sizes

VALID = "valid"


class Role(Enum):
    """The role of a variable in the FMU; the names are those of the C runtime."""

    TIME = "independent"
    STATE = "state"
    DERIVATIVE = "derivative"
    ALGEBRAIC = "algebraic"
    INPUT = "input"
    MODE = "mode"
    PARAMETER = "parameter"
    OUTPUT = "output"
    VALIDITY = "validity"  # Boolean; it has no row in the runtime's table


@dataclass(frozen=True)
class FmuVariable:
    """A variable of the FMU; its value reference is its position in the list.

    Attributes:
        name, meaning, unit, display_unit, start, start_kind, nominal, minimum, maximum: See
            `casadi_models.Variable`.
        role: Role of the variable.
        observed: Whether the variable is an output of the FMU, which importers record.
        derivative_of: Value reference of the state, for a derivative.
        tunable: Whether an importer may change a parameter during a run.
        rests_at_zero: Whether a state stays 0 where it is 0.
        guess: Initial guess of a calculated start value; `start` is then the solution, or None if
            there is none.
        alias: Flat name of a variable whose name is structured.
    """

    name: str
    meaning: str
    unit: str
    role: Role
    display_unit: str | None = None
    start: float | None = None
    start_kind: Start = Start.CALCULATED
    nominal: float = 1.0
    minimum: float = -inf
    maximum: float = inf
    observed: bool = False
    derivative_of: int | None = None
    tunable: bool = False
    rests_at_zero: bool = False
    guess: float | None = None
    alias: str | None = None


def fmu_variables(
    dae: Dae, tunable: Collection[str] = (), *, valid: bool = False, modes: int = 0
) -> tuple[FmuVariable, ...]:
    """Return time, states, derivatives, algebraics, inputs, parameters, outputs, in this order.

    The last inputs may be modes of relations, which only events change.
    """
    return tuple(_variables(dae, tunable, valid, modes))


def _variables(
    dae: Dae, tunable: Collection[str], valid: bool, modes: int
) -> Iterator[FmuVariable]:
    observed = frozenset(dae.observed)
    yield FmuVariable("time", "simulation time", "s", Role.TIME)
    sizes = own_sizes(dae, np.array(dae.x_start)).tolist()
    for state, guess, start, size, rests in zip(
        dae.states, dae.x_start, _settled(dae), sizes, _resting(dae), strict=True
    ):
        calculated = state.start_kind is Start.CALCULATED
        starts = {"start": start, "guess": guess} if calculated else {"start": guess}
        yield _fmu_variable(
            state, Role.STATE, observed, nominal=size, rests_at_zero=rests, **starts
        )
    for i, state in enumerate(dae.states):  # deg/s where the state is shown in deg
        shown = rate_unit(state.display_unit)[0] if state.display_unit else None
        yield FmuVariable(
            f"der({state.name})",
            f"time derivative of {state.name}",
            rate_unit(state.unit)[0],
            Role.DERIVATIVE,
            shown if shown in UNITS else None,
            derivative_of=1 + i,
        )
    for algebraic in dae.algebraics:
        yield _fmu_variable(algebraic, Role.ALGEBRAIC, observed)
    inputs = len(dae.inputs) - modes
    for quantity in dae.inputs[:inputs]:
        yield _fmu_variable(quantity, Role.INPUT)
    for mode in dae.inputs[inputs:]:
        yield _fmu_variable(mode, Role.MODE, start_kind=Start.CALCULATED)
    for parameter in dae.parameters:
        yield _fmu_variable(parameter, Role.PARAMETER, tunable=parameter.name in tunable)
    for output in dae.output_variables:
        yield _fmu_variable(output, Role.OUTPUT, observed, start=None)
    if valid:
        meaning = "whether every limit of the model holds"
        yield FmuVariable(VALID, meaning, "", Role.VALIDITY, observed=True)


def _resting(dae: Dae) -> list[bool]:
    """Return whether each state stays 0 where it is 0, as its derivative at two places tells.

    Branches may take another way at other places: models with relations have no such states.
    """
    if hybrid(dae) is not None:
        return [False] * len(dae.states)
    symbols = ca.vertcat(dae.x, *dae.arguments[:1], *dae.arguments[2:])
    places = np.array(at_irregular_place(ca.horzcat(symbols, symbols**2), symbols))
    sizes = [a.numel() for a in (dae.x, dae.t, dae.z, dae.u)]
    x, t, z, u, p = np.split(places, np.cumsum(sizes))
    laws = equations(dae)
    moves = (np.array(laws(t, x, z, u, p)[0]) != 0).all(axis=1)

    def rests(i: int) -> bool:
        at_zero = x.copy()
        at_zero[i] = 0
        if not moves[i] or np.array(laws(t, at_zero, z, u, p)[0][i, :] != 0).any():
            return False
        # what is 0 at two places may be a table or a pulse that is not 0 at others
        return bool(ca.substitute(dae.ode[i], dae.x[i], 0).is_zero())

    return [rests(i) for i in range(len(dae.states))]


def _settled(dae: Dae) -> list[float | None]:
    """Return the start values after initialization, to 15 digits; None where it fails.

    Rounding does not lead out of bounds.
    """
    u, p = ([float(v.start or 0.0) for v in group] for group in (dae.inputs, dae.parameters))
    x, _ = start_function(dae)(0.0, list(dae.x_start), u, p)
    found = list[float | None]()
    for state, value in zip(dae.states, x.full().ravel().tolist(), strict=True):
        shown = float(f"{value:.15g}") if abs(value) > 1e-14 * state.nominal else 0.0
        within = state.minimum <= shown <= state.maximum
        found.append((shown if within else value) if isfinite(value) else None)
    return found


def _fmu_variable(
    variable: Variable, role: Role, observed: Collection[str] = (), **changes: Any
) -> FmuVariable:
    """Return a variable of the model in its role, with changes of its facts."""
    known = FmuVariable.__dataclass_fields__
    facts = {name: fact for name, fact in vars(variable).items() if name in known}
    return FmuVariable(role=role, observed=variable.name in observed, **(facts | changes))


def units_of_rates(variables: Sequence[FmuVariable]) -> dict[str, Unit]:
    """Return the units of the derivatives of all states by name."""
    return dict(rate_unit(v.unit) for v in variables if v.role is Role.STATE)


def rate_unit(unit: str) -> tuple[str, Unit]:
    """Return name and definition of a unit per second."""
    base = dict(UNITS[unit].base)
    base["s"] = base.get("s", 0) - 1
    rate = Unit(UNITS[unit].factor, tuple((k, n) for k, n in base.items() if n))
    for name, known in UNITS.items():
        if known == Unit(rate.factor, known.base) and known.measures_like(rate):
            return name, known
    return quotient_name(unit, "s"), rate


@cached_per_thread(16)
def with_margins(dae: Dae, *, valid: bool) -> Dae:
    """Return the DAE with the margin of each validity condition as an additional output.

    A margin is positive while its condition holds. The margins are not observed: in an FMU they are
    local variables, which serve as event indicators.

    Args:
        dae: The model.
        valid: Whether there is an output `valid`, too.

    Raises:
        UsageError: The model has no validity conditions, or uses a reserved variable name.
    """
    names = [f"{VALID}_margin_{i}" for i in range(1, len(dae.limits) + 1)]
    if valid and not names:
        raise UsageError(
            f"{dae.full_name} declares no validity conditions; leave out the output 'valid'"
        )
    own = {v.name for v in dae.variables}
    for taken in own & {*names, *([VALID] if valid else [])}:
        raise UsageError(f"{dae.full_name} has a variable '{taken}' of its own; rename it")
    if not names:
        return dae
    variables = (
        Variable(name, "1", f"positive while {meaning}", start_kind=Start.CALCULATED)
        for name, (_, meaning) in zip(names, dae.limits, strict=True)
    )
    return replace(
        dae,
        outputs=ca.densify(ca.vertcat(dae.outputs, dae.margins)),
        output_variables=(*dae.output_variables, *variables),
    )


_SUFFIX = re.compile(r"(?P<stem>[A-Za-z]+\d*)_(?P<axis>[wxyz])(?P<rest>\d*(?:_dot)*)")
_PREFIX = re.compile(
    r"(?P<stem>[a-z]{0,2}?)(?P<axis>[xyz123k])_(?P<point>[A-Za-z]\w*?)(?:_(?P<frame>[A-Z]))?"
    r"(?P<rest>(?:_dot)*)"
)
_NUMBER = re.compile(r"(?P<stem>[A-Za-z]\w*?)_(?P<axis>\d+)(?P<rest>(?:_dot)*)")
_AXES = ("wxyz", "xyz", "123", "12k", "xy", "12")


def structured(variables: Sequence[FmuVariable]) -> tuple[FmuVariable, ...]:
    """Return the variables under structured names, each with its flat name as alias."""
    names = structured_names({v.name: f"{v.role.value} {v.unit}" for v in variables
                              if v.role not in (Role.TIME, Role.DERIVATIVE)})  # fmt: skip
    names |= {f"der({flat})": f"der({name})" for flat, name in names.items()}
    return tuple(
        replace(v, name=names[v.name], alias=v.name) if names.get(v.name, v.name) != v.name else v
        for v in variables
    )


def structured_names(kinds: Mapping[str, str]) -> dict[str, str]:
    """Return the structured name of each flat one.

    Args:
        kinds: Role and unit, which must be equal among the elements of an array, by flat name.

    Examples:
        >>> from cosim.fmi.export.variables import structured_names
        >>> structured_names({"fx_A": "N", "fy_A": "N", "T": "N.m"})
        {'fx_A': 'A.f[1]', 'fy_A': 'A.f[2]', 'T': 'T'}
    """
    groups: dict[tuple[str, str], dict[str, str]] = {}
    for name, kind in kinds.items():
        if found := next(_readings(name), None):
            array, axis = found
            groups.setdefault((array, kind), {})[axis] = name
    names = {name: name for name in kinds}
    arrays = [array for array, _ in groups]
    for (array, _), members in groups.items():
        root = re.split(r"[.\[]", array)[0]
        if root in kinds or arrays.count(array) > 1 or not (order := _order(members)):
            continue
        names |= {members[axis]: f"{array}[{i}]" for i, axis in enumerate(order, start=1)}
    return names


def _readings(name: str) -> Iterator[tuple[str, str]]:
    """Yield an array that a name may belong to, and its axis in that array."""
    if match := _SUFFIX.fullmatch(name):
        rest = match["rest"]
        yield match["stem"] + (f"_{rest}" if rest[:1].isdigit() else rest), match["axis"]
    elif match := _PREFIX.fullmatch(name):
        frame = f"_{match['frame']}" if match["frame"] else ""
        yield f"{match['point']}.{match['stem'] or 'r'}{frame}{match['rest']}", match["axis"]
    elif match := _NUMBER.fullmatch(name):
        yield f"{match['stem']}{match['rest']}", match["axis"]


def _order(members: Mapping[str, str]) -> Sequence[str]:
    """Return the axes of a complete array in order; nothing if one is missing."""
    for axes in _AXES:
        if set(members) == set(axes):
            return axes
    numbers = [str(i) for i in range(1, len(members) + 1)]
    return numbers if len(numbers) > 1 and set(members) == set(numbers) else ()
