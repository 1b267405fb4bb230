"""The variables of an FMU in the order of their value references."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from enum import Enum
from math import inf, isfinite

from casadi_models.dae import Dae, Start, Variable
from casadi_models.units import UNITS, Unit
from cosim.codegen.initialization import start_function

VALID = "valid"


class Role(Enum):
    """What a variable is in the FMU; the names are those of the C runtime."""

    TIME = "independent"
    STATE = "state"
    DERIVATIVE = "derivative"
    ALGEBRAIC = "algebraic"
    INPUT = "input"
    PARAMETER = "parameter"
    OUTPUT = "output"
    VALIDITY = "validity"  # no number; the runtime knows it without a row in its table


@dataclass(frozen=True)
class FmuVariable:
    """A variable of the FMU; its value reference is its position in the list.

    Attributes:
        name, meaning, unit, display_unit, start, start_kind, nominal, minimum, maximum: See
            `casadi_models.Variable`.
        role: What it is.
        observed: Whether it is an output of the FMU, which importers record.
        derivative_of: Value reference of the state, for a derivative.
        tunable: Whether an importer may change a parameter during a run.
        guess: Where the solution of a calculated start begins; `start` is then its result, which
            importers are told, None where there is none.
        alias: The name that the tools here know it by, where importers see another.
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
    guess: float | None = None
    alias: str | None = None


def fmu_variables(
    dae: Dae, tunable: Collection[str] = (), *, valid: bool = False
) -> tuple[FmuVariable, ...]:
    """Return time, states, derivatives, algebraics, inputs, parameters, outputs, in this order.

    Args:
        dae: The model.
        tunable: Names of the parameters that may change during a run.
        valid: Whether the Boolean output `valid` comes last.
    """
    numbers = tuple(_variables(dae, tunable))
    if not valid:
        return numbers
    meaning = "whether every limit of the model holds"
    return (*numbers, FmuVariable(VALID, meaning, "", Role.VALIDITY, observed=True))


def _variables(dae: Dae, tunable: Collection[str]) -> Iterator[FmuVariable]:
    observed = frozenset(dae.observed)
    yield FmuVariable("time", "simulation time", "s", Role.TIME)
    for state, guess, start in zip(dae.states, dae.x_start, _settled(dae), strict=True):
        variable = _fmu_variable(state, Role.STATE, observed, guess)
        if state.start_kind is Start.CALCULATED:
            variable = replace(variable, start=start, guess=guess)
        yield variable
    for i, state in enumerate(dae.states):
        yield FmuVariable(
            f"der({state.name})",
            f"time derivative of {state.name}",
            rate_unit(state.unit)[0],
            Role.DERIVATIVE,
            _rate_display(state),
            derivative_of=1 + i,
        )
    for algebraic in dae.algebraics:
        yield _fmu_variable(algebraic, Role.ALGEBRAIC, observed, algebraic.start)
    for quantity in dae.inputs:
        yield _fmu_variable(quantity, Role.INPUT, frozenset(), quantity.start)
    for parameter in dae.parameters:
        variable = _fmu_variable(parameter, Role.PARAMETER, frozenset(), parameter.start)
        yield replace(variable, tunable=parameter.name in tunable)
    for output in dae.output_variables:
        yield _fmu_variable(output, Role.OUTPUT, observed, None)


def _rate_display(state: Variable) -> str | None:
    """Return the display unit of a state's rate: deg/s where the state is shown in deg."""
    if not state.display_unit:
        return None
    name, _ = rate_unit(state.display_unit)
    return name if name in UNITS else None


def _settled(dae: Dae) -> list[float | None]:
    """Return the starts of all states, as initialization solves for them; None where it cannot."""
    u, p = ([float(v.start or 0.0) for v in group] for group in (dae.inputs, dae.parameters))
    x, _ = start_function(dae)(0.0, list(dae.x_start), u, p)
    return [
        _rounded(float(value), state.nominal) if isfinite(value) else None
        for value, state in zip(x.full().ravel(), dae.states, strict=True)
    ]


def _rounded(value: float, nominal: float) -> float:
    """Return a solution without its rounding errors."""
    return float(f"{value:.15g}") if abs(value) > 1e-14 * nominal else 0.0


def _fmu_variable(
    variable: Variable, role: Role, observed: frozenset[str], start: float | None
) -> FmuVariable:
    return FmuVariable(
        variable.name,
        variable.meaning,
        variable.unit,
        role,
        variable.display_unit,
        start,
        variable.start_kind,
        variable.nominal,
        variable.minimum,
        variable.maximum,
        variable.name in observed,
    )


def rate_unit(unit: str) -> tuple[str, Unit]:
    """Return name and definition of a unit per second."""
    base = dict(UNITS[unit].base)
    base["s"] = base.get("s", 0) - 1
    rate = Unit(UNITS[unit].factor, tuple((k, n) for k, n in base.items() if n))
    for name, known in UNITS.items():
        if known.factor == rate.factor and known.measures_like(rate):
            return name, known
    return f"{unit}/s", rate
