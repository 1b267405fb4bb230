"""Start values that follow from parameters and from other start values."""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
from casadi import SX

from casadi_models.dae.expressions import is_structurally_regular, quoted, refuse_faulty, symbols


@dataclass(frozen=True, eq=False)  # CasADi's == builds an expression
class StartRule:
    """Start values of some states, from parameters and from starts settled before.

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


def refuse_disorder(rules: Sequence[StartRule], x: SX, p: SX) -> None:
    """Refuse rules that cannot be evaluated one after the other.

    Args:
        rules: In the order of evaluation.
        x, p: Symbols of states and parameters, columns.

    Raises:
        ValueError: A rule uses what a start may not depend on or what is not settled before, sets
            a start for the second time, or does not determine the starts it is solved for.
    """
    names = [state.name() for state in ca.vertsplit(x)]
    unsettled = [i for rule in rules for i in rule.states]
    for rule in rules:
        what = f"start ({rule.meaning})"
        refuse_faulty({what: rule.expression}, ca.vertcat(x, p), "states and parameters")
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
