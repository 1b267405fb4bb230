"""The part of `Model` that declares variables and names the model in errors."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, Unpack

import casadi as ca
from casadi import SX

from casadi_models.dae import shown
from casadi_models.dae.expressions import no_expression, quoted
from casadi_models.dae.variables import Facts, Start, Variable, is_name, number
from casadi_models.units import convert, represented

_SPREAD = 1e12  # a positive parameter may differ from its default by this factor, not more


class Declaring:
    """Variables by name; the other parts of `Model` inherit it.

    Args:
        name, formulation, display: See `Model`.
    """

    def __init__(self, name: str, formulation: str, display: Mapping[str, str]) -> None:
        for part in (name, formulation):
            if not is_name(part) and not (isinstance(part, str) and part == "" != name):
                wrong = represented(part)
                raise ValueError(f"{wrong} cannot name a model: use letters, digits and _")
        if not isinstance(display, Mapping):
            raise ValueError(f"{name}: display is {represented(display)}; give units by SI unit")
        self._name, self._formulation = name, formulation
        self._display = dict(display)
        with self._naming_the_model():
            for unit, target in self._display.items():
                convert(1.0, unit, target)
        self._variables: dict[str, Variable] = {}
        self._symbols: dict[str, dict[str, SX]] = {kind: {} for kind in "xzup"}
        self._outputs: dict[str, SX] = {}
        self._monitors: dict[str, SX] = {}
        self._derivatives: dict[str, SX] = {}
        self.t = SX.sym("time")

    def __repr__(self) -> str:
        counts = ", ".join(f"{len(own)} {kind}" for kind, own in self._groups() if own)
        return (
            f"Model {self._full_name}: {counts or 'nothing declared'}; freeze() makes a Dae of it"
        )

    def _repr_html_(self) -> str:
        return shown.table(repr(self), self._groups())

    @property
    def _full_name(self) -> str:
        return f"{self._name}/{self._formulation}" if self._formulation else self._name

    def _groups(self) -> Iterator[tuple[str, list[Variable]]]:
        names = ("states", "algebraics", "inputs", "parameters")
        for kind, name in zip("xzup", names, strict=True):
            yield name, [self._variables[own] for own in self._symbols[kind]]

    def state(self, name: str, unit: str, start: float, meaning: str, **facts: Unpack[Facts]) -> SX:
        """Declare a state; `start` is exact unless a start rule makes it an initial guess."""
        return self._declare("x", self._variable(name, unit, meaning, facts, start))

    def algebraic(
        self, name: str, unit: str, guess: float, meaning: str, **facts: Unpack[Facts]
    ) -> SX:
        """Declare an unknown that an `equation` determines, solved for from `guess`."""
        return self._declare("z", self._variable(name, unit, meaning, facts, guess, Start.GUESS))

    def input(self, name: str, unit: str, start: float, meaning: str, **facts: Unpack[Facts]) -> SX:
        """Declare an input; it keeps its start value unless something drives it."""
        return self._declare("u", self._variable(name, unit, meaning, facts, start))

    def parameter(
        self,
        name: str,
        unit: str,
        value: float,
        meaning: str,
        *,
        positive: bool = False,
        **facts: Unpack[Facts],
    ) -> SX:
        """Declare a parameter; `positive` bounds it to 1e-12 ... 1e12 times its default."""
        with self._naming_the_model():
            size = abs(number(value, f"{name}: value"))
        facts.setdefault("nominal", size or 1.0)
        if positive:
            if not value > 0:
                raise self._refusal(f"{name}: value {value} is not positive, as declared")
            facts.setdefault("minimum", value / _SPREAD)
            facts.setdefault("maximum", value * _SPREAD)
        return self._declare("p", self._variable(name, unit, meaning, facts, value))

    def bound(self, parameter: SX, minimum: float, maximum: float) -> bool:
        """Narrow the bounds of a parameter; return False for any other expression."""
        for name, symbol in self._symbols["p"].items():
            if parameter.element_hash() == symbol.element_hash():
                known = self._variables[name]
                low, high = max(minimum, known.minimum), min(maximum, known.maximum)
                with self._naming_the_model():
                    self._variables[name] = replace(known, minimum=low, maximum=high)
                return True
        return False

    def output(
        self, name: str, unit: str, expression: Any, meaning: str, **facts: Unpack[Facts]
    ) -> None:
        """Declare an output of the model, given by a scalar expression."""
        variable = self._variable(name, unit, meaning, facts, None, Start.CALCULATED)
        self._outputs[name] = self._column(f"output '{name}'", expression, 1)
        self._variables[name] = variable

    def monitor(self, name: str, expression: Any, meaning: str) -> None:
        """Declare a condition number of the equations (1).

        It costs nothing until it is named as an output; see `Dae.watching`.
        """
        facts: Facts = {"own_meaning": "it describes the equations, which differ"}
        variable = self._variable(name, "1", meaning, facts, None, Start.CALCULATED)
        self._monitors[name] = self._column(f"monitor '{name}'", expression, 1)
        self._variables[name] = variable

    def energies(self, kinetic: Any, potential: Any, *, nominal: float = 1.0) -> None:
        """Declare `kinetic_energy`, `potential_energy` and their sum `energy`, J."""
        self.output("kinetic_energy", "J", kinetic, "kinetic energy", nominal=nominal)
        self.output("potential_energy", "J", potential, "potential energy", nominal=nominal)
        self.output("energy", "J", kinetic + potential, "total energy", nominal=nominal)

    def _variable(
        self,
        name: str,
        unit: str,
        meaning: str,
        facts: Facts,
        start: float | None,
        start_kind: Start = Start.EXACT,
    ) -> Variable:
        unknown = facts.keys() - Facts.__annotations__
        if unknown:
            raise self._refusal(
                f"{name}: {quoted(sorted(unknown))} is no fact of a variable; "
                f"there are {', '.join(Facts.__annotations__)}"
            )
        if isinstance(unit, str) and unit in self._display:
            facts.setdefault("display_unit", self._display[unit])
        with self._naming_the_model():
            variable = Variable(name, unit, meaning, start, start_kind, **facts)
        if name in self._variables:
            raise self._refusal(f"'{name}' is declared twice; choose another name")
        return variable

    def _declare(self, kind: str, variable: Variable) -> SX:
        symbol = SX.sym(variable.name)
        self._variables[variable.name] = variable
        self._symbols[kind][variable.name] = symbol
        return SX(symbol)  # a copy, for a user who writes into it

    def _of(self, kind: str) -> tuple[Variable, ...]:
        return tuple(self._variables[name] for name in self._symbols[kind])

    def _names(self, states: SX) -> tuple[str, ...]:
        known = {symbol.element_hash(): name for name, symbol in self._symbols["x"].items()}
        rows = ca.vertsplit(self._column("column of states", states))
        for row in rows:
            if row.element_hash() not in known:
                raise self._refusal(
                    f"'{row}' is not a state of this model; declare it with state()"
                )
        return tuple(known[row.element_hash()] for row in rows)

    def _expression(self, what: str, expression: Any) -> SX:
        try:
            return ca.densify(SX(expression))
        except Exception as error:  # of CasADi: wrong type of argument
            raise self._refusal(no_expression(what, expression)) from error

    def _column(self, what: str, expression: Any, rows: int | None = None) -> SX:
        value = self._expression(what, expression)
        if value.shape != (value.shape[0] if rows is None else rows, 1):
            shape = f"({'n' if rows is None else rows}, 1)"
            raise self._refusal(f"{what} has shape {value.shape}; give shape {shape}")
        return value

    @contextmanager
    def _naming_the_model(self) -> Iterator[None]:
        try:
            yield
        except ValueError as error:
            raise self._refusal(str(error)) from error

    def _display_of(self, unit: str) -> str:
        return self._display.get(unit, unit)

    def _refusal(self, reason: str) -> ValueError:
        return ValueError(" ".join(f"{self._full_name}: {reason}".split()))
