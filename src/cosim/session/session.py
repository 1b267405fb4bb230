"""`Session`: a model that stays alive: set inputs, advance, read, save, go back, branch."""

import hashlib
import struct
import uuid
import zlib
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from enum import StrEnum
from functools import cached_property
from math import isfinite, nan
from types import TracebackType
from typing import Any, NamedTuple, NoReturn, Self
from weakref import finalize

import numpy as np
from numpy.typing import ArrayLike

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.errors import FmuError, ParameterError, UnknownName, UsageError
from cosim.fmi.run.instance import by_name, initialize, is_number, unit_of, why_it_ended
from cosim.fmi.run.request import checked_values, output_names
from cosim.fmi.run.typed_values import typed_value
from cosim.fmi.units import units_for
from cosim.integrate.keywords import requested
from cosim.model.quantities import quantity
from cosim.model.values import listed, number, plain_values
from cosim.session.calls import FATAL, WARNING, Group, Jacobians, PreparedCalls, StateCalls
from cosim.session.opened_file import OpenedFile
from cosim.trajectory import Event

_HEAD = struct.Struct("<8s16s3d2q")  # magic, owner, time, begin, length, count, kept
_SUM, _MAGIC = struct.Struct("<I"), b"session1"
_LARGEST = 64  # requests of variables that are prepared at a time


class _Phase(StrEnum):
    RUNNING, ENDED, FAILED, CLOSED = "running", "ended", "failed", "closed"


class LinearSystem(NamedTuple):
    """Matrices of x' = A x + B u, y = C x + D u for small deviations from the present state."""

    A: Vector
    B: Vector
    C: Vector
    D: Vector


class Experiment(NamedTuple):
    """What an FMU learns of a run: times in s and tolerance, by the names of fmpy."""

    startTime: float  # noqa: N815
    stopTime: float | None  # noqa: N815
    tolerance: float | None


