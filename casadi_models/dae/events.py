"""What happens at an instant: assignments to states, samples of a controller, the end of a run."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any
from weakref import WeakSet

import casadi as ca
from casadi import SX

from casadi_models.dae.expressions import quoted, symbols


@dataclass(frozen=True, eq=False)  # CasADi's == builds an expression
class Event:
    """What happens at each instant at which a condition becomes true.

    Attributes:
        name: For messages and `Trajectory.events`.
        condition: Scalar; the event happens when it rises from 0 to 1, or, as a count, by 1.
        states: Positions in `Dae.x` of the states that change.
        values: Their values after the event, of all values just before it, (n, 1).
        sampled: Whether the condition counts samples: from 0 on, which may be at the start.
        message: What ends the run there; empty if the run goes on.
    """

    name: str
    condition: SX
    states: tuple[int, ...]
    values: SX
    sampled: bool = False
    message: str = ""


_LIVING = WeakSet["Happening"]()  # models, in which `smooth` looks for the one that is meant


def smooth(expression: Any) -> SX:
    """Return an expression whose relations are no events: it is smooth where they switch.

    The same as `Model.smooth` of the model that declared the symbols of the expression.

    Raises:
        ValueError: No model declared them all.
    """
    value = SX(expression)
    used = symbols(value)
    if not used:
        return value
    for model in list(_LIVING):
        if used.keys() <= model._declared:
            return model.smooth(value)
    raise ValueError(f"smooth: no model has declared all of {quoted(used.values())}; declare them")


class Happening:
    """The part of `Model` that declares events; `Model` inherits it."""

    t: SX
    _symbols: dict[str, dict[str, SX]]

    def __init__(self) -> None:
        super().__init__()
        self._events: list[Event] = []
        self._smooth: list[SX] = []
        _LIVING.add(self)

    def when(self, condition: Any, values: Mapping[SX, Any], *, name: str = "") -> None:
        """Assign new values to states at each instant at which a condition becomes true.

        Args:
            condition: A comparison, or several joined by `casadi.logic_and` and the like.
            values: New values by state or discrete variable; they, and the expressions in them,
                use the values just before the event. All are assigned at once.
            name: For messages and `Trajectory.events`; "when CONDITION" if empty.
        """
        self._event(condition, values, name or f"when {condition}")

    def every(
        self, period: Any, values: Mapping[SX, Any], *, offset: Any = 0.0, name: str = ""
    ) -> None:
        """Assign new values to states at the times offset, offset + period, offset + 2 period, ...

        Args:
            period, offset: s; numbers or parameters.
            values, name: See `when`.
        """
        period = self._column("period", period, 1)
        if period.is_constant() and not float(period) > 0:
            raise self._refusal(f"period {float(period)} s of 'every' is not positive")
        count = ca.floor((self.t - offset) / period)
        self._event(count, values, name or f"every {period} s", sampled=True)

    def stop(self, condition: Any, message: str) -> None:
        """End the run, as complete, when a condition becomes true.

        Args:
            condition: See `when`.
            message: Why, e.g. "the block reaches the wall".
        """
        if not (isinstance(message, str) and message.strip()):
            raise self._refusal("the message of a stop is missing; describe it in a few words")
        self._event(condition, {}, "stop", message=message)

    def smooth(self, expression: Any) -> SX:
        """Return an expression whose relations are no events: it is smooth where they switch."""
        value = self._expression("smooth expression", expression)
        self._smooth.append(value)
        return value

    @property
    def _declared(self) -> set[int]:
        """What identifies the time and each symbol that was declared."""
        every = (self.t, *(s for own in self._symbols.values() for s in own.values()))
        return {symbol.element_hash() for symbol in every}

    def _shared_events(self, conditions: SX, values: SX) -> Iterator[Event]:
        """Yield the events with their expressions from columns of all of them."""
        begin = 0
        for i, event in enumerate(self._events):
            end = begin + event.values.numel()
            yield replace(event, condition=conditions[i], values=values[begin:end])
            begin = end

    def _event(
        self,
        condition: Any,
        values: Mapping[SX, Any],
        name: str,
        *,
        sampled: bool = False,
        message: str = "",
    ) -> None:
        rule = self._column(f"condition of '{name}'", condition, 1)
        order = list(self._symbols["x"])
        states, rows = list[str](), list[SX]()
        for symbol, value in values.items():
            names = self._names(symbol)
            states += names
            rows += ca.vertsplit(self._column(f"'{name}': {quoted(names)}", value, len(names)))
        twice = [state for state in states if states.count(state) > 1]
        if twice:
            raise self._refusal(f"'{name}' assigns {quoted(twice[:1])} twice; assign it once")
        if not states and not message:
            raise self._refusal(f"'{name}' assigns nothing; give a state and its new value")
        places = tuple(map(order.index, states))
        column = ca.vertcat(SX(0, 1), *rows)
        self._events.append(Event(name, rule, places, column, sampled, message))

    def _names(self, states: SX) -> tuple[str, ...]:
        raise NotImplementedError

    def _column(self, what: str, expression: Any, rows: int | None = None) -> SX:
        raise NotImplementedError

    def _expression(self, what: str, expression: Any) -> SX:
        raise NotImplementedError

    def _refusal(self, reason: str) -> ValueError:
        raise NotImplementedError
