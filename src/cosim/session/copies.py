"""`Copies`: many copies of a model that are advanced together."""

import io
import json
from collections.abc import Mapping, Sequence
from typing import Any, NoReturn, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike

from cosim.arrays import Integers, Truths, Vector, reals
from cosim.errors import FmuError, ParameterError, UsageError, naming_arguments_of
from cosim.model.values import listed
from cosim.session.clock import Clock
from cosim.session.saved import unpicklable
from cosim.trajectory import Event


class Engine(Protocol):
    """What advances the copies of a model.

    Attributes:
        name: Of the model.
        inputs, outputs, states: Names.
        reasons: Why copies have ended or failed, by number.
        invalid: The first violated validity condition of copies with its time, by number.
        owner: What tells the model from those whose states it cannot take.
    """

    name: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    states: tuple[str, ...]
    reasons: dict[int, str]
    invalid: dict[int, str]
    owner: str

    def begin(self, values: Mapping[str, Any], time: float, rows: Integers) -> None:
        """Begin copies again at a time, s, with values by name, (rows,) or texts with units."""

    def advance(self, time: float, target: float) -> dict[int, tuple[Event, ...]]:
        """Integrate from one time to another, s; return events by copy."""

    def set(self, values: Mapping[str, Any]) -> None:
        """Set inputs and tunable parameters: numbers, texts with units, or arrays (copies,)."""

    def get(self, names: tuple[str, ...], time: float) -> Vector:
        """Return values at the present time, s, (names, copies); NaN for copies that failed."""

    def save(self) -> dict[str, Vector]:
        """Return the state as arrays by name."""

    def fits(self, arrays: Mapping[str, Vector]) -> bool:
        """Tell whether arrays may be the saved state of as many copies of the model."""

    def restore(self, arrays: Mapping[str, Vector]) -> dict[int, str]:
        """Set a saved state, which fits; return why copies have failed whose FMUs reject theirs."""


