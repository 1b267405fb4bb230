"""What is done about drift from constraints that are kept through their derivatives only."""

from collections.abc import Mapping
from typing import NamedTuple

from casadi_models.dae import Dae
from cosim.errors import UnknownName, UsageError

DRIFT_CONTROLS = ("none", "baumgarte", "projection")
CLOSING_RATE = "closing_rate"  # parameter of the models that have Baumgarte's terms


class DriftControl(NamedTuple):
    """Values with which a run begins, and whether its steps are projected."""

    start: Mapping[str, float] | None
    project: bool


def controllable(dae: Dae, name: str) -> bool:
    """Tell whether a model can have a drift control."""
    try:
        controlled(dae, name, None)
    except UsageError:
        return False
    return True


def controlled(dae: Dae, name: str | None, start: Mapping[str, float] | None) -> DriftControl:
    """Return what a choice of drift control means for a run.

    Args:
        dae: The model.
        name: One of `DRIFT_CONTROLS`; what the model's own `closing_rate` says when None.
        start: Values that the user gives.

    Raises:
        UnknownName: There is no such control.
        UsageError: The model has nothing that could be controlled like that, or `start` says
            something else.
    """
    if name is None:
        return DriftControl(start, project=False)
    if name not in DRIFT_CONTROLS:
        raise UnknownName.among("simulate", "drift control", name, DRIFT_CONTROLS)
    damped = any(v.name == CLOSING_RATE for v in dae.parameters)
    if name == "baumgarte":
        if not damped:
            raise UsageError(f"{dae.full_name} has no {CLOSING_RATE}; leave its drift control out")
        return DriftControl(start, project=False)
    if name == "projection" and not dae.invariants:
        raise UsageError(f"{dae.full_name} keeps its constraints exactly: nothing can be projected")
    if start and CLOSING_RATE in start:
        raise UsageError(f"{CLOSING_RATE} is given, but drift control '{name}' makes it 0")
    without = {**(start or {}), CLOSING_RATE: 0.0} if damped else start
    return DriftControl(without, project=name == "projection")
