"""Trials of an FMU's code in processes of their own."""

import json
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import monotonic
from typing import Any

from cosim.errors import FmuError
from cosim.fmi.archive import unpacked
from cosim.fmi.check.finding import ADVICE, TRIAL_RULES, WRONG, Finding, Rule
from cosim.fmi.check.libraries import sources
from cosim.fmi.check.trials import derivatives, motion, ramps, start, steps, switching, values
from cosim.fmi.check.trials.bench import Bench, Skipped, Trial
from cosim.fmi.run.description import INTERFACES, choose_interface
from cosim.fmi.run.isolated import how_it_ended
from cosim.host.child import be_confined, leave, own_folder, run_confined
from cosim.host.limits import chosen_limits
from cosim.model.values import time_limit_from
from cosim.text import sentence

TRIALS: tuple[Trial, ...] = (
    *(start.start, start.initialization, values.defaults, values.settings, start.time),
    *(steps.exchange, start.reset, start.instances, start.rollback),
    *(derivatives.derivatives, derivatives.dependencies, derivatives.slopes, start.fixed),
    *(start.callbacks, start.logger, steps.quiet, steps.memory),
    *(motion.motion, ramps.ramps, switching.switching, values.bounds),
    *(steps.stop, steps.steps, steps.calls, sources),
)
"""All trials; the first must pass before any other runs."""
OPTIONAL = frozenset({"logger", "memory"})  # the latter makes thousands of instances
"""Trials that require more than the FMI does: their findings are advice."""
NO_CODE = frozenset({"sources"})
"""Trials that wait for a compiler, and do not run the FMU."""


_ANSWER = "answer.jsonl"
_TrialTask = tuple[str, str]  # a trial's name and an interface
FAILED = "stop there"  # importers, where a function returns an error


@dataclass
class TrialResults:
    """The results of the trials of an FMU.

    Attributes:
        findings: What they found.
        passed: Trials that found nothing, as "reset (CoSimulation)", with how far they went.
        skipped: Trials that do not apply, with the reason.
    """

    findings: list[Finding] = field(default_factory=list)
    passed: list[str] = field(default_factory=list)
    skipped: list[str] = field(default_factory=list)

    def read(
        self, lines: list[dict[str, Any]], tasks: list[_TrialTask], code: int | None, timeout: float
    ) -> list[_TrialTask]:
        """Add the answer of a child process; return the trials that are still to be made."""
        left, running, failed = list(tasks), None, set[str]()
        began = 0.0
        for line in lines:
            if begun := line.get("begun"):
                running, began = (begun[0], begun[1]), begun[2]
                left.remove(running)
                continue
            assert running is not None
            if self._take(running, line) and running[0] == TRIALS[0].__name__:
                failed.add(running[1])
            running = None
        if running is not None and self._stopped(running, code, monotonic() - began, timeout):
            failed.update({running[1]} if running[0] == TRIALS[0].__name__ else ())
        return [task for task in left if task[1] not in failed]  # who does not start, does nothing

    def _take(self, task: _TrialTask, answer: Mapping[str, Any]) -> bool:
        """Add the answer of a trial; return whether it found anything."""
        found = [Finding(**one) for one in answer["findings"]]
        known = {(f.place, f.found): f.rule for f in self.findings if f.importers == FAILED}
        same = next((known[key] for f in found if (key := (f.place, f.found)) in known), "")
        if not same:
            self.findings += found
        if reason := answer["skipped"] or (same and f"it fails like {same}"):
            self.skipped.append(f"{_called(task)}: {reason}")
        elif not found:
            self.passed.append(_called(task) + "".join(f": {note}" for note in answer["notes"]))
        return bool(found)

    def _stopped(self, task: _TrialTask, code: int | None, own: float, timeout: float) -> bool:
        """Add a trial without an answer, after a time, s; return whether its FMU is to blame."""
        if code is None and (own < timeout / 2 or task[0] in NO_CODE):
            self.skipped.append(f"{_called(task)}: the time is up; --timeout gives more")
            return False
        crash = TRIAL_RULES["crash"]
        rule = replace(crash, level=ADVICE) if task[0] in OPTIONAL else crash
        how = f"did not return within {own:.3g} s" if code is None else how_it_ended(code)
        self.findings.append(rule.at(_called(task), f"the FMU {how}"))
        return True


