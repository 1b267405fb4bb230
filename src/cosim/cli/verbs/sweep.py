"""`cosim sweep`: many runs of a model, a scene or an FMU, and the table of them."""

import argparse
import re
from collections.abc import Sequence
from typing import Any

from cosim.cli.arguments import TIMES, assigned, names_in, numbers_in, options_in, spaced, value_in
from cosim.cli.tables import note, show_table, write_text
from cosim.errors import ParameterError, UnknownName, UsageError
from cosim.fmi.trust import require_trust
from cosim.host.optional_packages import optional_module
from cosim.model.quantities import reject_mixed_units
from cosim.study.sweep.samples import Samples, chosen_samples
from cosim.study.sweep.subject import Subject, open_subject
from cosim.study.sweep.sweep import sweep
from cosim.text import counted

_OF_SWEEP = ("keep", "store", "resume", "scheduler", "workers")
_OF_RUNS = (
    *(*TIMES, "solver", "relative_tolerance", "absolute_tolerance"),
    *("step_size", "max_step", "on_invalid"),
)
_DISTRIBUTION = re.compile(r"(\w+)\((.*)\)")
_DISTRIBUTIONS = {  # names of their two arguments
    "normal": ("mean", "deviation"),
    "uniform": ("low", "high"),
    "loguniform": ("low", "high"),
}
_AXIS_FORMS = "A,B,C or A:B:N or A"


def run(args: argparse.Namespace) -> int:
    """Run the sweep and write its table of runs."""
    if args.model.lower().endswith(".fmu"):
        require_trust(args.model, trusted=args.trust)
    subject = open_subject(args.model, apart=True)
    result = sweep(
        subject,
        samples=_samples(subject, args),
        progress=False if args.quiet else None,
        outputs=None if args.outputs is None else names_in(args.outputs),
        output_times=None if args.times is None else numbers_in("--times", args.times),
        **options_in(args, *_OF_SWEEP, *_OF_RUNS),
    )
    if args.output_file is not None or (args.store is None and not args.json):
        write_text(args.output_file, result.csv_text())
    if args.json:
        show_table(result.rows(), as_json=True)
    note(args, f"{counted(len(result), 'run')}: {result.status}")
    return 1 if args.strict and not result.complete.all() else 0


def _samples(subject: Subject, args: argparse.Namespace) -> Samples | None:
    """Return the samples of a command line; None for those in the store."""
    if args.samples is None and args.design is None and not args.values:
        if args.resume:
            return None
        raise UsageError("nothing varies; give --samples FILE.csv, -p NAME=A,B, or --design KIND:N")
    axes = _axes(subject, args.values, ranges=args.design is not None)
    if args.samples is None:
        return chosen_samples(axes, None, args.design or "grid", seed=args.seed)
    fixed = {name: values[0] if len(values) == 1 else values for name, values in axes.items()}
    return chosen_samples(fixed, args.samples, args.design)


def _axes(subject: Subject, items: Sequence[str], *, ranges: bool) -> dict[str, Any]:
    """Read `-p NAME=...`: ranges and distributions of a design, otherwise lists of values."""
    axes: dict[str, Any] = {}
    for name, text in assigned("-p", items, _AXIS_FORMS):
        words = text.split(":")[:2] if ":" in text else re.split("[,()]", text)
        reject_mixed_units(f"-p {name}", words)
        axes[name] = _range(subject, name, text) if ranges else _values(subject, name, text)
    return axes


def _values(subject: Subject, name: str, text: str) -> list[float]:
    parts = text.split(":")
    if len(parts) == 3:
        low, high = (_si_value(subject, name, part) for part in parts[:2])
        return spaced(f"-p {name}={text}", low, high, parts[2].strip())
    if len(parts) != 1 or _DISTRIBUTION.fullmatch(text):
        raise UsageError(f"-p {name}={text}: write {_AXIS_FORMS}; ranges are for --design KIND:N")
    return [_si_value(subject, name, part) for part in text.split(",")]


def _range(subject: Subject, name: str, text: str) -> Any:
    if call := _DISTRIBUTION.fullmatch(text):
        return _distribution(subject, name, call[1], call[2].split(","))
    parts = text.split(":")
    if len(parts) > 2 or "," in text:
        raise UsageError(f"-p {name}={text}: a design needs A:B, a distribution, or one value")
    numbers = tuple(_si_value(subject, name, part) for part in parts)
    return numbers[0] if len(numbers) == 1 else numbers


def _distribution(subject: Subject, name: str, kind: str, words: Sequence[str]) -> Any:
    UnknownName.reject(f"-p {name}", "distribution", _DISTRIBUTIONS, kind)
    if len(words) != 2:
        raise UsageError(f"-p {name}: write {kind}({', '.join(_DISTRIBUTIONS[kind])})")
    first = _si_value(subject, name, words[0])
    second = _si_value(subject, name, words[1], difference=kind == "normal")
    stats = optional_module("scipy.stats", "sweep")
    if kind == "normal":
        if second <= 0:
            raise ParameterError(f"-p {name}: the deviation {second:g} is not positive")
        return stats.norm(first, second)
    if not first < second or (kind == "loguniform" and first <= 0):
        raise ParameterError(f"-p {name}: {kind}({first:g}, {second:g}) is no range")
    return stats.loguniform(first, second) if kind == "loguniform" else (first, second)


def _si_value(subject: Subject, name: str, text: str, *, difference: bool = False) -> float:
    unit = subject.unit(name) if subject.takes_units else None
    return value_in(name, text.strip(), unit, difference=difference)
