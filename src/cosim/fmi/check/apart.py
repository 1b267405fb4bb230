"""The trials of an FMU in a child process with limits: what it breaks is told, not suffered."""

import json
import os
import sys
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from cosim.errors import FmuError
from cosim.fmi.archive import unpacked
from cosim.fmi.check.bench import Bench, Skipped
from cosim.fmi.check.finding import WRONG, Finding
from cosim.fmi.check.trials import TRIALS, Trial
from cosim.fmi.run.instance import INTERFACES, choose_interface
from cosim.fmi.run.isolated import how_it_ended
from cosim.host.child import own_folder, run_confined
from cosim.host.inside import be_confined, leave
from cosim.host.limits import Limits
from cosim.model.values import number
from cosim.text.escaping import sentence

_ANSWER = "answer.jsonl"


@dataclass(frozen=True)
class Verdict:
    """What the trials of an FMU gave.

    Attributes:
        findings: What they found.
        passed: Trials that found nothing, as "reset (CoSimulation)".
        skipped: Trials that do not apply, with the reason.
    """

    findings: tuple[Finding, ...]
    passed: tuple[str, ...]
    skipped: tuple[str, ...]


def try_apart(path: str | os.PathLike[str], *, timeout: float = 120.0) -> Verdict:
    """Run the trials of an FMU in a child process with the limits of `Limits.chosen`.

    Args:
        path: The FMU. Its binary runs with the rights of this user.
        timeout: Wall time, s, after which the child is ended.

    Raises:
        FmuError, SecurityError: It cannot be run here at all, see `simulate_fmu`.
    """
    number(str(path), "timeout", timeout, positive=True)
    Limits.chosen()
    with own_folder() as folder, unpacked(path) as files:
        bench = Bench(files, str(path))
        try:
            offered = bench.described.interfaces
        except ValueError as error:
            raise FmuError(f"{path}: {error}") from error
        kinds = [kind for kind in INTERFACES if kind in offered]
        if not kinds:
            raise FmuError(f"{path} has neither model exchange nor co-simulation; nothing can run")
        for kind in kinds:
            choose_interface(files, bench.fmpy, kind, path)
        words = [str(folder / _ANSWER), str(files), str(path), *kinds]
        code, _ = run_confined(__name__, words, folder, timeout)
        with suppress(FileNotFoundError):
            lines = (folder / _ANSWER).read_text().splitlines()
            return _verdict([json.loads(line) for line in lines], code, timeout)
        raise FmuError(f"{path}: the trials could not be begun (exit code {code})")


def _verdict(lines: list[dict[str, object]], code: int | None, timeout: float) -> Verdict:
    findings: list[Finding] = []
    told: dict[str, list[str]] = {"passed": [], "skipped": []}
    open_trial = ""
    for line in lines:
        match line:
            case {"begun": str(name)}:
                open_trial = name
            case {"ended": str(name), "findings": list(found), "skipped": str(why)}:
                open_trial = ""
                findings += [Finding(**one) for one in found]
                if why:
                    told["skipped"].append(f"{name}: {why}")
                elif not found:
                    told["passed"].append(name)
    if open_trial:
        how = f"did not end within {timeout:g} s" if code is None else how_it_ended(code)
        findings.append(
            Finding(WRONG, "crash", open_trial, f"the FMU {how}", "mend it; do not use it")
        )
    return Verdict(tuple(findings), tuple(told["passed"]), tuple(told["skipped"]))


def _tried(bench: Bench, trial: Trial, kind: str) -> tuple[list[Finding], str]:
    """Return the findings of a trial, and why it was skipped."""
    try:
        return list(trial(bench, kind)), ""
    except Skipped as skipped:
        return [], str(skipped)
    except Exception as error:
        told = f"the FMU failed: {sentence(str(error)) or type(error).__name__}"
        return [Finding(WRONG, trial.__name__, kind, told, "mend it; see its log")], ""


def _lines(bench: Bench, kinds: list[str]) -> Iterator[dict[str, object]]:
    for kind in kinds:
        for trial in TRIALS:
            name = f"{trial.__name__} ({kind})"
            yield {"begun": name}
            findings, why = _tried(bench, trial, kind)
            yield {"ended": name, "findings": [f.row() for f in findings], "skipped": why}
            if findings and trial is TRIALS[0]:
                break  # what does not start is not tried further


def _main(answer: Path, files: Path, name: str, kinds: list[str]) -> None:
    be_confined()
    with answer.open("w", encoding="utf-8") as stream:
        for line in _lines(Bench(files, name), kinds):
            stream.write(json.dumps(line) + "\n")
            stream.flush()
    leave()


if __name__ == "__main__":
    _main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3], sys.argv[4:])
