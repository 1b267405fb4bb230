"""Start values that follow from parameters, from other start values, inputs and time."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
from casadi import SX

from casadi_models.dae.declaring import Declaring
from casadi_models.dae.expressions import is_structurally_regular, quoted, reject_faulty, symbols
from casadi_models.dae.variables import Variable

AT_A_START = "time, states, inputs and parameters"  # may stand in start rules and in invariants


@dataclass(frozen=True, eq=False)  # CasADi's == builds an expression
class StartRule:
    """Start values of some states, from parameters and from starts settled before.

    Inputs and time stand for what they are where a run begins.

    Attributes:
        states: Positions in `Dae.x`.
        expression: The start values themselves, or the residual that they make zero.
        implicit: Whether `expression` is a residual, to be solved from the states' start guesses.
        meaning: The law, for messages.
    """

    states: tuple[int, ...]
    expression: SX
    implicit: bool
    meaning: str


@dataclass(frozen=True, eq=False)
class StartThrough:
    """An output by whose value the start of a state may be given.

    Attributes:
        variable: The output.
        state: Position in `Dae.x` of the state.
        expression: The output, of states and parameters.
    """

    variable: Variable
    state: int
    expression: SX


class Starting(Declaring):
    """The part of `Model` that says how starts follow; `Model` inherits it."""

    def __init__(self, *named: Any) -> None:
        super().__init__(*named)
        self._rules: list[StartRule] = []
        self._through: dict[str, str] = {}  # state by output

    def start(self, states: SX, expression: Any, meaning: str) -> None:
        """Calculate starts of states from parameters and other starts, explicitly.

        Args:
            states: Of this model, (n, 1).
            expression: Of states whose start is settled before, parameters, inputs and time, which
                count as they are where a run begins; (n, 1).
            meaning: The law, for messages.
        """
        self._start_rule(states, expression, implicit=False, meaning=meaning)

    def start_equation(self, states: SX, residual: Any, meaning: str) -> None:
        """Calculate starts of states as the root of a residual, from their start as a guess."""
        self._start_rule(states, residual, implicit=True, meaning=meaning)

    def start_through(self, state: SX, output: str) -> None:
        """Let users give the start of a state by the value of an output of states and parameters.

        It must grow or fall with that state at every start: the start is solved for.
        """
        (name,) = self._names(state)
        if output not in self._outputs:
            raise self._refusal(f"'{output}' is no output of this model; declare it before")
        self._through[output] = name

    def _start_rule(self, states: SX, expression: Any, *, implicit: bool, meaning: str) -> None:
        names = self._names(states)
        order = list(self._symbols["x"])
        law = self._column(f"start ({meaning})", expression, len(names))
        self._rules.append(StartRule(tuple(map(order.index, names)), law, implicit, meaning))

    def _starts_through(self, x: SX, p: SX) -> tuple[StartThrough, ...]:
        order = list(self._symbols["x"])
        calculated = {order[i] for rule in self._rules for i in rule.states}
        for output, state in self._through.items():
            law = f"output '{output}', which gives a start,", self._outputs[output]
            reject_faulty([law], ca.vertcat(x, p), "states and parameters")
            if state in calculated:
                raise ValueError(f"the start of '{state}' is calculated; '{output}' cannot give it")
            together = [
                (f"start ({rule.meaning}), solved with '{output}',", rule.expression)
                for rule in self._rules
            ]
            reject_faulty(together, ca.vertcat(x, p), "states and parameters")
        return tuple(
            StartThrough(self._variables[output], order.index(state), self._outputs[output])
            for output, state in self._through.items()
        )


def reject_disorder(rules: Sequence[StartRule], t: SX, x: SX, u: SX, p: SX) -> None:
    """Reject rules that cannot be evaluated one after the other.

    Args:
        rules: In the order of evaluation.
        t, x, u, p: Symbols of time, states, inputs and parameters, columns.

    Raises:
        ValueError: A rule uses what a start may not depend on or what is not settled before, sets
            a start for the second time, or does not determine the starts it is solved for.
    """
    names = [state.name() for state in ca.vertsplit(x)]
    unsettled = [i for rule in rules for i in rule.states]
    for rule in rules:
        what = f"start ({rule.meaning})"
        reject_faulty([(what, rule.expression)], ca.vertcat(t, x, u, p), AT_A_START)
        twice = [names[i] for i in rule.states if unsettled.count(i) > 1]
        if twice:
            raise ValueError(f"the start of {quoted(twice)} is calculated twice; keep one rule")
        own = rule.states if rule.implicit else ()
        later = [names[i] for i in unsettled if i not in own]
        needed = [name for name in symbols(rule.expression).values() if name in later]
        if needed:
            raise ValueError(f"{what} needs {quoted(needed)}, which no rule before it settles")
        if rule.implicit and not is_structurally_regular(rule.expression, x[list(own)]):
            raise ValueError(f"{what} does not determine each of {quoted(names[i] for i in own)}")
        unsettled = [i for i in unsettled if i not in rule.states]