def try_apart(
    path: str | os.PathLike[str], *, timeout: float, trials: Sequence[Trial] = TRIALS
) -> TrialResults:
    """Run the trials of an FMU in a child process with the limits of `chosen_limits`.

    Args:
        path: The FMU. Its binary runs with the rights of this user.
        timeout: Wall time, s, after which the child is ended; infinity for no limit.

    Raises:
        FmuError, SecurityError: It cannot be run here at all, see `simulate_fmu`.
    """
    timeout = time_limit_from(str(path), timeout)
    chosen_limits()
    with own_folder() as folder, unpacked(path) as files:
        bench = Bench(files, str(path), timeout)
        try:
            offered = bench.described.interfaces
        except ValueError as error:
            raise FmuError(f"{path}: {error}") from error
        kinds = [kind for kind in INTERFACES if kind in offered]
        if not kinds:
            raise FmuError(f"{path} has neither model exchange nor co-simulation; nothing can run")
        for kind in kinds:
            choose_interface(files, bench.fmpy, kind, path)
        given = [str(folder / _ANSWER), str(files), str(path), str(timeout)]
        end, answers = monotonic() + timeout, TrialResults()
        tasks = [(trial.__name__, str(kind)) for kind in kinds for trial in trials]
        while tasks and (left := end - monotonic()) > 0:
            (folder / _ANSWER).unlink(missing_ok=True)
            code, _ = run_confined(__name__, [*given, json.dumps(tasks)], folder, left)
            before = len(tasks)
            with suppress(FileNotFoundError):
                text = (folder / _ANSWER).read_text()
                lines = text[: text.rfind("\n") + 1].splitlines()  # one may have been cut off
                tasks = answers.read([json.loads(line) for line in lines], tasks, code, timeout)
            if len(tasks) == before and code is not None:
                raise FmuError(f"{path}: the trials could not be begun (exit code {code})")
        answers.skipped += [f"{_called(task)}: the time is up" for task in tasks]
        return answers


def _called(task: _TrialTask) -> str:
    return f"{task[0]} ({task[1]})"


def _tried(bench: Bench, trial: Trial, kind: str) -> dict[str, Any]:
    """Return what a trial found, what it noted, and why it was skipped."""
    findings: list[Finding] = []
    notes: list[str] = []
    skipped = ""
    try:
        for one in trial(bench, kind):
            if isinstance(one, Finding):
                findings.append(one)
            else:
                notes.append(str(one))
    except Skipped as reason:
        skipped = str(reason)
    except Exception as error:
        fault = f"the FMU failed: {sentence(str(error)) or type(error).__name__}"
        level = ADVICE if trial.__name__ in OPTIONAL else WRONG
        rule = Rule(trial.__name__, level, FAILED, "fix it; see its log")
        findings.append(rule.at(kind, fault))
    return {"findings": [f.row() for f in findings], "notes": notes, "skipped": skipped}


def _outcome_lines(bench: Bench, tasks: list[_TrialTask]) -> Iterator[dict[str, Any]]:
    trials, failed = {trial.__name__: trial for trial in TRIALS}, set()
    for name, kind in tasks:
        if kind in failed:
            continue
        yield {"begun": (name, kind, monotonic())}
        answer = _tried(bench, trials[name], kind)
        yield answer
        if any("(fatal)" in one["found"] for one in answer["findings"]):
            return  # no instance may be made after that, but in another process
        if trials[name] is steps.memory:
            return  # which may have used up what a process has, such as keys of its threads
        if answer["findings"] and trials[name] is TRIALS[0]:
            failed.add(kind)


def _main(answer: Path, bench: Bench, tasks: list[_TrialTask]) -> None:
    be_confined()
    with answer.open("w", encoding="utf-8") as stream:
        for line in _outcome_lines(bench, tasks):
            stream.write(json.dumps(line) + "\n")
            stream.flush()
    leave()


if __name__ == "__main__":
    _answer, _files, _name, _timeout, _tasks = sys.argv[1:]
    _bench = Bench(Path(_files), _name, float(_timeout))
    _main(Path(_answer), _bench, json.loads(_tasks))
