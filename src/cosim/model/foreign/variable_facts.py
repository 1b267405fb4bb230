"""What a user says of variables, by the name of a variable or of the symbol that holds it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from casadi import MX, SX

from casadi_models.units import known as known_unit
from cosim.errors import ParameterError, UnknownName, UsageError
from cosim.model.foreign.casadi_system import System, entry_names, scalars
from cosim.model.foreign.named_symbols import Symbol


@dataclass(frozen=True)
class Facts:
    """Start values, units, meanings and nominal values by name; see `from_casadi`."""

    who: str
    starts: Mapping[str, Any]
    units: Mapping[str, str]
    meanings: Mapping[str, str]
    nominals: Mapping[str, float]

    def refuse_strangers(self, system: System) -> None:
        """Refuse values for what does not exist.

        Raises:
            UnknownName: With the names that come nearest.
        """
        symbols = [s for kind in "xzup" for s in system.symbols[kind]]
        for what, given in (
            ("start_values", self.starts),
            ("units", self.units),
            ("meanings", self.meanings),
            ("nominals", self.nominals),
        ):
            if not isinstance(given, Mapping):
                raise UsageError.of_type(f"{self.who}: {what}", given, "a dict by name")
        if not (symbols or system.laws or system.outputs):
            raise UsageError(f"{self.who}: there is neither a state nor an output; give one")
        quads = scalars("quad", system.laws["quad"]) if "quad" in system.laws else []
        own = [n for s in symbols for n in (s.name, *s.entries)]
        own += ["quad", *(n for n, _ in quads)] if quads else []
        shown = [n for key, e in system.outputs.items() for n in (key, *entry_names(key, e))]
        for what, given, known in (
            ("start value", self.starts, own),
            ("unit", self.units, own + shown),
            ("meaning", self.meanings, own + shown),
            ("nominal value", self.nominals, own + shown),
        ):
            for name in given:
                if name not in known:
                    raise UnknownName.among(self.who, f"variable for the {what} of", name, known)

    def of(self, name: str, symbol: str, meaning: str) -> tuple[str, str, dict[str, Any]]:
        """Return unit, meaning and further facts of a variable."""
        unit = self.units.get(name, self.units.get(symbol, "1"))
        meaning = self.meanings.get(name, self.meanings.get(symbol, meaning))
        more: dict[str, Any] = {}
        if not isinstance(unit, str):
            raise UsageError.of_type(f"{self.who}: unit of {name}", unit, "a text")
        if not known_unit(unit):
            more["foreign_unit"] = True
            meaning = f"{meaning} (unit '{unit}' is unknown here: factor 1)"
        nominal = self.nominals.get(name, self.nominals.get(symbol))
        if nominal is not None:
            more["nominal"] = nominal
        return unit, meaning, more

    def start(self, symbol: Symbol, kind: str) -> list[Any]:
        """Return the start of each variable of a symbol: a number or an expression.

        Raises:
            ParameterError: A parameter has none, or there are too many or too few.
        """
        default = None if kind == "p" else 0.0
        values: list[Any] = [default] * len(symbol.entries)
        if symbol.name in self.starts:
            values = self._spread(symbol, self.starts[symbol.name])
        for i, entry in enumerate(symbol.entries):
            if entry in self.starts and entry != symbol.name:
                values[i] = self._spread(Symbol(entry, (1, 1), symbol.symbol), self.starts[entry])[
                    0
                ]
        missing = [e for e, value in zip(symbol.entries, values, strict=True) if value is None]
        if missing:
            raise ParameterError(
                f"{self.who}: parameter {', '.join(missing)} has no value; give it in start_values"
            )
        return values

    def _spread(self, symbol: Symbol, given: Any) -> list[Any]:
        size = len(symbol.entries)
        if isinstance(given, SX | MX):
            entries: list[Any] = ca.vertsplit(ca.vec(given))
        else:
            try:
                if given is None or np.asarray(given).dtype == bool:
                    raise TypeError
                entries = [float(v) for v in np.asarray(given, dtype=float).flatten(order="F")]
            except (TypeError, ValueError):
                raise ParameterError(
                    f"{self.who}: start of {symbol.name} is {given!r}; give numbers"
                ) from None
        if len(entries) not in (1, size):
            raise ParameterError(
                f"{self.who}: {symbol.name} has {size} entries, but {len(entries)} start values"
            )
        return entries * size if len(entries) == 1 else list(entries)
