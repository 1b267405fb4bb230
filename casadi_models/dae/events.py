"""What happens at an instant: assignments to states, samples of a controller, the end of a run."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from math import inf
from typing import Any
from weakref import WeakSet

import casadi as ca
from casadi import SX

from casadi_models.dae.declaring import Declaring
from casadi_models.dae.expressions import (
    COMPARING,
    RELATIONS,
    as_text,
    column,
    no_expression,
    operations,
    quoted,
    symbols,
)


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


_SHORTEST = 1e-12  # period, s
_LIVING = WeakSet["Happening"]()  # models, in which `smooth` looks for the one that is meant


def smooth(expression: Any) -> SX:
    """Return an expression whose relations are no events: it is smooth where they switch.

    The same as `Model.smooth` of the model that declared the symbols of the expression.

    Raises:
        ValueError: No model declared them all, or it is no expression.

    Example:
        >>> import casadi
        >>> import cosim
        >>> model = cosim.Model("brake")
        >>> v = model.state("v", "m/s", 1.0, "speed")
        >>> model.derivative(v, -cosim.smooth(casadi.fabs(v)) * v)  # has a derivative at 0
        >>> round(cosim.simulate(model.freeze(), stop_time=1.0).final["v"], 6)
        0.5
    """
    try:
        value = SX(expression)
    except Exception as error:  # of CasADi: wrong type of argument
        raise ValueError(no_expression("smooth: the expression", expression)) from error
    used = symbols(value)
    if not used:
        return value
    for model in list(_LIVING):
        if used.keys() <= model._declared:
            return model.smooth(value)
    raise ValueError(f"smooth: no model has declared all of {quoted(used.values())}; declare them")


class Happening(Declaring):
    """The part of `Model` that declares events; `Model` inherits it."""

    def __init__(self, *named: Any) -> None:
        super().__init__(*named)
        self._events: list[Event] = []
        self._smooth: list[SX] = []
        _LIVING.add(self)

    def when(self, condition: Any, values: Mapping[SX, Any], *, name: str = "") -> None:
        """Assign new values to states at each instant at which a condition becomes true.

        Args:
            condition: A comparison, or several joined by `casadi.logic_and` and the like; `==` only
                of discrete variables, as no solver meets a continuous one exactly.
            values: New values by state or discrete variable; they, and the expressions in them,
                use the values just before the event. All are assigned at once.
            name: For messages and `Trajectory.events`; "when CONDITION" if empty.
        """
        name = name or f"when {as_text(condition)}"
        self._reject_never(name, condition)
        self._event(condition, values, name)

    def every(
        self, period: Any, values: Mapping[SX, Any], *, offset: Any = 0.0, name: str = ""
    ) -> None:
        """Assign new values to states at the times offset, offset + period, offset + 2 period, ...

        Args:
            period, offset: s; numbers, parameters or expressions of parameters. A period that is
                a parameter gets the minimum 1e-12 s.
            values, name: See `when`.
        """
        period = self._column("period", period, 1)
        name = name or f"every {period} s"
        if ca.depends_on(ca.vertcat(period, SX(offset)), self._varying):
            raise self._refusal(
                f"period or offset of '{name}' is no constant; only parameters may stand there"
            )
        if period.is_constant() and not float(period) > 0:
            raise self._refusal(f"period {float(period)} s of 'every' is not positive")
        if not (period.is_constant() or self.bound(period, _SHORTEST, inf)):
            wrong = ca.floor(0.5 + 0.25 * ca.cos(ca.log(period)))  # 0, or no number if it is
            values = {state: value + wrong for state, value in values.items()}
            period = ca.if_else(period > 0, period, 1)  # so that a sample tells of it
        count = ca.floor((self.t - offset) / period)
        self._event(count, values, name, sampled=True)

    def stop(self, condition: Any, message: str) -> None:
        """End the run, as complete, when a condition becomes true.

        Args:
            condition: See `when`.
            message: Why, e.g. "the block reaches the wall".
        """
        if not (isinstance(message, str) and message.strip()):
            raise self._refusal("the message of a stop is missing; describe it in a few words")
        self._reject_never("stop", condition)
        self._event(condition, {}, "stop", message=message)

    def smooth(self, expression: Any) -> SX:
        """Return an expression whose relations are no events: it is smooth where they switch."""
        value = self._column("smooth expression", expression)
        self._smooth.append(value)
        return value

    def _reject_never(self, name: str, condition: Any) -> None:
        """Reject a condition that cannot become true at an instant."""
        rule = self._column(f"condition of '{name}'", condition, 1)
        what = f"condition of '{name}'"
        if rule.is_constant():
            always = "true" if float(rule) else "false"
            raise self._refusal(f"{what} is always {always}; give one that becomes true")
        used = operations(rule)
        if ca.OP_CALL in used:
            return
        if used.isdisjoint(COMPARING):
            raise self._refusal(f"{what} has no comparison; write one, e.g. {rule} > 0")
        if used.isdisjoint(RELATIONS) and ca.depends_on(rule, self._continuous):
            raise self._refusal(
                f"{what} has only == of continuous variables, which no solver meets; use < or >"
            )

    @property
    def _continuous(self) -> SX:
        """The time and the variables that change between events."""
        known = self._derivatives
        fixed = {n for n, rate in known.items() if rate.is_constant() and float(rate) == 0}
        moving = (symbol for name, symbol in self._symbols["x"].items() if name not in fixed)
        return ca.vertcat(self.t, *moving, *self._symbols["z"].values())

    @property
    def _varying(self) -> SX:
        """The time and all variables but parameters."""
        return ca.vertcat(self.t, *(s for kind in "xzu" for s in self._symbols[kind].values()))

    @property
    def _declared(self) -> set[int]:
        """What identifies the time and each symbol that was declared."""
        every = (self.t, *(s for own in self._symbols.values() for s in own.values()))
        return {symbol.element_hash() for symbol in every}

    def _shared_events(self, conditions: SX, values: SX) -> Iterator[Event]:
        """Yield the events with their expressions from columns of all of them."""
        begin, rows = 0, ca.vertsplit(values)
        for i, event in enumerate(self._events):
            end = begin + event.values.numel()
            yield replace(event, condition=conditions[i], values=column(rows[begin:end]))
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
        self._events.append(Event(name, rule, places, column(rows), sampled, message))
