"""From an instance of fmpy's to one that runs, in the order of calls of `fmpy.simulate_fmu`."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from cosim.errors import FmuError


class FirstEvents(NamedTuple):
    """When an FMU for model exchange wants to be in event mode next; None where it does not say."""

    next_event: float | None


def initialize(
    instance: Any, description: Any, values: Mapping[str, float], **experiment: float | None
) -> None:
    """Set start values and leave initialization mode.

    Args:
        instance: Of fmpy.
        description: Of the FMU.
        values: By name.
        experiment: `startTime`, `stopTime` [s], `tolerance`.
    """
    from fmpy.simulation import (
        apply_start_values,
        settable_in_initialization_mode,
        settable_in_instantiated,
    )

    left = dict(values)
    second = description.fmiVersion.startswith("2")
    if second:
        instance.setupExperiment(**experiment)
    left = apply_start_values(instance, description, left, settable=settable_in_instantiated)
    instance.enterInitializationMode(**{} if second else experiment)
    apply_start_values(instance, description, left, settable=settable_in_initialization_mode)
    instance.exitInitializationMode()


def enter_continuous_time(instance: Any, description: Any) -> FirstEvents:
    """Take an FMU for model exchange through its first events to continuous-time mode.

    Raises:
        FmuError: It wants to end.
    """
    second = description.fmiVersion.startswith("2")
    update = instance.newDiscreteStates if second else instance.updateDiscreteStates
    needed, ended, found = True, False, (False, 0.0)
    while needed and not ended:
        needed, ended, _, _, *found = update()
    if ended:
        raise FmuError("Model requested termination during initial event update.")
    instance.enterContinuousTimeMode()
    defined, time = found
    return FirstEvents(float(time) if defined else None)
