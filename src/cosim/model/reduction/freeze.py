"""Parameters that become numbers."""

from collections.abc import Collection
from dataclasses import replace

import casadi as ca
from casadi import SX

from casadi_models.dae import Dae
from cosim.errors import UnknownName


def frozen_at_start(dae: Dae, names: Collection[str]) -> Dae:
    """Return the DAE with the start values of some parameters in their place.

    Raises:
        UnknownName: The model has no such parameter.
    """
    known = {v.name: v for v in dae.parameters}
    for name in names:
        if name not in known:
            raise UnknownName.among(dae.full_name, "parameter", name, known)
    values = SX(dae.p)
    for i, parameter in enumerate(dae.parameters):
        if parameter.name in names:
            values[i] = parameter.start or 0.0
    margins = ca.vertcat(SX(0, 1), *(margin for margin, _ in dae.limits))
    drifts = [column for i in dae.invariants for column in (i.residual, i.sizes)]
    fixed = ca.substitute([dae.ode, dae.alg, dae.outputs, margins, *drifts], [dae.p], [values])
    rules = tuple(
        replace(rule, expression=ca.substitute(rule.expression, dae.p, values))
        for rule in dae.start_rules
    )
    ways = tuple(
        replace(way, expression=ca.substitute(way.expression, dae.p, values))
        for way in dae.start_outputs
    )
    closing = dae.closing and replace(
        dae.closing, residual=ca.substitute(dae.closing.residual, dae.p, values)
    )
    ode, alg, outputs, margins, *drifts = (ca.densify(column) for column in fixed)
    limits = tuple((margins[i], meaning) for i, (_, meaning) in enumerate(dae.limits))
    invariants = tuple(
        replace(invariant, residual=residual, sizes=sizes)
        for invariant, residual, sizes in zip(
            dae.invariants, drifts[::2], drifts[1::2], strict=True
        )
    )
    return replace(
        dae,
        ode=ode,
        alg=alg,
        outputs=outputs,
        start_rules=rules,
        start_outputs=ways,
        limits=limits,
        invariants=invariants,
        closing=closing,
    )
