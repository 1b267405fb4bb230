"""A model's equations as text: written out where they are short, else what they are made of."""

from collections.abc import Container, Iterator

import casadi as ca
from casadi import SX

from casadi_models.dae import Dae
from casadi_models.dae.expressions import operation_count
from cosim.memo import kept_per_thread

LONGEST_FORMULA = 120  # letters of an expression that is written out


@kept_per_thread(8)
def formulas(dae: Dae) -> tuple[tuple[str, str], ...]:
    """Return left and right sides: of calculated starts, dx/dt, algebraic equations, outputs.

    Examples:
        >>> import cosim
        >>> from cosim.fmi.export.documents.formulas import formulas
        >>> dict(formulas(cosim.load("crank_shaft/driven")))["der(phi)"]
        'omega'
    """
    return tuple(_formulas(dae))


def _formulas(dae: Dae) -> Iterator[tuple[str, str]]:
    parameters = frozenset(parameter.name for parameter in dae.parameters)
    for rule in dae.start_rules:
        names = ", ".join(dae.states[i].name for i in rule.states)
        if rule.implicit:
            yield f"{names} at the start", f"solution of 0 = {_text(rule.expression, parameters)}"
        else:
            yield f"{names} at the start", _text(rule.expression, parameters)
    outputs = [output.name for output in dae.output_variables]
    for left, column in (
        ([f"der({state.name})" for state in dae.states], dae.ode),
        (["0"] * len(dae.algebraics), dae.alg),
        (outputs, dae.outputs),
    ):
        for name, expression in zip(left, ca.vertsplit(column) if left else [], strict=True):
            yield name, _text(expression, parameters)


def _text(expression: SX, parameters: Container[str]) -> str:
    """Write an expression out; where it is long, its variables and the operations it takes."""
    symbols = ca.symvar(expression)
    count = operation_count(ca.Function("f", symbols, [expression]))
    if expression.is_scalar() and count < LONGEST_FORMULA:
        text = str(expression)
        if len(text) <= LONGEST_FORMULA and "@" not in text:
            return text
    moving = ", ".join(s.name() for s in symbols if s.name() not in parameters)
    return f"f({moving}{'; ' if moving else ''}parameters), {count} operations"
