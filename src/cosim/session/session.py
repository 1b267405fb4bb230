"""`Session`: a model that stays alive: set inputs, advance, read, save, go back, branch."""

import ctypes
import hashlib
import uuid
from collections.abc import Mapping, Sequence
from functools import cached_property
from operator import attrgetter
from typing import Any, NoReturn

from numpy.typing import ArrayLike

from casadi_models.dae import Dae, Start
from cosim.arrays import Vector
from cosim.errors import FmuError, ParameterError, UsageError, naming_arguments
from cosim.fmi.run.description import by_name
from cosim.fmi.run.instance import initialize, why_it_ended
from cosim.fmi.run.opened import OpenedFmu
from cosim.fmi.run.request import checked_values, lost_state, output_names, state_names
from cosim.integrate.keywords import requested
from cosim.model.times import reject_span
from cosim.model.values import listed, plain_values
from cosim.session.calls import FATAL, WARNING, PreparedCalls, StateCalls, free_states
from cosim.session.clock import Clock
from cosim.session.life import RUNNING, Life, Phase
from cosim.session.linearizer import Linearizer, LinearSystem
from cosim.session.restart import Experiment, Restart
from cosim.session.saved import ClockFacts, damaged, notes_of, packed, take_notes, unpacked
from cosim.session.values import Values, finite, inputs_of, plain_value
from cosim.trajectory import Event

_LARGEST = 64  # resets that are prepared


