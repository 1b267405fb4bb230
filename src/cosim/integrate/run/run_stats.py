"""`RunStats`: what a run took."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from typing import Any


@dataclass(frozen=True, kw_only=True)
class RunStats(Mapping[str, Any]):
    """What a run took: attributes, and a mapping of those that are known.

    Attributes:
        solver: Its name.
        relative_tolerance: Of an adaptive solver.
        step_size: Largest step of one with fixed steps, s; None for the output interval.
        solve_time: What the solver took, s.
        steps, rhs_calls, jacobian_calls: How often.
        compiled: Whether the equations were machine code.
        wall_time: What everything took, s.
        compile_time: Of that, what it took to compile equations that the cache did not have, s.
        invalid: Where the run leaves what its model, or its fixed step, is good for.
        note: What was done that was not asked for.
        invalid_from: From when on it does, s; None where it does not.
        stop: The condition that ended the run, and when it became true.
        stop_time: When, s.
    """

    solver: str
    relative_tolerance: float | None = None
    step_size: float | None = None
    solve_time: float | None = None
    steps: int | None = None
    rhs_calls: int | None = None
    jacobian_calls: int | None = None
    compiled: bool
    wall_time: float
    compile_time: float | None = None
    invalid: tuple[str, ...] = ()
    note: str | None = None
    invalid_from: float | None = None
    stop: str | None = None
    stop_time: float | None = None

    def _known(self) -> dict[str, Any]:
        found = {field.name: getattr(self, field.name) for field in fields(self)}
        found["invalid"] = list(self.invalid) or None
        return {name: value for name, value in found.items() if value is not None}

    def __getitem__(self, name: str) -> Any:
        value = vars(self).get(name)
        if name == "invalid":
            value = list(self.invalid) or None
        if value is None:
            raise KeyError(name)
        return value

    def __iter__(self) -> Iterator[str]:
        return iter(self._known())

    def __len__(self) -> int:
        return len(self._known())

    def __or__(self, more: Mapping[str, Any]) -> dict[str, Any]:
        return self._known() | dict(more)
