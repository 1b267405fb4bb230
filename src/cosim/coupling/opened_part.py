"""`OpenedPart`: an instance of a part of a coupled system, and what it can do."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.errors import FmuError
from cosim.fmi.run.c_structures import Calls
from cosim.fmi.run.instance import (
    Interface,
    asks_for_inputs,
    begin_initialization,
    by_name,
    is_second,
)
from cosim.fmi.run.opened import OpenedFmu
from cosim.fmi.trust import is_made_here


class InputOrder(IntEnum):
    """The polynomial that a part takes for its inputs within a step."""

    CONSTANT, LINEAR = 0, 1
    CUBIC = 3


class OpenedPart:
    """An instance of a part, with what it can do and its connected variables.

    Args:
        name, path: Of the part and its file.
        inputs, outputs: Names of those that are connected.
        callback: Address of a C function that gives an FMU of version 3 its inputs within a step.
    """

    def __init__(
        self, name: str, path: Path, inputs: Sequence[str], outputs: Sequence[str], callback: int
    ) -> None:
        self.name, self.path = name, path
        self._fmu = fmu = OpenedFmu(path, Interface.CO_SIMULATION)
        fmu.reset_is_enough = is_made_here(path)
        self.description = fmu.description
        self.instance: Any = None
        self.explained: Callable[[Exception], FmuError] = lambda error: FmuError(str(error))
        known, abilities = by_name(fmu.description), fmu.description.coSimulation
        self.inputs = [known[name] for name in inputs]
        self.outputs = [known[name] for name in outputs]
        derivatives = int(abilities.maxOutputDerivativeOrder or 0) >= 1
        self.rates = derivatives and all(v.causality == "output" for v in self.outputs)
        self.rolls_back = bool(abilities.canGetAndSetFMUstate)  # fmpy's name in FMI 3, too
        self.directional = bool(abilities.providesDirectionalDerivative)
        self.order = InputOrder.CONSTANT
        if is_second(fmu.description) and abilities.canInterpolateInputs:
            self.order = InputOrder.CUBIC if fmu.reset_is_enough else InputOrder.LINEAR
        self.event_mode = self.rolls_back and getattr(abilities, "hasEventMode", False)
        if self.event_mode:
            fmu.callback |= {"eventModeUsed": True, "earlyReturnAllowed": True}
        if fmu.reset_is_enough and asks_for_inputs(fmu.description):
            self.order = InputOrder.CUBIC
            references = [variable.valueReference for variable in self.inputs]
            fmu.callback["requiredIntermediateVariables"] = references
            fmu.callback["intermediateUpdate"] = callback

    def close(self) -> None:
        """Free the instance and remove the unpacked files."""
        self._fmu.close()

    def start(self, values: Mapping[str, float], **experiment: float) -> None:
        """Bring the instance to initialization mode.

        Args:
            values: Start values by name.
            experiment: `startTime`, `stopTime` [s], `tolerance`.
        """
        instance, self.explained = self._fmu.ready()
        if instance is not self.instance:
            self.instance, self.calls = instance, Calls(instance, self.description)
        instance.logged_events.clear()
        instance.log_texts.clear()
        begin_initialization(self.instance, self.description, values, **experiment)

    def feeds(self) -> NDArray[np.int64]:
        """Return whether each output depends at once on each input, (outputs, inputs)."""
        structure = {unknown.variable.name: unknown for unknown in self.description.outputs}
        found = np.ones((len(self.outputs), len(self.inputs)), dtype=np.int64)
        for row, output in zip(found, self.outputs, strict=True):
            unknown = structure.get(output.name)
            if unknown is not None and unknown.dependencies is not None:
                names = {variable.name for variable in unknown.dependencies}
                row[:] = [variable.name in names for variable in self.inputs]
        return found


@contextmanager
def explained(system: str, part: OpenedPart) -> Iterator[None]:
    """Name the part in the error of what goes wrong within."""
    try:
        yield
    except Exception as error:
        why = part.explained(error)
        raise FmuError(f"{system}: part '{part.name}': {why}") from error