@naming_arguments_of
class Copies:
    """Many copies of a model that are advanced together; open them with `cosim.open`.

    Copies share the time and differ in start values, inputs and parameters. A copy that fails does
    not disturb the others: its values are NaN until it is reset. One whose model ends its run keeps
    its last values.

    Attributes:
        name: Of the model.
        inputs, outputs, states: Names.

    Example:
        >>> import cosim
        >>> start = {"omega": [10.0, 20.0]}
        >>> with cosim.open("crank_shaft", copies=2, start_values=start) as shafts:
        ...     events = shafts.advance(to=1.0)  # alpha is 10 rad/s2
        ...     shafts["omega"].round(6).tolist()
        [20.0, 30.0]
    """

    def __init__(
        self, engine: Engine, count: int, values: Mapping[str, Any], start_time: float
    ) -> None:
        self._engine: Engine | None = engine  # none once closed
        self._count = count
        self.name = engine.name
        given = _given(self.name, values)
        self._start_values = {n: self._column(n, v, count) for n, v in given.items()}
        self._start_time = start_time
        self._clock = Clock(start_time, start_time)
        self.inputs, self.outputs, self.states = engine.inputs, engine.outputs, engine.states
        self.reset()
        for number, reason in engine.reasons.items():
            raise FmuError(f"copy {number}: {reason}")

    def __len__(self) -> int:
        return self._count

    __iter__ = None  # `get` returns values by copy

    def __enter__(self) -> Self:
        self._require()
        return self

    def __reduce__(self) -> NoReturn:
        raise unpicklable(self.name)

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"{self._count} copies of {self.name} at {self.time:.12g} s"

    def close(self) -> None:
        """Free the copies; nothing but `close` may be called afterwards."""
        self._engine = None

    @property
    def time(self) -> float:
        """The present time, s."""
        return self._clock.now

    @property
    def reasons(self) -> dict[int, str]:
        """Why copies have failed, or their models have ended the run, by number of the copy."""
        return dict(self._require().reasons)

    @property
    def invalid(self) -> dict[int, str]:
        """The validity condition that copies have left first, and since when, by their number."""
        return dict(self._require().invalid)

    @property
    def running(self) -> Truths:
        """Which copies `advance` goes on with, (copies,)."""
        going = np.ones(self._count, dtype=bool)
        going[list(self._require().reasons)] = False
        return going

    def reset(
        self,
        start_values: Mapping[str, ArrayLike | str] | None = None,
        *,
        only: ArrayLike | None = None,
    ) -> None:
        """Begin again. A copy whose FMU rejects its values has failed; `reasons` says why.

        Args:
            start_values: Values by name that replace those of `cosim.open` for this time: numbers,
                texts with a unit, or one number per copy that begins again.
            only: Numbers of the copies to begin again, or truth values, (copies,); they go on at
                the present time. All, at the start time, when None.

        Raises:
            UnknownName, UsageError, ParameterError, InitialConditionError: A name or a value does
                not fit; then no copy begins again.
        """
        engine = self._require()
        rows = self._rows(only)
        usual = {
            name: value if np.ndim(value) == 0 else value[rows]
            for name, value in self._start_values.items()
        }
        values = {
            name: self._column(name, value, len(rows))
            for name, value in {**usual, **_given(self.name, start_values or {})}.items()
        }
        start = self._start_time
        engine.begin(values, start if only is None else self.time, rows)
        if only is None:
            self._clock = Clock(start, start)

    def advance(
        self, step: float | None = None, *, to: float | None = None
    ) -> dict[int, tuple[Event, ...]]:
        """Integrate all running copies with constant inputs.

        Args:
            step: Length, s; 0 does nothing.
            to: Time to reach, s, in place of a length.

        Returns:
            The events within the step, without their values, by number of the copy; empty where
            none had one.

        Raises:
            ParameterError: A time is not finite, or before the present one.
            UsageError: None or both of the arguments are given, or the copies are closed.
        """
        engine = self._require()
        target = self._clock.target(self.name, step, to)
        if target == self.time:
            return {}
        events = engine.advance(self.time, target)
        self._clock.reach(target, step)
        return events

    def set(
        self, values: Mapping[str, Any] | ArrayLike | None = None, /, **named: ArrayLike | str
    ) -> None:
        """Set inputs, or parameters that may change during a run.

        Args:
            values: Values by name, or of all `inputs` in their order, (inputs, copies).
            named: Numbers or texts with a unit for all copies, or one number for each, (copies,).

        Raises:
            UnknownName, UsageError, ParameterError: A variable does not exist or cannot be set, or
                a value does not fit; then nothing is set.
        """
        engine = self._require()
        if values is not None and not isinstance(values, Mapping):
            table = np.asarray(values)
            if table.shape != (len(self.inputs), self._count):
                raise UsageError(
                    f"{self.name}: set takes values by name, or an array of {len(self.inputs)} "
                    f"inputs and {self._count} copies; this one has the shape {table.shape}"
                )
            values = dict(zip(self.inputs, table, strict=True))
        every = {**(values or {}), **named}
        engine.set({name: self._column(name, v, self._count) for name, v in every.items()})

    def __getitem__(self, name: str) -> Vector:
        found: Vector = self.get((name,))[0]
        return found

    def get(self, names: Sequence[str] | None = None) -> Vector:
        """Return values.

        Args:
            names: Of the variables; `outputs` when None.

        Returns:
            Their values, (names, copies); NaN for copies that have failed.

        Raises:
            UnknownName, UsageError: A variable does not exist, or is not one number.
        """
        engine = self._require()
        chosen = self.outputs if names is None else listed(f"{self.name}: get", names)
        return engine.get(chosen, self.time)

    def save(self) -> bytes:
        """Return the state of all copies, for `restore` of as many copies of the same model.

        Sessions whose runs have ended are saved without their values, which are NaN afterwards.
        """
        content = io.BytesIO()
        engine = self._require()
        facts = engine.owner, self._clock.facts, engine.reasons, engine.invalid
        arrays: dict[str, Any] = {"facts": json.dumps(facts), **engine.save()}
        np.savez(content, allow_pickle=False, **arrays)  # checksums of a ZIP archive
        return content.getvalue()

    def restore(self, saved: bytes) -> None:
        """Go back, or forward, to a saved state. A copy whose FMU rejects its state has failed.

        Raises:
            UsageError: The bytes are no saved state of as many copies of this model, or damaged;
                then no copy is changed.
        """
        engine = self._require()
        UsageError.reject(f"{self.name}: restore", saved, bytes, "what save has returned")
        try:
            with np.load(io.BytesIO(saved)) as content:
                arrays = dict(content)
            model, clock, *texts = json.loads(str(arrays.pop("facts")))
        except Exception as error:
            raise UsageError(f"{self.name}: these bytes are no saved copies, or damaged") from error
        if model != engine.owner or not engine.fits(arrays):
            raise UsageError(
                f"{self.name}: these bytes were saved by copies of another model, or by another "
                "number of them"
            )
        rejected = engine.restore(arrays)
        self._clock = Clock(*clock)
        engine.reasons, engine.invalid = ({int(i): t for i, t in own.items()} for own in texts)
        engine.reasons |= rejected

    def _require(self) -> Engine:
        if self._engine is None:
            raise FmuError(f"{self.name}: the copies are closed; open them again")
        return self._engine

    def _rows(self, only: ArrayLike | None) -> Integers:
        every = np.arange(self._count)
        if only is None:
            return every
        chosen = np.asarray(only).ravel()
        try:
            if chosen.dtype.kind == "i" and (chosen < 0).any():
                raise IndexError
            rows: Integers = every[chosen if chosen.size else chosen.astype(int)]
        except IndexError:
            raise UsageError.of_type(
                f"{self.name}: only",
                only,
                f"numbers from 0 to {self._count - 1}, or {self._count} truth values",
            ) from None
        if len(set(rows.tolist())) < len(rows):
            raise UsageError(f"{self.name}: only names a copy twice; give each number once")
        return rows

    def _column(self, name: str, value: Any, count: int) -> Any:
        """Return a number or a text as it is, and several values as an array of numbers."""
        if isinstance(value, str) or np.ndim(value) == 0:
            return value
        try:
            column: Any = np.array(value)
            if column.dtype.kind not in "iu":  # integers from 2^53 on are no floats
                column = reals(column)
        except (TypeError, ValueError, OverflowError) as error:
            raise ParameterError(f"{self.name}: {name}: {error}; give numbers") from error
        if column.shape != (count,):
            raise ParameterError(
                f"{self.name}: {name} has the shape {column.shape}; give one number for each of "
                f"{count} copies, or one for all"
            )
        return column


def _given(owner: str, values: Mapping[str, Any]) -> Mapping[str, Any]:
    UsageError.reject(
        f"{owner}: start_values", values, Mapping, "values by name, e.g. {'phi': [0.1, 0.2]}"
    )
    return values
