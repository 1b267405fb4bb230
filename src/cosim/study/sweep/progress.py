"""How far a sweep is, on stderr, for a terminal only."""

import sys
from time import monotonic

from cosim.study.sweep.chunk import Summary


class SweepProgress:
    """Counts runs; `total` of them, `done` of which are kept from before."""

    def __init__(self, total: int, done: int, shown: bool | None) -> None:
        self._total, self._done, self._before = total, done, done
        self._shown = sys.stderr.isatty() if shown is None else shown
        self._began, self._told = monotonic(), 0.0
        self._bad: dict[str, int] = {}

    def __call__(self, summary: Summary) -> None:
        """Note a chunk; say where we are, at most four times a second."""
        self._done += summary.count
        for state, count in summary.states.items():
            if state != "complete":
                self._bad[state] = self._bad.get(state, 0) + count
        now = monotonic()
        if self._shown and (now - self._told > 0.25 or self._done == self._total):
            self._told = now
            print(f"\r{self.line(now)}", end="", file=sys.stderr, flush=True)

    def line(self, now: float) -> str:
        """Return one line of text."""
        rate = (self._done - self._before) / max(now - self._began, 1e-9)
        left = (self._total - self._done) / rate if rate > 0 else 0.0
        bad = "".join(f", {count} {state}" for state, count in self._bad.items())
        return f"{self._done}/{self._total} runs, {rate:.0f} runs/s, {left:.0f} s left{bad}  "

    def end(self) -> None:
        """End the line."""
        if self._shown and self._told:
            print(file=sys.stderr)
