"""Chunks over the processes of this machine; a process that dies takes one chunk with it."""

import pickle
from collections.abc import Callable
from queue import SimpleQueue
from threading import Thread
from typing import Any

from cosim.errors import CosimError
from cosim.host.child import ASKED, Child
from cosim.host.processes import was_killed
from cosim.study.sweep.chunk import Job, Summary, compute_chunk, lost, summary_of
from cosim.study.sweep.engines.schedule import Range, Schedule
from cosim.study.sweep.samples import Samples
from cosim.study.sweep.store import Store

WORKER = "cosim.study.sweep.engines.worker"
_MOST_FAILED_STARTS = 5  # of processes, one after the other

TellSummary = Callable[[Summary], None]


def run_here(job: Job, samples: Samples, schedule: Schedule, tell: TellSummary) -> None:
    """Compute all chunks in this process, one after the other."""
    while (chunk := schedule.take(wait=False)) is not None:
        summary = compute_chunk(job, chunk[0], samples.part(*chunk))
        schedule.done(chunk, summary.numbers, summary.seconds)
        tell(summary)


def run_processes(
    job: Job, samples: Samples, schedule: Schedule, tell: TellSummary, workers: int
) -> None:
    """Compute all chunks in processes of their own.

    Raises:
        CosimError: A chunk cannot be computed at all, or processes do not start.
        KeyboardInterrupt: Ctrl-C; the processes have ended.
    """
    news: SimpleQueue[Summary | BaseException | None] = SimpleQueue()
    crew = [_Worker(job, samples, schedule, news) for _ in range(workers)]
    left = workers
    try:
        for worker in crew:
            worker.start()
        while left:
            item = news.get()
            if isinstance(item, BaseException):
                raise item
            if item is None:
                left -= 1
            else:
                tell(item)
    finally:
        schedule.stop()
        for worker in crew:
            worker.end()


def after_death(
    job: Job, schedule: Schedule, chunk: Range, cause: str, *, killed: bool = False
) -> Summary | None:
    """Decide what becomes of a chunk whose process died; return what is settled by that.

    Args:
        job: What all chunks have in common.
        schedule: Of the chunks.
        chunk: The one.
        cause: Of the death, in words.
        killed: Whether somebody ended the process.
    """
    store = Store(job.store)
    if store.has(*chunk):  # it died afterwards
        summary = summary_of(store.read(*chunk))
        schedule.done(chunk, 0, 0.0)
        return summary
    began, at = store.last_begun(*chunk)
    if not began and schedule.given_up(chunk) < _MOST_FAILED_STARTS:
        return None
    run = schedule.died(chunk, at, killed=killed)
    if run is None:
        return None
    return lost(job, run, f"every process that computes it ends ({cause})")


class _Worker(Thread):
    """A thread that keeps one process busy, and replaces it when it dies."""

    def __init__(
        self, job: Job, samples: Samples, schedule: Schedule, news: "SimpleQueue[Any]"
    ) -> None:
        super().__init__(daemon=True)
        self._job, self._samples, self._schedule, self._news = job, samples, schedule, news
        self._process: Child | None = None
        self._ended = False

    def run(self) -> None:
        try:
            failed = 0
            while (chunk := self._schedule.take()) is not None:
                try:
                    self._ensure()
                    failed = 0
                except (OSError, EOFError, pickle.UnpicklingError) as error:
                    if self._process is not None:
                        self._process.end()
                    self._process = None
                    self._schedule.given_up(chunk)
                    failed += 1
                    if failed >= _MOST_FAILED_STARTS and not self._ended:
                        told = f"a process of the sweep ended {failed} times while it started"
                        raise CosimError(f"{told}; see above, or use workers=0") from error
                    continue
                self._compute(chunk)
        except BaseException as error:
            self._news.put(error)
        finally:
            self._news.put(None)

    def end(self) -> None:
        """End the process."""
        self._ended = True
        if self._process is not None:
            self._process.kill()
        if self.ident is not None:
            self.join(10)
        if self._process is not None:
            self._process.end()

    def _compute(self, chunk: Range) -> None:
        try:
            answer = self._ask((chunk[0], self._samples.part(*chunk)))
        except (OSError, EOFError, pickle.UnpicklingError):
            process, self._process = self._process, None
            code = None if process is None else process.end()
            if not self._ended:
                cause, killed = f"exit code {code}", was_killed(code)
                told = after_death(self._job, self._schedule, chunk, cause, killed=killed)
                if told is not None:
                    self._news.put(told)
            return
        if isinstance(answer, BaseException):
            raise answer
        self._schedule.done(chunk, answer.numbers, answer.seconds)
        self._news.put(answer)

    def _ensure(self) -> None:
        if self._process is not None:
            if self._process.wait(0) is None:
                return
            self._process.end()
        one = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        self._process = Child(WORKER, streams=ASKED, environment=one)
        if self._ended:
            self._process.kill()
        answer = self._ask(self._job)  # when it is ready
        if isinstance(answer, BaseException):
            raise CosimError(f"a process of the sweep cannot begin: {answer!r}") from answer

    def _ask(self, question: Any) -> Any:
        if self._process is None:
            raise EOFError
        return pickle.loads(self._process.ask(pickle.dumps(question)))
