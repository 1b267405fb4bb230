"""The margins of a model's limits as variables, by which an FMU tells whether it is valid."""

from dataclasses import replace

import casadi as ca

from casadi_models.dae import Dae, Start, Variable
from cosim.errors import UsageError
from cosim.fmi.export.variables import VALID


def with_margins(dae: Dae) -> Dae:
    """Return the DAE with a last output for each limit: its margin, positive while it holds.

    They are not observed: an FMU has them as local variables, which are its event indicators.

    Raises:
        UsageError: The model has no limits, or a variable of a name that is needed.
    """
    names = [f"{VALID}_margin_{i}" for i in range(1, len(dae.limits) + 1)]
    if not names:
        raise UsageError(
            f"{dae.full_name} declares no limits; leave out the output that reports their breach"
        )
    for taken in {v.name for v in dae.variables} & {VALID, *names}:
        raise UsageError(f"{dae.full_name} has a variable '{taken}' of its own; rename it")
    variables = (
        Variable(name, "1", f"positive while {meaning}", start_kind=Start.CALCULATED)
        for name, (_, meaning) in zip(names, dae.limits, strict=True)
    )
    return replace(
        dae,
        outputs=ca.densify(ca.vertcat(dae.outputs, dae.margins)),
        output_variables=(*dae.output_variables, *variables),
    )
