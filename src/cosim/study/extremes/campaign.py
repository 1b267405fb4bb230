"""`extremes`: run every extreme case in child processes, and report how each one ended.

A case that hangs or crashes is killed and counted.
"""

import json
import sys
import threading
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import asdict
from functools import partial
from importlib import import_module
from time import perf_counter
from typing import Any

from casadi_models.extreme_cases import Case, Counterpart, catalogue
from cosim.errors import UsageError
from cosim.host.child import Child, answer_questions, look_where_the_parent_does
from cosim.host.limits import MOST_WAIT
from cosim.model.catalogue import formulations
from cosim.model.values import time_limit_from
from cosim.study.extremes.oracles import OUTCOMES, CaseFinding, Runner, assess
from cosim.text import Table

WRONG = ("silent", "unverified", "hang", "crash")  # outcomes that are defects
HANG = 120.0  # time limit of a case, s
LONGER = 10  # factor of the time limit for cases that simulate an hour
MODULE = "cosim.study.extremes.campaign"
RUNNER = "cosim.study.extremes.oracles:run_case"


def select_cases(models: Sequence[str] = (), *, long: bool = False) -> list[Case]:
    """Return the cases of some models or formulations; of all models when none is named.

    Raises:
        UnknownName: The catalogue has no such model.
        UsageError: A model is not of the catalogue.
    """
    for model in models:
        if ".py:" in model:
            raise UsageError(
                f"{model} has no extreme cases; they are known for the models of the catalogue. "
                "Vary its values with cosim sweep"
            )
    names = {name for model in models for name in formulations(model)}
    return [
        case
        for case in catalogue()
        if (long or not case.long) and (not models or case.model in names)
    ]


def extremes(
    models: str | Sequence[str] = (), *, long: bool = False, timeout: float = HANG
) -> Table:
    """Run models with extreme values; return a table with a row for each case.

    Args:
        models: Models or formulations of the catalogue; all when none is named.
        long: Whether to include cases with an hour of simulated time.
        timeout: Time limit of one case, s; tenfold for long cases.

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
    """Run cases in child processes, in their order; those that take too long are killed.

    Args:
        cases: The cases to run.
        timeout: Time limit of a case, s; tenfold for long cases.
        jobs: Number of child processes.
        runner: Function that runs a case, as `MODULE:FUNCTION`; a benchmark passes another tool's.
    """
    limit = time_limit_from("extremes", timeout)
    workers: list[_CaseWorker] = []
    own = threading.local()

    def run(case: Case) -> CaseFinding:
        if not hasattr(own, "worker"):
            own.worker = _CaseWorker(runner)
            workers.append(own.worker)
        worker: _CaseWorker = own.worker
        return worker.assess(case, LONGER * limit if case.long else limit)

    pool = ThreadPoolExecutor(jobs)
    try:
        yield from pool.map(run, cases)
    finally:
        for worker in workers:  # first: the pool waits for the cases that run
            worker.close()
        pool.shutdown(cancel_futures=True)


def family_rows(findings: Iterable[CaseFinding]) -> list[dict[str, Any]]:
    """Return a row for each family: the number of cases per outcome, and the worst accurate one."""
    families: dict[str, list[CaseFinding]] = {}
    for finding in findings:
        families.setdefault(finding.case.family, []).append(finding)
    rows = []
    for family, members in families.items():
        counts = Counter(finding.outcome for finding in members)
        accurate = [f for f in members if f.outcome == "accurate"]
        worst = max(accurate, key=lambda f: f.error or 0.0, default=None)
        row = {"family": family, "cases": len(members)}
        row |= {outcome: counts[outcome] for outcome in OUTCOMES}
        row["worst error"] = worst and worst.error
        row["at"] = worst and f"{worst.case.model}, {worst.case.name}"
        rows.append(row)
    return rows


def _answer(runner: Runner, question: str) -> str:
    """Run and assess a case that is given as JSON; answer as JSON."""
    facts = json.loads(question)
    facts["references"] = tuple(Counterpart(**each) for each in facts["references"])
    _, *ending = assess(Case(**facts), runner)
    return json.dumps(ending)


class _CaseWorker:
    """A child process that runs one case at a time; a new one replaces it if it is killed."""

    def __init__(self, runner: str) -> None:
        self._runner = runner
        self._lock = threading.Lock()
        self._is_closed = False
        self._process = self._start()

    def assess(self, case: Case, timeout: float) -> CaseFinding:
        began, late = perf_counter(), threading.Event()

        def kill() -> None:
            late.set()
            self._process.kill()

        guard = threading.Timer(min(timeout, MOST_WAIT), kill)
        guard.start()
        answer = ""
        with suppress(OSError, EOFError):
            answer = self._process.ask(json.dumps(asdict(case)))
        guard.cancel()
        guard.join()  # else it might end the process in the next case
        if answer and not late.is_set():
            return CaseFinding(case, *json.loads(answer))
        seconds, code = perf_counter() - began, self._process.end()
        with self._lock:
            if not self._is_closed:
                self._process = self._start()
        if late.is_set():
            return CaseFinding(case, "hang", None, f"killed after {timeout:g} s", seconds)
        return CaseFinding(case, "crash", None, f"the process ended with code {code}", seconds)

    def close(self) -> None:
        """End the child process, also while it runs a case."""
        with self._lock:
            self._is_closed = True
        self._process.end()

    def _start(self) -> Child:
        return Child(MODULE, [self._runner], asked=True)


if __name__ == "__main__":
    look_where_the_parent_does()
    module, _, function = sys.argv[1].partition(":")
    answer_questions(partial(_answer, getattr(import_module(module), function)))
