"""What is done about drift from constraints that are kept through their derivatives only."""

from typing import NamedTuple

from casadi_models.dae import Dae
from cosim.errors import UnknownName, UsageError
from cosim.memo import kept_per_thread

DRIFT_CONTROLS = ("none", "baumgarte", "projection")


class DriftControl(NamedTuple):
    """The model with its closing rate, and whether a run's steps are projected."""

    dae: Dae
    project: bool


def controllable(dae: Dae, name: str) -> bool:
    """Tell whether a model can have a drift control."""
    try:
        controlled(dae, name)
    except UsageError:
        return False
    return True


def controlled(dae: Dae, name: str | None) -> DriftControl:
    """Return what a choice of drift control means for a run.

    Args:
        dae: The model.
        name: One of `DRIFT_CONTROLS`; the model as it is when None.

    Raises:
        UnknownName: There is no such control.
        UsageError: The model has nothing that could be controlled like that.
    """
    if name is None:
        return DriftControl(dae, project=False)
    if name not in DRIFT_CONTROLS:
        raise UnknownName.among("simulate", "drift control", name, DRIFT_CONTROLS)
    if name == "baumgarte":
        if dae.closing is None or not dae.closing.rate:
            raise UsageError(f"{dae.full_name} has no closing rate; leave its drift control out")
        return DriftControl(dae, project=False)
    if name == "projection" and not dae.invariants:
        raise UsageError(f"{dae.full_name} keeps its constraints exactly: nothing can be projected")
    free = dae if dae.closing is None else _undamped(dae)
    return DriftControl(free, project=name == "projection")


@kept_per_thread(16)
def _undamped(dae: Dae) -> Dae:
    return dae.closing_at(0.0)
