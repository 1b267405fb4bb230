"""`Settings`: how to simulate coupled systems."""

from dataclasses import dataclass
from enum import StrEnum

from cosim.errors import UsageError
from cosim.model.times import reject_rounded
from cosim.model.values import number


class Method(StrEnum):
    """How inputs move within a macro step, in the order of fmu/master/coupling.h."""

    JACOBI = "jacobi"
    GAUSS_SEIDEL = "gauss_seidel"
    EXTRAPOLATED = "extrapolated"
    ITERATED = "iterated"


@dataclass(frozen=True)
class Settings:
    """How to simulate: times and steps in s, tolerance of the parts; see `System.simulate`.

    With `merges`, a run whose events repeat at one instant is an error, so that parts can merge.
    """

    start: float
    stop: float
    interval: float
    accuracy: float | None
    macro_step: float | None
    method: Method
    tolerance: float | None
    threads: bool = False
    merges: bool = True

    def __post_init__(self) -> None:
        reject_rounded("macro_step", self.macro_step, self.start, self.stop)
        if self.accuracy is not None and self.macro_step is not None:
            raise UsageError("accuracy chooses the macro steps; leave macro_step out")
        if self.macro_step is None and self.method in (Method.JACOBI, Method.GAUSS_SEIDEL):
            raise UsageError(
                f"{self.method} has no estimate of its error; give macro_step, or take the "
                f"method {Method.ITERATED}"
            )


def positive(owner: str, name: str, value: float | None) -> float | None:
    """Return a setting, which is above 0 where it is given."""
    return None if value is None else number(owner, name, value, positive=True)