class Session:
    """A model that stays alive; open one with `cosim.open`. One thread at a time may use it.

    Values are in SI units; those of an FMU from elsewhere are in its own units.

    Attributes:
        name: Of the model, or the path of the FMU.
        inputs, outputs: Names of the inputs and outputs.
        states: Names of the continuous states, in the order of `linearize`.

    Example:
        >>> import cosim
        >>> with cosim.open("crank_shaft", start_values={"omega": 10.0}) as shaft:
        ...     events = shaft.advance(to=1.0)  # alpha is 10 rad/s2
        ...     round(shaft["omega"], 6)
        20.0
    """

    def __init__(
        self,
        file: OpenedFile,
        values: Mapping[str, float | str],
        experiment: Experiment,
        dae: Dae | None = None,
    ) -> None:
        self.name, self._file, self._dae = file.name, file, dae
        self._experiment, self._own = experiment, uuid.uuid4().bytes
        self._description = description = file.description
        self._variables = by_name(description)
        every = [v for v in description.modelVariables if is_number(v)]
        self._inputs = [v for v in every if v.causality == "input"]
        self._rates = [item.variable for item in description.derivatives]
        self.inputs = tuple(v.name for v in self._inputs)
        self.outputs = tuple(output_names(self.name, self._variables, None))
        self.states = tuple(rate.derivative.name for rate in self._rates)
        facts = f"{description.guid} {description.modelName} {description.fmiVersion}"
        self._identity = hashlib.sha256(facts.encode()).digest()[:16]
        self._start_values = self._checked(values)
        self._stack, self._used = ExitStack(), False
        finalize(self, self._stack.close)
        self._begin(self._start_values, experiment)

    # -- life ---------------------------------------------------------------------------------

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: object, trace: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"session of {self.name} at {self._time:.12g} s, {self._phase}"

    def close(self) -> None:
        """Free the model; nothing but `close` may be called afterwards."""
        self._phase = _Phase.CLOSED
        self._stack.close()

    def _begin(self, values: Mapping[str, Any], experiment: Experiment) -> None:
        """Take a fresh or reset instance through its initialization."""
        self._phase = _Phase.FAILED
        self._reason = "its initialization failed"
        if not hasattr(self, "_calls") or not self._file.is_own:
            self._renew()
        try:
            if self._used:
                self._instance.reset()
            self._used = True
            self._events.clear()
            initialize(self._instance, self._description, values, **experiment._asdict())
        except Exception as error:
            raise self._explained(error) from error
        self._time = self._first = experiment.startTime
        self._length, self._count = nan, 0  # of equal steps in succession
        self._phase = _Phase.RUNNING

    def _renew(self) -> None:
        """Replace the instance by a new one."""
        self._stack.close()
        for prepared in ("_states", "_kept"):
            vars(self).pop(prepared, None)
        self._instance, self._explain = self._file.instance(self._stack)
        self._events: list[tuple[float, str]] = self._instance.logged_events
        self._calls = PreparedCalls(self._instance, self._description)
        self._used = False
        self._selections: dict[Any, list[Group]] = {}
        self._setters: dict[str, tuple[Any, Group]] = {}
        self._jacobians: dict[Any, tuple[Jacobians, Jacobians]] = {}

    def reset(
        self,
        start_values: Mapping[str, float | str] | None = None,
        *,
        start_time: float | None = None,
    ) -> None:
        """Begin again.

        Args:
            start_values: Values by name that replace those of `cosim.open` for this time.
            start_time: s; that of `cosim.open` when None.

        Raises:
            UnknownName, UsageError, ParameterError, InitialConditionError: A name or a value does
                not fit; the session stays as it was.
            FmuError: The initialization failed, or the session is closed.
        """
        self._reject_closed()
        values = self._start_values | self._checked(start_values or {})
        experiment = self._experiment
        if start_time is not None:
            start = number(self.name, "start_time", start_time)
            experiment = experiment._replace(startTime=start)
        self._begin(values, experiment)

    def copy(self) -> "Session":
        """Return another session of the model in the present state.

        Raises:
            FmuError: The FMU cannot write its state as bytes, or allows one instance only.
        """
        self._require()
        abilities = self._description.coSimulation
        if abilities.canBeInstantiatedOnlyOncePerProcess:
            raise FmuError(f"{self.name} allows one instance in a process; it cannot be copied")
        if not self._serializes:
            raise FmuError(
                f"{self.name} cannot write its state as bytes; it cannot be copied, but go back "
                "with save and restore"
            )
        other = Session(self._file, self._start_values, self._experiment, self._dae)
        other.restore(self.save())
        other._events[:] = self._events
        return other

    # -- running ------------------------------------------------------------------------------

    @property
    def time(self) -> float:
        """The present time, s."""
        return self._time

    @property
    def stop(self) -> str | None:
        """Why the model has ended the run; None if it has not."""
        return self._reason if self._phase is _Phase.ENDED else None

    def advance(self, step: float | None = None, *, to: float | None = None) -> tuple[Event, ...]:
        """Integrate with constant inputs.

        Equal steps in succession end at first time + n * step, so that rounding does not add up.

        Args:
            step: Length, s; 0 does nothing.
            to: Time to reach, s, in place of a length.

        Returns:
            The events within the step, without their values. If one of them ends the run, `time`
            is the time of it, and `stop` says why.

        Raises:
            ParameterError: A time is not finite, or before the present one.
            UsageError: None or both of the arguments are given.
            FmuError: The model failed, ended the run before, or is closed. After a failure,
                `restore` and `reset` lead on.
        """
        if self._phase is not _Phase.RUNNING:
            self._require()
        time, log = self._time, self._instance.log_texts
        if log:
            log.clear()
        if to is None and step == self._length:
            first, count = self._first, self._count + 1
            target = first + count * self._length
        else:
            first, count = time, 1
            target = self._target(step, to)
            if target == time:
                return ()
        try:
            status, reached, ends = self._calls.step(time, target - time)
        except FmuError as error:
            self._fail(self._explained(error))
        if status > WARNING:
            self._fail(self._failure(status, "DoStep"))
        if ends:
            self._phase, self._time = _Phase.ENDED, reached
            self._reason = why_it_ended(log)
        else:
            self._time, self._first, self._count = target, first, count
            self._length = nan if step is None else float(step)
        if not self._events:
            return ()
        found = tuple(Event(at, name, {}, {}) for at, name in self._events)
        self._events.clear()
        return found

    def _target(self, step: float | None, to: float | None) -> float:
        """Return the time to reach, s."""
        if (step is None) == (to is None):
            raise UsageError(f"{self.name}: advance takes a step or a time to reach; give one")
        if to is not None:
            target = number(self.name, "to", to)
            if target < self._time:
                raise ParameterError(
                    f"{self.name}: to = {target:.12g} s is before the present time "
                    f"{self._time:.12g} s; go back with restore or reset"
                )
            return target
        length = number(self.name, "step", step)
        if length < 0:
            raise ParameterError(
                f"{self.name}: step = {length:g} s goes backwards; go back with restore or reset"
            )
        target = self._time + length
        if length > 0 and target == self._time:
            raise ParameterError(
                f"{self.name}: step = {length:g} s is too short at {self._time:.12g} s to change "
                "the time; give a longer one"
            )
        return target

    # -- values -------------------------------------------------------------------------------

    def set(
        self, values: Mapping[str, float | str] | ArrayLike | None = None, /, **named: float | str
    ) -> None:
        """Set inputs, or parameters that may change during a run.

        Args:
            values: Values by name, or of all `inputs` in their order, (n,).
            named: Numbers, or texts with a unit, by name.

        Raises:
            UnknownName, UsageError, ParameterError: A variable does not exist or cannot be set, or
                a value does not fit; then nothing is set.
            FmuError: The model rejects a value, has ended or failed, or is closed.
        """
        if self._phase is not _Phase.RUNNING:
            self._require()
        if values is not None:
            named = {**self._by_name(values), **named}
        found = []
        for name, value in named.items():
            variable, group = self._setters.get(name) or self._setter(name)
            if type(value) is not float or not isfinite(value):
                value = self._plain(variable, value)
            found.append((group, value))
        for group, plain in found:
            group.buffer[0] = plain
            status = group.set()
            if status > WARNING:
                self._check(status, "Set")

    def _by_name(self, values: Any) -> dict[str, Any]:
        if isinstance(values, Mapping):
            return dict(values)
        row = values.tolist() if isinstance(values, np.ndarray) else values
        if isinstance(row, str) or not isinstance(row, Sequence) or len(row) != len(self.inputs):
            what = f"its {len(self.inputs)} inputs {', '.join(self.inputs)}" if self.inputs else ""
            raise UsageError.of_type(
                f"{self.name}: set", values, f"values by name, or one for each of {what or 'none'}"
            )
        return dict(zip(self.inputs, row, strict=True))

    def _setter(self, name: str) -> tuple[Any, Group]:
        """Return a variable that may be set during a run, with its prepared call."""
        variable = self._variables.get(name)
        settable = [v for v in self._variables.values() if _may_change(v)]
        if variable is None:
            raise UnknownName.among(self.name, "input", name, [v.name for v in settable])
        if not _may_change(variable):
            shown = ", ".join(self.inputs) or "no inputs"
            raise UsageError(
                f"{self.name}: {name} cannot be set during a run, which takes {shown} and tunable "
                "parameters; give it to reset(start_values=...)"
            )
        found = variable, self._calls.groups([variable])[0]
        self._setters[name] = found
        return found

    def _plain(self, variable: Any, value: Any) -> Any:
        """Return a value in the variable's unit and type."""
        numeric = variable.type not in ("Boolean", "Enumeration")
        if isinstance(value, str) and numeric:
            units = units_for(variable, self._description)
            value = quantity(variable.name, value, unit_of(variable) or "1", definitions=units)
        return typed_value(self.name, variable, value)

    def __getitem__(self, name: str) -> float:
        return float(self.get((name,))[0])

    def get(self, names: Sequence[str] | None = None) -> Vector:
        """Return values.

        Args:
            names: Of the variables; `outputs` when None.

        Returns:
            Their values, (n,).

        Raises:
            UnknownName, UsageError: A variable does not exist, or is not one number.
            FmuError: A value is not defined, or the session has failed or is closed.
        """
        if self._phase is not _Phase.RUNNING and self._phase is not _Phase.ENDED:
            self._require()
        key = tuple(names) if isinstance(names, list | tuple) else names
        groups = self._selections.get(key)
        if groups is None:
            groups = self._selection(key)
        if len(groups) == 1:
            status = groups[0].get()
            if status > WARNING:
                self._check(status, "Get")
            return groups[0].buffer.astype(float)  # a copy
        row = np.empty(sum(len(group.columns) for group in groups))
        for group in groups:
            self._check(group.get(), "Get")
            row[group.columns] = group.buffer
        return row

    def _selection(self, names: Any) -> list[Group]:
        """Prepare the calls that read variables."""
        chosen = self.outputs if names is None else listed(f"{self.name}: get", names)
        for name in chosen:
            if name not in self._variables:
                raise UnknownName.among(self.name, "variable", name, self._variables)
            if not is_number(self._variables[name]):
                raise UsageError(f"{self.name}: {name} is not a single number")
        if len(self._selections) >= _LARGEST:
            self._selections.clear()
        groups = self._calls.groups([self._variables[name] for name in chosen])
        self._selections[names if isinstance(names, tuple | None) else chosen] = groups
        return groups

    # -- states -------------------------------------------------------------------------------

    @property
    def _serializes(self) -> bool:
        return bool(self._description.coSimulation.canSerializeFMUstate)

    @cached_property
    def _states(self) -> StateCalls:
        if not self._description.coSimulation.canGetAndSetFMUstate:
            raise FmuError(f"{self.name} cannot save its state; begin again with reset")
        found = StateCalls(self._calls, self._check)
        self._kept: list[Any] = []
        self._stack.callback(_free, self._instance, found, self._kept)
        return found

    def save(self) -> bytes:
        """Return the state of the session, for `restore`.

        If the FMU writes its state as bytes, as every model does, they outlive the session and
        hold for other sessions of the same model; otherwise for this session until it is closed
        or an FMU from elsewhere is reset.

        Raises:
            FmuError: The FMU cannot save its state, or the session has ended, failed or is closed.
        """
        if self._phase is not _Phase.RUNNING:
            self._require()
        states, kept, content = self._states, 0, b""
        if self._serializes:
            owner, content = self._identity, states.save()
        else:
            owner = self._own
            self._kept.append(states.keep())
            kept = len(self._kept)
        facts = (self._time, self._first, self._length, self._count, kept)
        whole = _HEAD.pack(_MAGIC, owner, *facts) + content
        return _SUM.pack(zlib.crc32(whole)) + whole

    def restore(self, saved: bytes) -> None:
        """Go back, or forward, to a saved state; also after a failure or the end of the run.

        Raises:
            UsageError: The bytes are no saved state of this model, or damaged.
            FmuError: The FMU rejects the state, or the session is closed.
        """
        self._reject_closed()
        if not isinstance(saved, bytes):
            raise UsageError.of_type(f"{self.name}: restore", saved, "what save has returned")
        whole = saved[_SUM.size :]
        if len(whole) < _HEAD.size or _SUM.unpack_from(saved)[0] != zlib.crc32(whole):
            raise UsageError(f"{self.name}: these bytes are no saved session, or damaged")
        magic, owner, *clock, kept = _HEAD.unpack_from(whole)
        expected = self._identity if self._serializes else self._own
        if magic != _MAGIC or owner != expected:
            what = "model" if self._serializes else "session, as its FMU writes no state as bytes"
            raise UsageError(f"{self.name}: these bytes were saved by another {what}")
        if self._serializes:
            self._states.restore(whole[_HEAD.size :])
        else:
            states, held = self._states, self._kept
            if kept > len(held):
                raise UsageError(f"{self.name}: this state was freed by a reset; save it anew")
            states.go_back(held[kept - 1])
        self._time, self._first, self._length, self._count = clock
        self._events.clear()
        self._phase = _Phase.RUNNING

    def linearize(self, outputs: Sequence[str] | None = None) -> LinearSystem:
        """Return A, B, C, D at the present state, by directional derivatives of the FMU.

        Between events; `cosim.linearize` also gives the discrete map of samples.

        Args:
            outputs: Names of y; `outputs` of the session when None.

        Returns:
            The matrices; rows and columns as in `states`, `inputs` and the outputs.

        Raises:
            UnknownName: An output does not exist.
            UsageError: The model has samples, an input is no real number.
            FmuError: The FMU has no directional derivatives, or they have no value here.
        """
        self._require()
        key = tuple(outputs) if isinstance(outputs, list | tuple) else outputs
        if key not in self._jacobians:
            self._jacobians[key] = self._prepared_jacobians(key)
        of_rates, of_outputs = self._jacobians[key]
        for jacobian in (of_rates, of_outputs):
            self._check(jacobian.evaluate(), "GetDirectionalDerivative")
        n, upper, lower = len(self.states), of_rates.values.T, of_outputs.values.T
        parts = upper[:, :n], upper[:, n:], lower[:, :n], lower[:, n:]
        return LinearSystem(*(part.copy() for part in parts))

    def _prepared_jacobians(self, outputs: Any) -> tuple[Jacobians, Jacobians]:
        if self._dae is not None and any(event.sampled for event in self._dae.events):
            raise UsageError(
                f"{self.name} has samples, which change its state at instants; use "
                "cosim.linearize, which gives the discrete map from sample to sample"
            )
        if not self._description.coSimulation.providesDirectionalDerivative or not self._rates:
            raise FmuError(
                f"{self.name} has no directional derivatives by its states; compare steps from a "
                "saved state instead"
            )
        names = self.outputs if outputs is None else listed(f"{self.name}: linearize", outputs)
        shown = output_names(self.name, self._variables, names) if names else []
        knowns = [*(rate.derivative for rate in self._rates), *self._inputs]
        for v in self._inputs:
            if v.type not in ("Real", "Float64"):
                raise UsageError(f"{self.name}: the input {v.name} is no real number")
        unknowns = [self._variables[name] for name in shown]
        return (
            Jacobians(self._calls, self._rates, knowns),
            Jacobians(self._calls, unknowns, knowns),
        )

    # -- checks and failures ------------------------------------------------------------------

    def _checked(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return start values by the names of the FMU, in its units."""
        if not isinstance(values, Mapping):
            raise UsageError.of_type(
                f"{self.name}: start_values", values, "values by name, e.g. {'phi': 1}"
            )
        if self._dae is not None and values:
            request = requested(self._dae, start_values=values)
            values = plain_values(self._dae, request.values)
        elif values:
            known = self._variables
            values = {
                n: self._plain(known[n], v) if isinstance(v, str) and n in known else v
                for n, v in values.items()
            }
        return checked_values(self.name, self._variables, values)

    def _failure(self, status: int, function: str) -> FmuError:
        from fmpy.fmi1 import FMICallException

        if status == FATAL:
            self._instance.is_fatal = True
        prefix = f"fmi{2 if self._calls.second else 3}"
        error = self._explained(FMICallException(function=f"{prefix}{function}", status=status))
        self._instance.log_texts.clear()
        return error

    def _explained(self, error: Exception) -> FmuError:
        found: FmuError = self._explain(error)
        return found

    def _check(self, status: int, function: str) -> None:
        """Raise the error of a status; one that is more than a rejection ends the run."""
        if status <= WARNING:
            return
        error = self._failure(status, function)
        if status > WARNING + 1:
            self._fail(error)
        raise error

    def _fail(self, error: FmuError) -> NoReturn:
        self._phase, self._reason = _Phase.FAILED, str(error)
        self._events.clear()
        raise error

    def _require(self) -> None:
        """Reject a call that a running session alone answers."""
        self._reject_closed()
        if self._phase is _Phase.FAILED:
            raise FmuError(f"{self.name}: the session has failed; go on with restore or reset")
        if self._phase is _Phase.ENDED:
            raise FmuError(
                f"{self.name}: the run has ended at {self._time:.12g} s ({self._reason}); go on "
                "with restore or reset"
            )

    def _reject_closed(self) -> None:
        if self._phase is _Phase.CLOSED:
            raise FmuError(f"{self.name}: the session is closed; open it again")
        if getattr(self._instance, "is_fatal", False):
            raise FmuError(f"{self.name}: the FMU has reported a fatal error; open it again")


def _free(instance: Any, states: StateCalls, kept: list[Any]) -> None:
    """Free saved states, unless nothing of the FMU may be called any more."""
    if not getattr(instance, "is_fatal", False):
        states.free(*kept)


def _may_change(variable: Any) -> bool:
    """Tell whether a variable may be set between steps."""
    tunable = variable.causality == "parameter" and variable.variability == "tunable"
    return is_number(variable) and (variable.causality == "input" or tunable)
