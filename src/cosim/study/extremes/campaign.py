"""Every model at its limits: each case ends accurate, refused or failed, never silently wrong.

Cases run in child processes, so that one which hangs or crashes is killed and counted.
"""

import json
import os
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from math import isfinite
from time import perf_counter
from typing import Any

from cosim.model.catalogue import formulations
from cosim.model.values import number
from cosim.study.extremes.cases import Case, Counterpart, catalogue
from cosim.study.extremes.oracles import OUTCOMES, Ending, Runner, judge, run_case
from cosim.text.tables import Table

WRONG = ("silent", "unverified", "hang", "crash")  # how no case may end
LONGER = 10  # times the limit of other cases, for those that simulate an hour
SERVER = f"from {__name__} import serve_cases; serve_cases()"


@dataclass(frozen=True)
class CaseFinding:
    """A case and how it ended."""

    case: Case
    verdict: Ending

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
    models: str | Sequence[str] = (), *, long: bool = False, timeout: float = 120.0
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
    cases: Iterable[Case], *, timeout: float = 120.0, jobs: int = 2, server: str = SERVER
) -> Iterator[CaseFinding]:
    """Run cases in child processes, in their order.

    Args:
        cases: What to run.
        timeout: After which a child is killed and its case is a hang, s; tenfold for long cases.
        jobs: Number of children.
        server: Python code that a child runs; it calls `serve`.

    Raises:
        ParameterError: The timeout is not a positive number.
    """
    limit = number("extremes", "timeout", timeout, positive=True)
    workers: list[_CaseWorker] = []
    own = threading.local()

    def run(case: Case) -> CaseFinding:
        if not hasattr(own, "worker"):
            own.worker = _CaseWorker(server)
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


def serve_cases(runner: Runner = run_case) -> None:
    """Judge the cases that come as JSON lines on standard input; answer in kind.

    Args:
        runner: What runs a case; another one than the product's own for a baseline.
    """
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what a solver prints is no answer
    for line in sys.stdin:
        facts = json.loads(line)
        facts["references"] = tuple(Counterpart(**each) for each in facts["references"])
        print(json.dumps(judge(Case(**facts), runner)), file=answers, flush=True)


class _CaseWorker:
    """A child process that judges one case at a time; replaced when it had to be killed."""

    def __init__(self, server: str) -> None:
        self._server = server
        self._process = self._start()

    def judge(self, case: Case, timeout: float) -> Ending:
        began = perf_counter()
        guard = threading.Timer(timeout, self._process.kill)
        guard.start()
        answer = self._ask(json.dumps(asdict(case)))
        guard.cancel()
        if answer:
            return Ending(*json.loads(answer))
        seconds, code = perf_counter() - began, self._process.wait()
        self.close()
        self._process = self._start()
        if seconds >= timeout:
            return Ending("hang", None, f"killed after {timeout:g} s", seconds)
        return Ending("crash", None, f"the process ended with code {code}", seconds)

    def close(self) -> None:
        self._process.kill()
        self._process.communicate()

    def _ask(self, question: str) -> str:
        assert self._process.stdin
        assert self._process.stdout
        try:
            self._process.stdin.write(f"{question}\n")
            self._process.stdin.flush()
            return self._process.stdout.readline()
        except OSError:  # its pipe is closed; Windows has another name for that
            return ""

    def _start(self) -> "subprocess.Popen[str]":
        command = [sys.executable, "-P", "-c", self._server]  # -P: nothing of the current folder
        pipe = subprocess.PIPE
        return subprocess.Popen(
            command, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL, text=True
        )
