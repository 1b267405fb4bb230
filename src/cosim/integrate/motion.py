"""`Motion`: what an integration over a grid of times found, with its events."""

from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from casadi_models.dae import Dae
from cosim.arrays import Vector
from cosim.codegen.functions import equations
from cosim.codegen.initialization import algebraic_function
from cosim.integrate.engine import Counts
from cosim.integrate.modes import Instant
from cosim.text import Ending


class EventRecord(NamedTuple):
    """An event of a run.

    Attributes:
        time: s.
        name: Name of the event.
        before, after: States just before and after it, (nx,).
        instant: Position of its instant in `Motion.instants`.
    """

    time: float
    name: str
    before: Vector
    after: Vector
    instant: int


@dataclass
class Motion:
    """Result of an integration over a grid, up to the last time that was reached.

    Attributes:
        dae: The model whose outputs the columns determine: with modes as further inputs.
        time: The grid, s, (n,); if an event ends the run, up to the time of that event.
        states, algebraics, u: One column per time.
        counts: Numbers of steps and calls.
        reason: Why the run stopped early; empty if it did not.
        solve_time: Time of the solver, s.
        events: Events in their order.
        stop: Message of the event that ended the run.
        instants: What was just before and after each instant with an event.
        note: What the steps may have passed over; empty if nothing.
    """

    dae: Dae
    time: Vector
    states: Vector
    algebraics: Vector
    u: Vector
    counts: Counts
    reason: Ending = Ending()  # noqa: RUF009 (a text, which nothing changes)
    solve_time: float | None = None
    events: list[EventRecord] = field(default_factory=list)
    stop: str = ""
    instants: list[tuple[Instant, Instant]] = field(default_factory=list)
    note: str = ""

    @cached_property
    def moving(self) -> Vector:
        """States, algebraic unknowns and inputs, (rows, n)."""
        u = np.broadcast_to(self.u, (len(self.u), len(self.time)))
        return np.vstack((self.states, self.algebraics, u))


def rates_at(motion: Motion, rows: Vector | slice, p: Vector) -> Vector:
    """Return dx/dt at rows of a motion, (nx, n), where the unknowns solve their equations."""
    t, x, z = motion.time[rows][None], motion.states[:, rows], motion.algebraics[:, rows]
    u = np.broadcast_to(motion.u, (len(motion.u), len(motion.time)))[:, rows]
    if len(z):  # the solver's own are interpolated between its steps
        with suppress(RuntimeError):  # CasADi's factorization meets a singular matrix
            solved = np.array(algebraic_function(motion.dae)(t, x, z, u, p))
            z = np.where(np.isfinite(solved).all(axis=0), solved, z)
    return np.array(equations(motion.dae)(t, x, z, u, p)[0])
