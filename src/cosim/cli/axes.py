"""`-p NAME=...` of a sweep: values, evenly spaced values, ranges and distributions."""

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from cosim.cli.arguments import assigned, value_in
from cosim.errors import ParameterError, UnknownName, UsageError
from cosim.host.optional_packages import optional_module
from cosim.study.sweep.subjects.opening import as_subject, opened_subject
from cosim.study.sweep.subjects.subject import Opened

_DISTRIBUTION = re.compile(r"(\w+)\((.*)\)")
_DISTRIBUTIONS = {  # arguments as people say them
    "normal": ("mean", "deviation"),
    "uniform": ("low", "high"),
    "loguniform": ("low", "high"),
}
_AXIS_FORMS = "A,B,C or A:B:N or A"


def read_axes(model: str, items: Sequence[str], *, ranges: bool) -> dict[str, Any]:
    """Read what a sweep varies.

    Args:
        model: What is swept, for the units.
        items: `NAME=...` each.
        ranges: Whether ranges and distributions may stand there, and lists may not.

    Raises:
        UsageError, ParameterError, UnknownName: Something is not written like that.
    """
    thing = opened_subject(as_subject(model))
    axes: dict[str, Any] = {}
    for name, text in assigned("-p", items, _AXIS_FORMS):
        if name in axes:
            raise UsageError(f"{name} is given twice; give it once")
        axes[name] = _range(thing, name, text) if ranges else _listed_values(thing, name, text)
    return axes


def _listed_values(thing: Opened, name: str, text: str) -> list[float]:
    parts = text.split(":")
    if len(parts) == 3:
        low, high = (_si_value(thing, name, part) for part in parts[:2])
        if not parts[2].strip().isdecimal() or int(parts[2]) < 2:
            raise ParameterError(f"-p {name}={text}: write {name}=A:B:N with N of 2 or more")
        return [float(value) for value in np.linspace(low, high, int(parts[2]))]
    if len(parts) != 1 or _DISTRIBUTION.fullmatch(text):
        raise UsageError(f"-p {name}={text}: write {_AXIS_FORMS}; ranges are for --sample KIND:N")
    return [_si_value(thing, name, part) for part in text.split(",")]


def _range(thing: Opened, name: str, text: str) -> Any:
    if call := _DISTRIBUTION.fullmatch(text):
        return _distribution(thing, name, call[1], call[2].split(","))
    parts = text.split(":")
    numbers = tuple(_si_value(thing, name, part) for part in parts)
    if len(numbers) > 2:
        raise UsageError(f"-p {name}={text}: a design takes A:B, a distribution, or one value")
    return numbers[0] if len(numbers) == 1 else numbers


def _distribution(thing: Opened, name: str, kind: str, words: Sequence[str]) -> Any:
    if kind not in _DISTRIBUTIONS:
        raise UnknownName.among(f"-p {name}", "distribution", kind, _DISTRIBUTIONS)
    if len(words) != 2:
        raise UsageError(f"-p {name}: write {kind}({', '.join(_DISTRIBUTIONS[kind])})")
    first, second = (_si_value(thing, name, word) for word in words)
    stats = optional_module("scipy.stats", "sweep")
    if kind == "normal":
        if second <= 0:
            raise ParameterError(f"-p {name}: the deviation {second:g} is not positive")
        return stats.norm(first, second)
    if not first < second or (kind == "loguniform" and first <= 0):
        raise ParameterError(f"-p {name}: {kind}({first:g}, {second:g}) is no range")
    return (
        stats.uniform(first, second - first)
        if kind == "uniform"
        else stats.loguniform(first, second)
    )


def _si_value(thing: Opened, name: str, text: str) -> float:
    return value_in(name, text.strip(), thing.unit(name))
