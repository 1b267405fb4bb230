"""`OpenedPart`: an instance of a part of a coupled system, and what it can do."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from enum import IntEnum, StrEnum
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.coupling.exchange_part import ExchangeSolver
from cosim.errors import FmuError, UnknownName, UsageError
from cosim.fmi.run.arrays import Element, Layout
from cosim.fmi.run.c_structures import Calls, Functions, Recorded
from cosim.fmi.run.description import Interface, abilities_of, asks_for_inputs, by_name, is_second
from cosim.fmi.run.instance import begin_initialization
from cosim.fmi.run.opened import OpenedFmu
from cosim.fmi.run.request import lost_state
from cosim.fmi.run.typed_values import REALS, is_continuous


class InputOrder(IntEnum):
    """The polynomial that a part takes for its inputs within a step."""

    CONSTANT, LINEAR = 0, 1
    CUBIC = 3


class Ability(StrEnum):
    """An ability of a part that a system may leave unused."""

    INTERPOLATION = "interpolation"  # of its inputs within a step
    RATES = "rates"  # derivatives of outputs
    ROLLBACK = "rollback"  # to a saved state
    DIRECTIONAL = "directional derivatives"
    EVENTS = "event mode"
    CO_SIMULATION = "co-simulation"  # of a file that has model exchange as well


def unused_abilities(
    parts: Collection[str], abilities: Mapping[str, str]
) -> dict[str, tuple[Ability, ...]]:
    """Return the abilities that texts such as "no rates, no rollback" switch off, by part.

    Raises:
        UnknownName, UsageError: A part or an ability does not exist, or a text is none.
    """
    example = "texts by part, e.g. {'motor': 'no rates'}"
    UsageError.reject("abilities", abilities, Mapping, example)
    found = dict[str, tuple[Ability, ...]]()
    known = {f"no {ability}": ability for ability in Ability}
    for name, text in abilities.items():
        UnknownName.reject("the system", "part", parts, name)
        UsageError.reject(f"abilities of part '{name}'", text, str, example)
        words = [word.strip() for word in text.split(",")]
        UnknownName.reject(f"part '{name}'", "ability to switch off", known, *words)
        found[name] = tuple(known[word] for word in words)
    return found


class OpenedPart:
    """An instance of a part, with what it can do and its connected variables.

    Args:
        name, path: Of the part and its file.
        inputs, outputs: Names of those that are connected.
        callback: Address of a C function that gives an FMU of version 3 its inputs within a step.
        unused: Abilities of the file that are not used.
    """

    def __init__(
        self,
        name: str,
        path: Path,
        inputs: Iterable[str],
        outputs: Iterable[str],
        callback: int,
        unused: Collection[Ability] = (),
    ) -> None:
        self.name, self.path = name, path
        interface = Interface.MODEL_EXCHANGE if Ability.CO_SIMULATION in unused else None
        self._fmu = fmu = OpenedFmu(path, interface)
        self.is_own = fmu.is_own
        if self.is_own and Ability.EVENTS not in unused and _exchanges(fmu):
            fmu.interface = Interface.MODEL_EXCHANGE
        self.description = fmu.description
        self.instance: Any = None
        self._explained: Callable[[Exception], FmuError] = lambda error: FmuError(str(error))
        self.solver: ExchangeSolver | None = None  # of a part for model exchange, while it runs
        self._callback = 0  # of it
        known, exchange = by_name(fmu.description), fmu.interface is Interface.MODEL_EXCHANGE
        self.abilities = abilities = abilities_of(fmu.description, fmu.interface)
        self.moving_inputs, self.inputs = _in_order([known[n] for n in inputs], is_continuous)
        self.moving_outputs, self.outputs = _in_order([known[n] for n in outputs])
        all_move = self.inputs == self.moving_inputs and self.outputs == self.moving_outputs
        order = int(getattr(abilities, "maxOutputDerivativeOrder", None) or 0)
        derivatives = order >= 1 and all(v.causality == "output" for v in self.moving_outputs)
        self.rates = (derivatives or exchange) and Ability.RATES not in unused
        self.saves = bool(abilities.canGetAndSetFMUstate)
        # what a part for model exchange changes at events only is the same within a step
        goes_back = self.saves or (exchange and not abilities.needsCompletedIntegratorStep)
        self.rolls_back = goes_back and Ability.ROLLBACK not in unused
        directional = Ability.DIRECTIONAL not in unused and all_move
        self.directional = bool(abilities.providesDirectionalDerivative) and directional
        self.order = InputOrder.CONSTANT
        interpolates = Ability.INTERPOLATION not in unused
        second = is_second(fmu.description)
        if interpolates and second and getattr(abilities, "canInterpolateInputs", False):
            self.order = InputOrder.CUBIC if self.is_own else InputOrder.LINEAR
        events = getattr(abilities, "hasEventMode", False) and Ability.EVENTS not in unused
        self.event_mode = exchange or (self.rolls_back and events)
        self.any_step = exchange or bool(abilities.canHandleVariableCommunicationStepSize)
        internal = getattr(abilities, "fixedInternalStepSize", None)
        self.internal_step = float(internal or 0.0)
        named = getattr(fmu.description.defaultExperiment, "stepSize", None)
        self.only_step = self.internal_step or float(named or 0.0)  # if it does not take any
        if exchange:
            if Ability.EVENTS in unused:
                raise UsageError(
                    f"part '{name}' is for model exchange, which always has event mode; leave 'no "
                    "event mode' out of its abilities"
                )
            self.order = InputOrder.CUBIC if interpolates else InputOrder.CONSTANT
            self._callback = callback if interpolates else 0
        elif self.event_mode:
            fmu.callback |= {"eventModeUsed": True, "earlyReturnAllowed": True}
        if not exchange and interpolates and self.is_own and asks_for_inputs(fmu.description):
            self.order = InputOrder.CUBIC
            references = Layout.of(self.moving_inputs).references
            fmu.callback["requiredIntermediateVariables"] = references
            fmu.callback["intermediateUpdate"] = callback

    @property
    def holds_inputs(self) -> bool:
        """Whether inputs that move stay as they are within each of its steps."""
        return bool(self.moving_inputs) and self.order is InputOrder.CONSTANT

    def close(self) -> None:
        """Free the instance and remove the unpacked files."""
        self._drop_solver()
        self._fmu.close()

    def _drop_solver(self) -> None:
        if self.solver:
            self.solver.close()
        self.solver = None

    def start(
        self, values: Mapping[str, float], *, scale: float, **experiment: float | None
    ) -> None:
        """Bring the instance to initialization mode.

        Args:
            values: Start values by name.
            scale: Usual end of the run, s; steps of a solver here are short beside it.
            experiment: `startTime`, `stopTime` [s], `tolerance`.
        """
        self._drop_solver()
        instance, self._explained = self._fmu.ready()
        if instance is not self.instance:
            self.instance, self.calls = instance, Calls(instance, self.description)
            self.lost_state = lost_state(instance, self.description)
            steady = [v for v in self.inputs if is_continuous(v)]
            self.given, self.shown, self.steady = (
                Recorded(instance, self.description, variables)
                for variables in (self.inputs, self.outputs, steady)
            )
            if not self.event_mode:
                self.steady = self.given
        found = {n: value for n, value in experiment.items() if value is not None}
        self._experiment = {**found, "stopTime": scale}
        begin_initialization(self.instance, self.description, values, **experiment)

    def explained(self, error: Exception) -> str:
        """Return what went wrong with the log of the part, whose name stands for its file."""
        return str(self._explained(error)).removeprefix(f"{self.path}: ")

    def leave_initialization(self) -> None:
        """Leave initialization mode; a part for model exchange gets a solver."""
        self.instance.exitInitializationMode()
        if self._fmu.interface is Interface.MODEL_EXCHANGE:
            self.solver = ExchangeSolver(
                self.instance,
                self.description,
                self.calls,
                inputs=self._callback,
                saves=self.saves,
                **self._experiment,
            )

    @property
    def functions(self) -> Functions:
        """The functions that the master calls."""
        return self.solver.functions if self.solver else self.calls.functions

    def function_name(self, field: bytes) -> str:
        """Return the name of a function that has failed, by its field."""
        own = self.solver.failed_function(field) if self.solver else field
        return self.calls.functions.named(own)

    def feeds(self) -> NDArray[np.int64]:
        """Return whether each output depends at once on each input, (outputs, inputs)."""
        structure = {unknown.variable.name: unknown for unknown in self.description.outputs}
        found = np.ones((len(self.outputs), len(self.inputs)), dtype=np.int64)
        for row, output in zip(found, self.outputs, strict=True):
            unknown = structure.get(_whole(output).name)
            if unknown is not None and unknown.dependencies is not None:
                names = {variable.name for variable in unknown.dependencies}
                row[:] = [_whole(variable).name in names for variable in self.inputs]
        return found


def _exchanges(fmu: OpenedFmu) -> bool:
    """Tell whether the master integrates a file that was exported here for both interfaces.

    It does so with events of FMI 2.0, whose co-simulation has no event mode. What the file solves
    by implicit or fixed steps stays with its own solver.
    """
    description = fmu.description
    if not (is_second(description) and description.modelExchange and description.coSimulation):
        return False
    switches = any(
        v.variability == "discrete" and v.type in REALS for v in description.modelVariables
    )
    explicit = fmu.contains("sources/integration_dop853.c")
    return switches and (explicit or description.numberOfContinuousStates == 0)


def _in_order(
    variables: Iterable[Any], moves: Callable[[Any], bool] = lambda _: True
) -> tuple[list[Any], list[Any]]:
    """Return the variables that may have derivatives by time, real scalars, and then all others.

    Those that change at events only are the last.
    """
    ordered = sorted(variables, key=lambda variable: variable.name)
    real = [v for v in ordered if v.type in ("Real", "Float64") and not isinstance(v, Element)]
    moving = [v for v in real if moves(v)]
    others = [v for v in ordered if v not in moving]
    return moving, [*moving, *sorted(others, key=lambda v: not is_continuous(v))]


def _whole(variable: Any) -> Any:
    """Return the array of an element, or else the variable, as the model structure has it."""
    return variable.array if isinstance(variable, Element) else variable


@contextmanager
def explained(system: str, part: OpenedPart) -> Iterator[None]:
    """Name the part in the error of what goes wrong within."""
    try:
        yield
    except Exception as error:
        why = part.explained(error)
        raise FmuError(f"{system}: part '{part.name}': {why}") from error
