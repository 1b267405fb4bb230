"""`Window`: how far a run with events integrates at once, and how closely it looks for them."""

import numpy as np

from cosim.arrays import Vector
from cosim.errors import SolverError
from cosim.integrate.call import INTERRUPTED
from cosim.integrate.engine import MOST_STEPS
from cosim.integrate.location import SAME_TIME, Piece
from cosim.text import EndKind

_MANY_STEPS = 1_000  # of a piece that is not looked at as closely; a fresh start costs 60
_FEW_STEPS = 100  # take as long as all else of a piece
_STEPS_PER_LOOK, _MOST_LOOKS = 8, 100_000  # on average; in a piece
_FIRST, _LEAST, _LEAST_WATCHED = 32, 31, 1000  # intervals; after an event; if the solver sees it
_SOON = 1.25  # times the time between events: within which the next one is looked for
_NEAR = 0.1  # share of a piece by which it may be shorter
_NEARER = 1 / 8  # share of a time in which a solver fails


class Window:
    """How far a run with events integrates at once, and how closely it looks for them.

    Beyond an event, the motion with the modes before it may be much faster, or end. So a piece is
    as long as the motion last stayed in its modes; where the solver fails or takes many steps, the
    run looks for events in a part of it first.

    Args:
        grid: Output times, s.
        looks: Whether events are looked for along a motion; else the solver ends at them.

    Attributes:
        length: Of the next piece, s.
        apart: Longest time between two looks, s.
        most_steps: From one look to the next, after which the solver gives up.
    """

    def __init__(self, grid: Vector, *, looks: bool) -> None:
        self.grid, self.looks = grid, looks
        interval = float(np.ptp(grid)) / max(len(grid) - 1, 1)
        self.length = _FIRST * interval if looks else np.inf
        self.longest = (_LEAST if looks else _LEAST_WATCHED) * interval  # of what is the least
        self.least = self.longest  # after an event
        self.apart = np.inf
        self.most_steps = _MANY_STEPS if looks else MOST_STEPS
        self.began, self.row, self.steps = float(grid[0]), 0, 0  # the steps since then
        self.known = dict[bytes, tuple[float, float, float]]()  # by modes: s in them, least, apart

    def end(self, t: float) -> float:
        """Return the end of a piece that begins at a time, s: an output time if one is near."""
        length = min(self.length, _MOST_LOOKS * self.apart)
        until = min(t + length, float(self.grid[-1]))
        last = float(self.grid[self.grid.searchsorted(until, "right") - 1])
        return last if until - last <= _NEAR * (until - t) else until

    def with_looks(self, times: Vector) -> Vector:
        """Return times with further ones between them, none of which are too far apart."""
        if self.apart == np.inf:
            return times
        gaps = np.diff(times)
        parts = np.ceil((1 - 1e-9) * gaps / self.apart).clip(1).astype(int)
        shares = np.arange(parts.sum()) - np.repeat(parts.cumsum() - parts, parts)
        inner = np.repeat(times[:-1], parts) + shares * np.repeat(gaps / parts, parts)
        return np.append(inner, times[-1])

    def is_refined(self, piece: Piece) -> bool:
        """Learn from a piece; return whether it must be shorter, or looked at more closely.

        Raises:
            SolverError: The solver fails at once, or has taken too many steps since the last output
                time or event.
        """
        if not self.looks or piece.reason == INTERRUPTED:
            return False
        steps, times = piece.reached.counts.steps or 0, piece.problem.grid
        looks = len(piece.times) - 1
        reached = float(piece.times[-1] - times[0]) if looks > 0 else 0.0
        self._count(piece, steps)
        dense = steps > _STEPS_PER_LOOK * max(looks, 1)
        if piece.reason:
            least = max(SAME_TIME * piece.span, 32 * np.spacing(abs(times[0])))
            if reached > least:
                self.length = reached
                return dense
            if self.most_steps == MOST_STEPS:
                raise SolverError(piece.reason, ending=piece.reason)
            nearer = _NEARER * float(times[-1] - times[0])
            if nearer > least:
                self.length = nearer
            else:
                self.most_steps = MOST_STEPS  # to see why it fails
            return True
        self.most_steps = _MANY_STEPS
        if dense and steps > _MANY_STEPS:
            self.length = reached * _MANY_STEPS / (2 * steps)
            return True
        if dense:
            self.apart = reached * _STEPS_PER_LOOK / (2 * steps)
            return True
        if 2 * looks > steps:
            self.apart = max(self.apart, reached * _STEPS_PER_LOOK / (2 * max(steps, 1)))
        self.least = min(reached * _FEW_STEPS / max(steps, 1), self.longest)
        return False

    def _count(self, piece: Piece, steps: int) -> None:
        row = int(self.grid.searchsorted(piece.begin.t, "right"))
        self.steps = steps + (self.steps if row == self.row else 0)
        self.row = row
        if self.steps > MOST_STEPS:
            why = f"too many steps at t = {piece.begin.t:g}"
            raise SolverError.of(piece.own.dae.full_name, why, kind=EndKind.TOO_MANY_STEPS)

    def widen(self) -> None:
        """Note that a piece had no event."""
        self.length *= 2

    def restart(self) -> None:
        """Note that the solver has failed within a piece."""
        self.length = self.least

    def switch(self, t: float, before: Vector, after: Vector) -> None:
        """Note an event.

        Args:
            t: Its time, s.
            before, after: The modes.
        """
        passed, self.began, self.steps = t - self.began, t, 0
        last = self.known[before.tobytes()] = passed, self.least, self.apart
        passed, self.least, self.apart = self.known.get(after.tobytes(), last)
        self.length = min(max(self.least, _SOON * passed), _MANY_STEPS * self.apart)
