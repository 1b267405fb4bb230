"""`Solver`: how to integrate, as a value that is checked once and builds its own engine."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cosim.errors import ParameterError
from cosim.integrate.engine import Engine, Problem
from cosim.model.values import number


@dataclass(frozen=True)
class Tolerance:
    """Error per step that an adaptive solver may make: relative, and absolute.

    The absolute one counts in the nominal value of each unknown.
    """

    relative: float = 1e-8
    absolute: float | None = None

    def __post_init__(self) -> None:
        relative = number("solver", "relative_tolerance", self.relative)
        if relative != 0 and not 100 * np.finfo(float).eps <= relative <= 0.1:
            raise ParameterError(
                f"relative_tolerance = {relative:g} is not within 2.2e-14 ... 0.1; "
                "double precision carries no less, and more is no accuracy"
            )
        if self.absolute is not None and number("solver", "absolute_tolerance", self.absolute) < 0:
            raise ParameterError(
                f"absolute_tolerance = {self.absolute:g} is negative; give 0 or more"
            )
        if relative == 0 and not self.absolute:
            raise ParameterError("both tolerances are 0; give one of them a positive value")

    @property
    def pair(self) -> tuple[float, float]:
        """Relative and absolute; the absolute one is a hundredth of the relative by default."""
        return self.relative, 0.01 * self.relative if self.absolute is None else self.absolute


@dataclass(frozen=True, kw_only=True)
class Solver(ABC):
    """How to integrate. A new one is a class in a file of its own and a line in `solvers.SOLVERS`.

    Attributes:
        name: What users call it.
        order: Of its error; the highest one where that varies.
        solves_dae: Whether it takes algebraic unknowns.
        adaptive: Whether it chooses its steps.
        compiled_only: Whether it needs a compiler.
        projects: Whether it can end a step elsewhere than the step led to; compiled.
        counts_in_nominal: Whether it takes nominal values as numbers; for others, equations are
            rewritten.
        uses_jacobian: Whether it solves equations with the Jacobian, which takes long to compile.
    """

    name: ClassVar[str]
    order: ClassVar[int]
    solves_dae: ClassVar[bool] = False
    adaptive: ClassVar[bool] = True
    compiled_only: ClassVar[bool] = False
    projects: ClassVar[bool] = False
    counts_in_nominal: ClassVar[bool] = False
    uses_jacobian: ClassVar[bool] = False

    @property
    @abstractmethod
    def settings(self) -> str:
        """Its numbers, for messages."""

    @abstractmethod
    def engine(self, problem: Problem) -> Engine:
        """Build the engine for a problem.

        Raises:
            UsageError: The solver does not take what is given.
            ParameterError: It would make too many steps.
            MissingTool: It shall be compiled, and no compiler works.
        """


@dataclass(frozen=True, kw_only=True)
class AdaptiveSolver(Solver):
    """A solver that chooses its steps.

    Args:
        relative_tolerance: Error per step relative to each state's size (1).
        absolute_tolerance: Error per step in nominal values: SI units where a variable has none;
            a hundredth of the relative one when None.

    Raises:
        ParameterError: A tolerance is out of its range.
    """

    relative_tolerance: float = 1e-8
    absolute_tolerance: float | None = None

    def __post_init__(self) -> None:
        self.tolerance  # noqa: B018  # its constructor checks

    @property
    def tolerance(self) -> Tolerance:
        """Both tolerances."""
        return Tolerance(self.relative_tolerance, self.absolute_tolerance)

    @property
    def settings(self) -> str:
        """Its tolerances."""
        return "rtol {:g}, atol {:g}".format(*self.tolerance.pair)
