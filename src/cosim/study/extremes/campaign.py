"""Every model at its limits: each case ends accurate, refused or failed, never silently wrong.

Cases run in child processes, so that one which hangs or crashes is killed and counted.
"""

import json
import sys
import threading
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from importlib import import_module
from math import isfinite
from time import perf_counter
from typing import Any

from cosim.host.child import ASKED_SILENTLY, Child
from cosim.host.inside import Conversation, look_where_the_parent_does
from cosim.model.catalogue import formulations
from cosim.model.values import number
from cosim.study.extremes.cases import Case, Counterpart, catalogue
from cosim.study.extremes.oracles import OUTCOMES, CaseEnding, Runner, judge
from cosim.text.tables import Table

WRONG = ("silent", "unverified", "hang", "crash")  # how no case may end
HANG = 120.0  # s, after which a case counts as hanging
LONGER = 10  # times that, for those that simulate an hour
MODULE = "cosim.study.extremes.campaign"
RUNNER = "cosim.study.extremes.oracles:run_case"


@dataclass(frozen=True)
class CaseFinding:
    """A case and how it ended."""

    case: Case
    verdict: CaseEnding

    def row(self) -> dict[str, Any]:
        """Return the finding as plain values, for tables, CSV and JSON."""
        error = self.verdict.error
        return {
            "family": self.case.family,
            "model": self.case.model,
            "case": self.case.name,
            "outcome": self.verdict.outcome,
            "error": error if error is None or isfinite(error) else None,
            "bound": self.case.bound,
            "seconds": round(self.verdict.seconds, 3),
            "reason": self.verdict.reason,
        }


def select_cases(models: Sequence[str] = (), *, long: bool = False) -> list[Case]:
    """Return the cases of some models or formulations, of all when none is named.

    Raises:
        UnknownName: The catalogue has no such model.
    """
    wanted = {name for model in models for name in formulations(model)}
    return [
        case
        for case in catalogue()
        if (long or not case.long) and (not models or case.model in wanted)
    ]


def extremes(
    models: str | Sequence[str] = (), *, long: bool = False, timeout: float = HANG
) -> Table:
    """Run models at their limits; return how each case ended, a row each.

    Args:
        models: Models or formulations of the catalogue; all when none is named.
        long: With hours of simulated time.
        timeout: For one case, s.

    Raises:
        UnknownName: The catalogue has no such model.
        ParameterError: The timeout is not a positive number.
    """
    names = (models,) if isinstance(models, str) else models
    findings = list(explore(select_cases(names, long=long), timeout=timeout))
    return Table(tuple(finding.row() for finding in findings))


def explore(
    cases: Iterable[Case], *, timeout: float = HANG, jobs: int = 2, runner: str = RUNNER
) -> Iterator[CaseFinding]:
    """Run cases in child processes, in their order.

    Args:
        cases: What to run.
        timeout: After which a child is killed and its case is a hang, s; tenfold for long cases.
        jobs: Number of children.
        runner: What runs a case, as `MODULE:FUNCTION`; another than ours for a baseline.

    Raises:
        ParameterError: The timeout is not a positive number.
    """
    limit = number("extremes", "timeout", timeout, positive=True)
    workers: list[_CaseWorker] = []
    own = threading.local()

    def run(case: Case) -> CaseFinding:
        if not hasattr(own, "worker"):
            own.worker = _CaseWorker(runner)
            workers.append(own.worker)
        return CaseFinding(case, own.worker.judge(case, LONGER * limit if case.long else limit))

    pool = ThreadPoolExecutor(jobs)
    try:
        yield from pool.map(run, cases)
    finally:
        pool.shutdown(cancel_futures=True)
        for worker in workers:
            worker.close()


def family_rows(findings: Iterable[CaseFinding]) -> list[dict[str, Any]]:
    """Return a row per family: how many cases ended how, and the worst accurate one."""
    families: dict[str, list[CaseFinding]] = {}
    for finding in findings:
        families.setdefault(finding.case.family, []).append(finding)
    rows = []
    for family, members in families.items():
        counts = Counter(finding.verdict.outcome for finding in members)
        accurate = [f for f in members if f.verdict.outcome == "accurate"]
        worst = max(accurate, key=lambda f: f.verdict.error or 0.0, default=None)
        rows.append(
            {"family": family, "cases": len(members)}
            | {outcome: counts[outcome] for outcome in OUTCOMES}
            | {
                "worst error": worst and worst.verdict.error,
                "at": worst and f"{worst.case.model}, {worst.case.name}",
            }
        )
    return rows


def serve_cases(runner: Runner, conversation: Conversation) -> None:
    """Judge the cases that come as JSON; answer in kind."""
    for question in conversation.questions():
        facts = json.loads(question)
        facts["references"] = tuple(Counterpart(**each) for each in facts["references"])
        conversation.answer(json.dumps(judge(Case(**facts), runner)).encode())


class _CaseWorker:
    """A child process that judges one case at a time; replaced when it had to be killed."""

    def __init__(self, runner: str) -> None:
        self._runner = runner
        self._process = self._start()

    def judge(self, case: Case, timeout: float) -> CaseEnding:
        began = perf_counter()
        guard = threading.Timer(timeout, self._process.kill)
        guard.start()
        try:
            return CaseEnding(*json.loads(self._process.ask(json.dumps(asdict(case)).encode())))
        except (OSError, EOFError):
            seconds, code = perf_counter() - began, self._process.end()
            self._process = self._start()
        finally:
            guard.cancel()
        if seconds >= timeout:
            return CaseEnding("hang", None, f"killed after {timeout:g} s", seconds)
        return CaseEnding("crash", None, f"the process ended with code {code}", seconds)

    def close(self) -> None:
        self._process.end()

    def _start(self) -> Child:
        return Child(MODULE, [self._runner], streams=ASKED_SILENTLY)


if __name__ == "__main__":
    look_where_the_parent_does()
    module, _, function = sys.argv[1].partition(":")
    serve_cases(getattr(import_module(module), function), Conversation())
