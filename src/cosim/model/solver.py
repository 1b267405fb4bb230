"""`Solver`, `Tolerance`, `Goal`: integration settings, checked when they are created."""

from abc import ABC, abstractmethod
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from cosim.errors import ParameterError, UsageError
from cosim.model.values import number

LIMITS = ("relative_tolerance", "absolute_tolerance", "max_step")  # of an adaptive solver
LEAST_RELATIVE = 100 * float(np.finfo(float).eps)  # tolerance that double precision resolves


@dataclass(frozen=True)
class _Settings:
    @property
    def numbers(self) -> dict[str, Any]:
        """Those that are given, by the keywords of `cosim.simulate`."""
        return {name: value for name, value in asdict(self).items() if value is not None}


@dataclass(frozen=True)
class Tolerance(_Settings):
    """Limits of an adaptive solver's steps; alone, those of the model's default solver.

    Args:
        relative: Error per step relative to the size of each state (1).
        absolute: Error per step in the nominal value of each unknown (1); a hundredth of the
            relative tolerance when None.
        max_step: Largest step, s; see `AdaptiveSolver`.

    Raises:
        ParameterError: A tolerance is out of its range, both are 0, or the step is not positive.
    """

    relative: float = 1e-8
    absolute: float | None = None
    max_step: float | None = None

    def __post_init__(self) -> None:
        relative = number("solver", "relative_tolerance", self.relative)
        if relative != 0 and not LEAST_RELATIVE <= relative <= 0.1:
            raise ParameterError(
                f"relative_tolerance = {relative:g} is not within 2.2e-14 ... 0.1; "
                "double precision cannot resolve less, and more gives no accuracy"
            )
        if self.absolute is not None:
            absolute = number("solver", "absolute_tolerance", self.absolute)
            if not 0 <= absolute <= 0.1:
                problem = "negative" if absolute < 0 else "above 0.1, a tenth of nominal values"
                raise ParameterError(
                    f"absolute_tolerance = {absolute:g} is {problem}; give 0 ... 0.1"
                )
        if relative == 0 and not self.absolute:
            raise ParameterError("both tolerances are 0; give one of them a positive value")
        if self.max_step is not None:
            number("solver", "max_step", self.max_step, positive=True)

    @property
    def numbers(self) -> dict[str, Any]:
        """Those that are given, by the names that an `AdaptiveSolver` has for them."""
        own = zip(LIMITS, (self.relative, self.absolute, self.max_step), strict=True)
        return {name: value for name, value in own if value is not None}

    @property
    def pair(self) -> tuple[float, float]:
        """Relative and absolute tolerance."""
        return self.relative, 0.01 * self.relative if self.absolute is None else self.absolute


@dataclass(frozen=True)
class Goal(_Settings):
    """A target instead of a solver and its tolerance: one of the two.

    Args:
        accuracy: Largest global error of the outputs, in nominal values.
        budget: Largest time of the solver, s.

    Raises:
        ParameterError: The number is not finite or not positive.
        UsageError: Both arguments are set, or none.
    """

    accuracy: float | None = None
    budget: float | None = None

    def __post_init__(self) -> None:
        given = {name: value for name, value in vars(self).items() if value is not None}
        for name, value in given.items():
            number("run", name, value, positive=True)
        if len(given) != 1:
            raise UsageError(
                "accuracy and budget are both given, but one follows from the other; give one"
                if given
                else "a goal is an accuracy or a budget; give one"
            )


@dataclass(frozen=True, kw_only=True)
class Solver(_Settings, ABC):
    """Integration method with its settings.

    A new solver is a class in a file of `integrate/families`, which adds the method `engine`, and
    one line in `integrate.solvers.SOLVERS`.

    Attributes:
        name: Name of the solver for users.
        order: Order of the method; the highest one if it varies.
        solves_dae: Whether it integrates algebraic unknowns.
        adaptive: Whether it chooses its own steps.
        compiled_only: Whether it needs a compiler.
        projects: Whether its steps can be projected onto the constraints (compiled only).
        takes_nominal_values: Whether nominal values are arguments of it; for other solvers, the
            equations are scaled.
        uses_jacobian: Whether it uses the Jacobian, which takes long to compile.
        watches: Whether a compiled run of it goes through events by itself.
        takes_times: Whether a compiled engine for other output times is cheap to build.
    """

    name: ClassVar[str]
    order: ClassVar[int]
    solves_dae: ClassVar[bool] = False
    adaptive: ClassVar[bool] = True
    compiled_only: ClassVar[bool] = False
    projects: ClassVar[bool] = False
    takes_nominal_values: ClassVar[bool] = False
    uses_jacobian: ClassVar[bool] = False
    watches: ClassVar[bool] = False
    takes_times: ClassVar[bool] = False

    @property
    @abstractmethod
    def settings(self) -> str:
        """Settings, for messages."""


@dataclass(frozen=True, kw_only=True)
class AdaptiveSolver(Solver):
    """A solver that chooses its steps.

    Args:
        relative_tolerance, absolute_tolerance, max_step: See `Tolerance`. The nominal value of an
            unknown is 1 SI unit if none is set. Without a largest step, those of a run follow
            `integrate.solvers.with_largest_step`.

    Raises:
        ParameterError: A tolerance is out of its range, or the step is not positive.
    """

    relative_tolerance: float = 1e-8
    absolute_tolerance: float | None = None
    max_step: float | None = None

    def __post_init__(self) -> None:
        self.tolerance  # noqa: B018  # its constructor checks

    @cached_property
    def tolerance(self) -> Tolerance:
        """Relative and absolute tolerance, and the largest step."""
        return Tolerance(self.relative_tolerance, self.absolute_tolerance, self.max_step)

    @property
    def settings(self) -> str:
        """Tolerances, for messages."""
        return "rtol {:g}, atol {:g}".format(*self.tolerance.pair)