class Session(Life):
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
        file: OpenedFmu,
        values: Mapping[str, float | str],
        experiment: Experiment,
        dae: Dae | None = None,
    ) -> None:
        super().__init__(str(file.path), values)
        self._file = file
        self._dae = dae
        self._experiment = experiment
        self._description = description = file.description
        self._variables = by_name(description)
        self.inputs = tuple(v.name for v in inputs_of(description))
        found = output_names(self.name, self._variables, None)
        if dae is not None and {*found} == {*dae.observed}:
            found = [*dae.observed]  # as in runs and copies; a file lists the states first
        self.outputs = tuple(found)
        self.states = tuple(state_names(description))
        abilities = description.coSimulation
        self._serializes = bool(abilities.canSerializeFMUstate)
        # s; 0 before the first one, None if they may differ
        self._only_step = None if abilities.canHandleVariableCommunicationStepSize else 0.0
        self._owner = self.identity() if self._serializes else uuid.uuid4().bytes
        self._used = False
        self._begin_at(self._start_values)

    def identity(self) -> bytes:
        """Return what tells the session from those whose states it cannot take."""
        one, tolerance = self._description, self._experiment.tolerance
        facts = one.guid, one.modelName, one.fmiVersion, tolerance  # which a state brings along
        return hashlib.sha256(repr(facts).encode()).digest()[:16]

    def _begin_at(self, given: Mapping[str, Any], start: float | None = None) -> None:
        """Take a fresh or reset instance through its initialization."""
        experiment = self._experiment
        if start is not None:
            experiment = experiment._replace(startTime=start)
            if experiment.stopTime is not None:
                reject_span(start, experiment.stopTime, f"{self.name}: ")
        restart = self._restarts.get(tuple(given)) if self._used else None
        if restart is not None and not restart.accepts(given):
            restart = None
        values = self.checked(given) if restart is None else {}
        self._phase = Phase.FAILED
        if not self._used or not self._file.is_own:
            self._renew()
        try:
            self._events.clear()
            self._instance.logged.violations.clear()
            if restart is not None:
                self._check(*restart.run(given, experiment))
            else:
                if self._used:
                    self._instance.reset()
                initialize(self._instance, self._description, values, **experiment._asdict())
                self._prepare_restart(given)
        except FmuError:
            raise
        except Exception as error:
            raise self._explained(error) from error
        finally:
            self._used = True
        self._clock = Clock(experiment.startTime, experiment.startTime)
        self._phase = Phase.RUNNING

    def _renew(self) -> None:
        """Replace the instance by a new one."""
        self._used = False
        self._stack.close()
        vars(self).pop("_states", None)
        self._instance, self._explained = self._file.instance(self._stack)
        self._events: list[tuple[float, str]] = self._instance.logged.events
        self._calls = PreparedCalls(self._instance, self._description)
        # one that was exported here rejects a step to such a state
        is_own = self._file.is_own
        self._lost_state = None if is_own else lost_state(self._instance, self._description)
        self._values = Values(self.name, self._description, self._calls, self._check)
        self._linearizers: dict[Any, Linearizer] = {}
        self._restarts: dict[tuple[str, ...], Restart] = {}

    def _prepare_restart(self, given: Mapping[str, Any]) -> None:
        """Prepare a reset with values of these names, if each value can be checked on its own."""
        dae = self._dae
        if dae is None or len(self._restarts) >= _LARGEST:
            return
        plain = {v.name: v for v in (*dae.states, *dae.inputs) if v.start_kind is Start.EXACT}
        if plain.keys() >= given.keys():
            bounds = {name: (plain[name].minimum, plain[name].maximum) for name in given}
            variables = [self._variables[name] for name in given]
            self._restarts[tuple(given)] = Restart(self._calls, variables, bounds)

    def copy(self) -> "Session":
        """Return another session of the model in the present state.

        Raises:
            FmuError: The FMU cannot write its state as bytes, or allows one instance only.
        """
        self._reject_copy([self._description.coSimulation], serializes=self._serializes)
        other = Session(self._file, self._start_values, self._experiment, self._dae)
        other.restore(self.save())
        return other

    @property
    def invalid(self) -> str | None:
        """The first validity condition that steps violated, and since when; None if none did.

        Models and FMUs that were exported here tell it, other FMUs do not.
        """
        return min(self._instance.logged.violations, key=attrgetter("time"), default=None)

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
            ParameterError: A time is not finite, or before the present one; or the FMU takes steps
                of one length only, and this one differs from the first.
            UsageError: None or both of the arguments are given.
            FmuError: The model failed, ended the run before, or is closed. After a failure,
                only `restore` and `reset` are possible.
        """
        if self._phase is not RUNNING:
            self._require()
        clock = self._clock
        time = clock.now
        log = self._instance.logged.texts
        if log:
            log.clear()
        target = clock.target(self.name, step, to)
        if target == time:
            return ()
        if self._only_step is not None:
            self._reject_other_step(time, target)
        try:
            status, reached, ends = self._calls.step(time, target - time)
        except FmuError as error:
            self._fail(self._explained(error))
        if status > WARNING:
            self._fail(self._failure(status, "DoStep"))
        if ends:
            self._phase, clock.now = Phase.ENDED, reached
            self._reason = why_it_ended(log)
        else:
            clock.reach(target, step)
            if self._lost_state and (lost := self._lost_state()):
                self._fail(
                    FmuError(f"{self.name}: its state {lost} is not finite at {target:.12g} s")
                )
        if not self._events:
            return ()
        found = tuple(Event(at, name, {}, {}) for at, name in self._events)
        self._events.clear()
        return found

    def _reject_other_step(self, time: float, target: float) -> None:
        length = target - time
        self._only_step = self._only_step or length
        if abs(length - self._only_step) > 1e-9 * max(abs(target), length):  # more than rounding
            raise ParameterError(
                f"{self.name}: it takes steps of one length only, which has been "
                f"{self._only_step:g} s, not {length:g} s; keep to it, or open the FMU again"
            )

    def set(
        self, values: Mapping[str, float | str] | ArrayLike | None = None, /, **named: float | str
    ) -> None:
        """Set inputs, or parameters that may change during a run.

        Results that are read next are on the sides that these values require, as of a limit in an
        output; events happen at the start of the next step.

        Args:
            values: Values by name, or of all `inputs` in their order, (n,).
            named: Numbers, or texts with a unit, by name.

        Raises:
            UnknownName, UsageError, ParameterError: A variable does not exist or cannot be set, or
                a value does not fit; then nothing is set.
            FmuError: The model rejects a value, and nothing is set; or it has ended or failed, or
                is closed.
        """
        if self._phase is not RUNNING:
            self._require()
        self._values.set(values, named)

    def present(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return the values that `set` would replace, exactly, to be set again."""
        self._require()
        return self._values.present(values)

    def get(self, names: Sequence[str] | None = None) -> Vector:
        """Return values.

        Args:
            names: Of the variables; `outputs` when None.

        Returns:
            Their values, (n,).

        Raises:
            UnknownName, UsageError: A variable does not exist, or is not one number.
            FmuError: A value is not finite, or the session has failed or is closed.
        """
        if self._phase is not RUNNING and self._phase is not Phase.ENDED:
            self._require()
        chosen = self.outputs if names is None else names
        if type(chosen) is not tuple:  # which takes a third of the time of reading few values
            chosen = listed(f"{self.name}: get", chosen)
        found = self._values.get(chosen)
        return found if self._lost_state is None else finite(self.name, chosen, found, self.time)

    @cached_property
    def _states(self) -> StateCalls:
        if not self._description.coSimulation.canGetAndSetFMUstate:
            raise FmuError(f"{self.name} cannot save its state; begin again with reset")
        is_own, serializes = self._file.is_own, self._serializes
        found = StateCalls(self._calls, self._check, is_own=is_own, serializes=serializes)
        self._stack.callback(free_states, self._instance, found.free, found.saved)
        return found

    def save(self) -> bytes:
        """Return the state of the session, for `restore`.

        If the FMU writes its state as bytes, as every model does, they outlive the session and
        hold for other sessions of the same model with the same tolerance; otherwise for this
        session until it is closed or an FMU from elsewhere is reset.

        Raises:
            FmuError: The FMU cannot save its state, or the session has ended, failed or is closed.
        """
        if self._phase is not RUNNING:
            self._require()
        content = self._states.save()
        notes = b""
        if self._events or self._instance.logged.violations:
            notes = notes_of([self._instance])
        facts = self._clock.facts
        return packed(self._owner, facts, notes, content, has_sum=self._file.is_own)

    def restore(self, saved: bytes) -> None:
        """Go back, or forward, to a saved state; also after a failure or the end of the run.

        Raises:
            UsageError: The bytes are no saved state of this model, or damaged.
            FmuError: The FMU rejects the state, or the session is closed.
        """
        clock, notes, size = self.checked_state(saved)
        if not self._states.restore(saved, size):
            self._instance.logged.texts.clear()
            raise damaged(self.name)
        self._clock.facts = clock
        if notes or self._events or self._instance.logged.violations:
            take_notes([self._instance], notes)
        self._phase = Phase.RUNNING

    def checked_state(self, saved: bytes) -> tuple[ClockFacts, bytes, int]:
        """Return clock, notes and size of a saved state that is one of this session.

        Raises:
            UsageError, FmuError: See `restore`.
        """
        if self._phase is not RUNNING:
            self._reject_closed()
        if not self._used:
            raise FmuError(f"{self.name}: the session has not begun; begin again with reset")
        owner, clock, notes, size = unpacked(self.name, saved, has_sum=self._file.is_own)
        if owner != self._owner:
            what = "session, as its FMU writes no state as bytes"
            if self._serializes:
                what = "model, or with another relative_tolerance"
            raise UsageError(f"{self.name}: these bytes were saved by another {what}")
        if not self._states.holds(saved):
            raise UsageError(f"{self.name}: this state was freed by a reset; save it anew")
        return clock, notes, size

    @naming_arguments
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
            InitialConditionError: A derivative of a model is another one on each side of the state.
        """
        self._require()
        key = tuple(outputs) if isinstance(outputs, list) else outputs
        found = self._linearizers.get(key) if isinstance(key, tuple | None) else None
        if found is None:
            self._reject_samples()
            names = self.outputs if key is None else key
            found = Linearizer(self.name, self._description, self._calls, names, self._dae)
            self._linearizers[found.outputs if key is not None else None] = found
        self._check(found.evaluate(), "GetDirectionalDerivative")
        found.reject_corner(self.time, self.get)
        return found.system()

    def _reject_samples(self) -> None:
        if self._dae is not None and any(event.sampled for event in self._dae.events):
            raise UsageError(
                f"{self.name} has samples, which change its state at instants; use "
                "cosim.linearize, which gives the discrete map from sample to sample"
            )

    def checked(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return start values by the names of the FMU, in its units.

        Raises:
            UnknownName, UsageError, ParameterError, InitialConditionError: See `reset`.
        """
        UsageError.reject(
            f"{self.name}: start_values", values, Mapping, "values by name, e.g. {'phi': 1}"
        )
        if self._dae is not None and values:
            request = requested(self._dae, start_values=values)
            values = plain_values(self._dae, request.values)
        elif values:
            known = self._variables
            for name in known.keys() & values.keys():
                if known[name].causality == "structuralParameter":
                    raise UsageError(
                        f"{self.name}: {name} gives sizes of arrays, which a session takes from "
                        "the file; leave it out"
                    )
            values = {
                name: plain_value(self.name, self._description, known[name], value)
                if name in known
                else value
                for name, value in values.items()
            }
        return checked_values(self.name, self._variables, values)

    def _failure(self, status: int, function: str) -> FmuError:
        from fmpy.fmi1 import FMICallException

        if status == FATAL:
            self._instance.fatal.value = True
        prefix = f"fmi{2 if self._calls.second else 3}"
        signed = ctypes.c_int(status).value
        error = self._explained(FMICallException(function=f"{prefix}{function}", status=signed))
        self._instance.logged.texts.clear()
        return error

    def _check(self, status: int, function: str) -> None:
        """Raise the error of a status; one that is more than a rejection ends the run."""
        if status <= WARNING:
            return
        error = self._failure(status, function)
        if status > WARNING + 1:
            self._fail(error)
        raise error

    def _fail(self, error: FmuError) -> NoReturn:
        self._phase, self._reason = Phase.FAILED, str(error)
        self._events.clear()
        raise error

    def _reject_closed(self) -> None:
        super()._reject_closed()
        if self._instance.fatal.value:
            raise FmuError(f"{self.name}: the FMU has reported a fatal error; open it again")
