"""A solver over a grid of output times, ready to be called; and what it is built for."""

import ctypes
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.codegen.casadi_patches import REPORT
from cosim.model.inputs import InputSeries


class Counts(NamedTuple):
    """What a call took; `cause` says why it failed, where the solver knows."""

    steps: int | None = None
    rhs_calls: int | None = None
    jacobian_calls: int | None = None
    cause: str = ""


@dataclass(frozen=True)
class Problem:
    """A model over a grid: what a solver builds its engine for. Equal ones have equal engines.

    Attributes:
        dae: The model.
        times: Output times, s, at least two and increasing, as the bytes of an array of doubles.
        inputs: Time series of some inputs.
        compiled: Whether the equations are to be machine code.
        sensitivities: Whether somebody will differentiate the engine's function.
        piecewise: Whether inputs have a column per output time, which holds on the way there.
        project: Whether every step is to end where the model's invariants vanish.
        nominal: What counts as 1 of each state, for solvers that `count_in_nominal`; as SI units
            are where it is empty.
    """

    dae: Dae
    times: bytes
    inputs: InputSeries | None = None
    compiled: bool = False
    sensitivities: bool = True
    piecewise: bool = False
    project: bool = False
    nominal: tuple[float, ...] = ()

    @property
    def grid(self) -> Vector:
        """Output times, s, (n,)."""
        return np.frombuffer(self.times)

    def until(self, n: int) -> "Problem":
        """Return the problem over the first n output times."""
        return replace(self, times=self.grid[:n].tobytes())


class EngineFunctions(NamedTuple):
    """What CasADi calls of an engine.

    Attributes:
        function: `(x0, z0, p, u, ...) -> (xf, zf, ...)`, one column per output time.
        parameters: `p -> p` of `function`, which may take more; None where it takes the model's.
    """

    function: ca.Function
    parameters: ca.Function | None = None


# (x0, z0, p, u, states, algebraics) -> succeeded, number of output times that were reached
DirectRun = Callable[[Vector, Vector, Vector, Vector, Vector, Vector], tuple[bool, int]]


@dataclass(frozen=True)
class Engine:
    """An integrator over a grid, ready to be called.

    Attributes:
        make: Builds what CasADi calls, where somebody asks: its sizes grow with the grid.
        points: Number of output times, columns of the results.
        repeat_u: Whether `u` has one column per output time.
        counts: Reads what the thread's last call took.
        compiled: Whether the equations are machine code.
        library: What runs as one C function and takes over Ctrl-C (fmu/solvers/interrupt.c); None
            where CasADi sees to that.
        kept: Which columns of the results are at the problem's output times; all when None.
        restart: Builds the engine for a start where this one fails although it is consistent, from
            dx/dt there, (nx,); None where there is none.
        fallback: Builds the engine of settings that fail less, for a run that failed with a reason;
            None where there are none, or none for that reason.
        direct: Does the same on arrays without CasADi in between; None where nothing does. It
            prints nothing, and leaves alone what it does not reach.
    """

    make: Callable[[], EngineFunctions]
    points: int
    repeat_u: bool
    counts: Callable[[], Counts]
    compiled: bool
    library: ctypes.CDLL | None = None
    kept: NDArray[np.intp] | None = None
    restart: "Callable[[Vector], Engine] | None" = None
    fallback: "Callable[[str], Engine | None] | None" = None
    direct: DirectRun | None = None

    @cached_property
    def functions(self) -> EngineFunctions:
        """What CasADi calls."""
        return self.make()


def reported(library: ctypes.CDLL, start: float, length: float) -> Callable[[], Counts]:
    """Return what reads the report of a library, whose time is start + length * its own."""
    numbers = (ctypes.c_double * REPORT)()

    def counts() -> Counts:
        library.cosim_report(numbers)
        steps, rhs, jacobians, status, reached, last = numbers
        cause = ""
        if status:
            why = _CAUSES.get(int(status), "it gave up")
            cause = f"{why} at t = {start + length * reached:g}, h = {length * last:.2g}"
        return Counts(int(steps), int(rhs), int(jacobians), cause)

    return counts


_CAUSES = {
    1: "too many steps",
    2: "step size too small",
    3: "inconsistent algebraic unknowns",
    4: "a state is not finite",
    5: "halted",
}
