"""`Check`: one comparison of two runs, its verdict, and what to try where they differ."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from cosim.scene.roads import Road
from cosim.verify.comparison import Comparison


class Verdict(StrEnum):
    """What a comparison shows."""

    OK = "ok"
    COARSE = "reference too coarse"  # the difference may be the reference's own error
    DIFFERS = "DIFFERS"
    FAILED = "FAILED"  # there is no run to compare


@dataclass(frozen=True)
class Check:
    """One comparison of two runs, and what the second one took.

    Attributes:
        model: `MODEL/FORMULATION` of the second run.
        road: How it was computed.
        against: What it is compared with.
        comparison: The differences; None where the run failed.
        stats: Of the second run: wall_time [s], rhs_calls.
        failure: Why the run failed.
        left_out: Names that are not compared, and why: they mean something else.
        doubt: Estimated error of what it is compared with, in nominal values; 0 where that is not
            known or does not matter.
        note: What was done to find out, or what to try.
    """

    model: str
    road: Road
    against: str
    comparison: Comparison | None
    stats: Mapping[str, Any] = field(default_factory=dict)
    failure: str = ""
    left_out: Mapping[str, str] = field(default_factory=dict)
    doubt: float = 0.0
    note: str = ""

    @property
    def verdict(self) -> Verdict:
        """What the comparison shows."""
        if self.comparison is None:
            return Verdict.FAILED
        if self.comparison.agrees:
            return Verdict.OK
        nearest = self.comparison.worst.scaled - self.doubt
        return Verdict.COARSE if nearest <= self.comparison.bound else Verdict.DIFFERS

    @property
    def wall_time(self) -> float | None:
        """What the second run took without the compiler, s; None where there is no run."""
        wall: float | None = self.stats.get("wall_time")
        return None if wall is None else wall - (self.stats.get("compile_time") or 0.0)

    @property
    def reason(self) -> str:
        """Why the run failed, what was done to find out, or what to try."""
        return self.failure or self.note

    def row(self) -> dict[str, Any]:
        """Return the check as plain values, for tables and JSON."""
        compared = self.comparison
        worst = compared and compared.worst
        return {
            "model": self.model,
            "road": self.road,
            "against": self.against,
            "variables": compared and len(compared.differences),
            "worst": worst and worst.name,
            "difference": worst and worst.scaled,
            "at": worst and worst.time,
            "bound": compared and compared.bound,
            "verdict": str(self.verdict),
            "wall_time": self.wall_time,
            "rhs_calls": self.stats.get("rhs_calls"),
            "left_out": " ".join(self.left_out) or None,
            "reason": self.reason or None,
        }
