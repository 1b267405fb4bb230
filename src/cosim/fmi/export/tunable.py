"""Which parameters an importer may change during a run, and why others are fixed."""

from collections.abc import Mapping, Sequence

import casadi as ca

from casadi_models.dae import Dae
from casadi_models.units import UNITS
from cosim.errors import UnknownName, UsageError
from cosim.fmi.export.dependencies import start_parameters

ALL = "all"
WHY_IDLE = "nothing follows from it after the start"


def fixed_parameters(dae: Dae) -> Mapping[str, str]:
    """Return the parameters that rest during a run unless it is asked for, with the reason."""
    reasons = {}
    starting = start_parameters(dae)
    equations = ca.vertcat(dae.ode, dae.alg, dae.outputs)
    used = ca.which_depends(equations, dae.p, 1, False) if dae.parameters else ()
    for parameter, needed in zip(dae.parameters, used, strict=True):
        base = dict(UNITS[parameter.unit].base)
        if not needed:
            reasons[parameter.name] = WHY_IDLE
        elif parameter.name in starting:
            reasons[parameter.name] = "start values follow from it"
        elif base.get("kg") and not base.get("s"):
            reasons[parameter.name] = "a change of inertia would add momentum from nowhere"
    return reasons


def tunable_parameters(dae: Dae, wanted: Sequence[str] | None) -> tuple[str, ...]:
    """Return the names of the parameters that may change during a run.

    Args:
        dae: The model.
        wanted: Which are wanted; `[ALL]`: all that matter during a run; when None, of these all
            but inertias and those that start values follow from.

    Raises:
        UnknownName: The model has no such parameter.
        UsageError: It has no influence during a run.
    """
    names, fixed = [p.name for p in dae.parameters], fixed_parameters(dae)
    if wanted is None:
        return tuple(name for name in names if name not in fixed)
    if tuple(wanted) == (ALL,):
        return tuple(name for name in names if fixed.get(name) != WHY_IDLE)
    for name in wanted:
        if name not in names:
            raise UnknownName.among(dae.full_name, "parameter", name, names)
        if fixed.get(name) == WHY_IDLE:
            raise UsageError(
                f"{dae.full_name}: {name} cannot be tunable, as {WHY_IDLE}; set it before a run"
            )
    return tuple(wanted)
