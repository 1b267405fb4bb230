"""`Values`: variables of a session, set and read by prepared calls."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache
from math import isfinite
from typing import Any

import numpy as np

from cosim.arrays import Vector
from cosim.errors import FmuError, UnknownName, UsageError
from cosim.fmi.run.description import by_name, unit_of
from cosim.fmi.run.typed_values import is_number, typed_value
from cosim.fmi.units import units_for
from cosim.model.quantities import quantity
from cosim.model.values import listed
from cosim.session.calls import WARNING, Group, PreparedCalls

_FLOATS = ("Real", "Float64")  # which take every finite float as it is
LARGEST = 64  # lists of variables whose calls are prepared


class Values:
    """The variables of an instance.

    Args:
        name: Of the session, for errors.
        description: Of fmpy.
        calls: Of the instance.
        check: Raises the error of a status.

    Attributes:
        inputs: Those that are one number.
    """

    def __init__(
        self,
        name: str,
        description: Any,
        calls: PreparedCalls,
        check: Callable[[int, str], None],
    ) -> None:
        self._name, self._description, self._calls, self._check = name, description, calls, check
        self._variables = by_name(description)
        self.inputs = inputs_of(description)
        self._selection = lru_cache(LARGEST)(self._prepared)
        self._setters: dict[str, tuple[Any, Group]] = {}

    def set(self, values: Any, named: dict[str, Any]) -> None:
        """Set inputs and tunable parameters; see `Session.set`."""
        if values is not None:
            named = {**sequence_by_name(self._name, [v.name for v in self.inputs], values), **named}
        found = []
        for name, value in named.items():
            variable, group = self._setters.get(name) or self._setter(name)
            if type(value) is not float or not isfinite(value) or variable.type not in _FLOATS:
                value = plain_value(self._name, self._description, variable, value)
            found.append((group, value))
        before = [self._present(group) for group, _ in found] if len(found) > 1 else []
        for number, (group, plain) in enumerate(found):
            if not group.is_plain:  # an element: the others stay as they are
                self._check(group.get(), "Get")
            group.buffer[group.places] = plain
            status = group.set()
            if status > WARNING:
                for (earlier, _), value in zip(found[:number], before, strict=False):
                    earlier.buffer[:] = value
                    earlier.set()
                self._check(status, "Set")

    def present(self, names: Iterable[str]) -> dict[str, Any]:
        """Return values of variables that may be set, in their own types."""
        found = dict[str, Any]()
        for name in names:
            _, group = self._setters.get(name) or self._setter(name)
            (found[name],) = self._present(group)[group.places].tolist()
        return found

    def _present(self, group: Group) -> Vector:
        """Return the values of a group."""
        self._check(group.get(), "Get")
        return group.buffer.copy()

    def _setter(self, name: str) -> tuple[Any, Group]:
        """Return a variable that may be set during a run, with its prepared call."""
        variable = self._variables.get(name)
        if variable is None:
            settable = [v.name for v in self._variables.values() if may_change(v)]
            raise UnknownName.among(self._name, "input", name, settable)
        if not may_change(variable):
            raise not_settable(self._name, name, [v.name for v in self.inputs])
        found = variable, self._calls.groups([variable])[0]
        self._setters[name] = found
        return found

    def get(self, names: tuple[str, ...]) -> Vector:
        """Return values, (n,); see `Session.get`."""
        try:
            groups = self._selection(names)
        except (TypeError, NotImplementedError):  # what cannot be looked up is no name
            groups = self._prepared(names)
        if len(groups) == 1 and groups[0].is_plain:
            status = groups[0].get()
            if status > WARNING:
                self._check(status, "Get")
            return groups[0].buffer.astype(float)  # a copy
        row = np.empty(sum(len(group.columns) for group in groups))
        for group in groups:
            self._check(group.get(), "Get")
            row[group.columns] = group.buffer[group.places]
        return row

    def _prepared(self, names: tuple[str, ...]) -> list[Group]:
        """Prepare the calls that read variables."""
        chosen = listed(f"{self._name}: get", names)
        for name in chosen:
            UnknownName.reject(self._name, "variable", self._variables, name)
            if not is_number(self._variables[name]):
                raise UsageError(f"{self._name}: {name} is not a single number")
        return self._calls.groups([self._variables[name] for name in chosen])


def finite(owner: str, names: Sequence[str], values: Vector, time: float) -> Vector:
    """Return values, (n,), after a check that all of them are finite."""
    good = np.isfinite(values)
    if not good.all():
        raise FmuError(
            f"{owner}: {names[int(np.argmin(good))]} is not finite at {time:.12g} s; leave it out "
            "of the names if it has no value"
        )
    return values


def sequence_by_name(owner: str, names: Sequence[str], values: Any) -> dict[str, Any]:
    """Return values by the names of inputs, which may have come in their order."""
    if isinstance(values, Mapping):
        return dict(values)
    row = values.tolist() if isinstance(values, np.ndarray) else values
    if isinstance(row, str) or not isinstance(row, Sequence) or len(row) != len(names):
        shown = f"{len(names)} inputs {', '.join(names)}" if names else "inputs: it has none"
        raise UsageError.of_type(
            f"{owner}: set", values, f"values by name, or one for each of its {shown}"
        )
    return dict(zip(names, row, strict=True))


def inputs_of(description: Any) -> list[Any]:
    """Return the inputs that are one number."""
    return [v for v in description.modelVariables if v.causality == "input" and is_number(v)]


def plain_value(owner: str, description: Any, variable: Any, value: Any) -> Any:
    """Return a value, perhaps a text with a unit, in the variable's unit and type."""
    if isinstance(value, str) and variable.type not in ("Boolean", "Enumeration", "String"):
        units = units_for(variable, description)
        value = quantity(variable.name, value, unit_of(variable) or "1", definitions=units)
    return typed_value(owner, variable, value)


def not_settable(owner: str, name: str, inputs: Sequence[str]) -> UsageError:
    """Return the error of setting a variable between steps that may not be set then."""
    return UsageError(
        f"{owner}: {name} cannot be set during a run, which takes "
        f"{', '.join(inputs) or 'no inputs'} and tunable parameters; give it to "
        "reset(start_values=...)"
    )


def may_change(variable: Any) -> bool:
    """Tell whether a variable may be set between steps."""
    tunable = variable.causality == "parameter" and variable.variability == "tunable"
    return is_number(variable) and (variable.causality == "input" or tunable)
