"""Arguments of a command line as values; a wrong one raises a `CosimError` that names it."""

import argparse
import re
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from casadi_models.dae import Dae
from cosim.backend import Backend
from cosim.errors import ParameterError, UsageError
from cosim.integrate.keywords import requested
from cosim.model.catalogue import loaded
from cosim.model.driving import with_laws
from cosim.model.inputs import read_inputs
from cosim.model.quantities import quantity, reject_mixed_units
from cosim.model.request import RunRequest, choice
from cosim.model.solver import LIMITS
from cosim.model.start_outputs import overriding
from cosim.model.values import settable_variable, whole
from cosim.scene.scene import Scene
from cosim.scene.scene_file import read_scene
from cosim.scene.variants import with_solver

TIMES = ("start_time", "stop_time", "output_interval")
_NUMBERS = ("step_size", *LIMITS)
_POLICY = ("on_invalid", "drift_control", "stop_when", "record_events")
_COMMA = re.compile(r",(?![^\[\]]*\])")  # not between the indices of an element
_WHOLE = re.compile(r"[+-]?[0-9]{1,400}")
_NUMBER_FIRST = re.compile(r"[+-]?(\.?[0-9]|(inf|nan)\b)", re.IGNORECASE)


def scene_from(args: argparse.Namespace) -> Scene:
    """Return the scene of a command line, whose options override the file of the scene."""
    scene = named_scene(args.model)
    request = _with_inputs(args, scene.request)
    goal = options_in(args, "accuracy", "budget")
    if goal["budget"] is not None:
        goal["budget"] *= 1e-3
    solver = getattr(args, "solver", None)
    has_goal = any(value is not None for value in goal.values())
    if solver is not None and not has_goal:
        request = with_solver(request, solver)
    keywords = options_in(args, *TIMES, *_NUMBERS, *_POLICY) | goal
    if getattr(args, "at", None) is not None and runs_natively(args):
        for name in ("output_interval", "stop_time"):
            if getattr(args, name, None) is not None:
                option = f"--{name.replace('_', '-')}"
                raise UsageError(f"--at sets all output times; leave out {option}")
        keywords |= {"output_times": sorted(numbers_in("--at", args.at)), "stop_time": None}
    if args.outputs is not None:
        keywords["outputs"] = names_in(args.outputs)
        scene = replace(scene, figures=())
    request = requested(request, **keywords, solver=solver if has_goal else None)
    return replace(scene, request=with_values(args, request))


def options_in(args: argparse.Namespace, *names: str) -> dict[str, Any]:
    """Return the values of options by name; None where the verb has no such option."""
    return {name: getattr(args, name, None) for name in names}


def runs_natively(args: argparse.Namespace) -> bool:
    """Return whether the backend of a command line needs no FMU."""
    backend = getattr(args, "backend", None)
    return choice(Backend, "backend", Backend.NATIVE if backend is None else backend).native


def with_values(args: argparse.Namespace, request: RunRequest) -> RunRequest:
    """Return a request with the values of a command line, which end time series of the same."""
    numbers = start_numbers(args, request.dae) if "values" in args else {}
    values = overriding(request.dae, request.values, numbers)
    return replace(request.without_series(numbers), values=values)


def _with_inputs(args: argparse.Namespace, request: RunRequest) -> RunRequest:
    """Return a request whose inputs have the formulas and time series of a command line."""
    laws, path = laws_in(args), getattr(args, "input_file", None)
    if not laws and path is None:
        return request
    series = None if path is None else read_inputs(path, request.dae)
    driven = [*dict(laws), *(() if series is None else series.names)]
    _each_once([*((name, "") for name in driven), *start_texts(args)])
    dae = with_laws(request.dae, tuple(laws)) if laws else request.dae
    values = {name: value for name, value in request.values.items() if name not in driven}
    request = request.without_series(driven)
    return replace(request, dae=dae, values=values, inputs=series or request.inputs)


def laws_in(args: argparse.Namespace) -> list[tuple[str, str]]:
    """Return the names of inputs with the formulas of `--input`."""
    return assigned("--input", getattr(args, "laws", ()), "FORMULA")


def assigned(option: str, items: Iterable[str], form: str) -> list[tuple[str, str]]:
    """Return the names and texts of an option whose values are written as NAME=TEXT."""
    pairs = list[tuple[str, str]]()
    for item in items:
        name, equals, text = (part.strip() for part in item.partition("="))
        if not equals:
            raise UsageError(f"{option} {item}: write NAME={form}")
        pairs.append((name, text))
    return _each_once(pairs)


def numbers_in(option: str, text: str, unit: str = "s") -> list[float]:
    """Return the numbers of a list with commas in a unit; all or none may have units."""
    reject_mixed_units(option, text.split(","))
    return [quantity(option, word, unit) for word in text.split(",")]


def names_in(text: str) -> tuple[str, ...]:
    """Return the names of a list with commas."""
    return tuple(name.strip() for name in _COMMA.split(text))


def named_scene(name: str) -> Scene:
    """Return a model as a scene without settings, or a scene by its file."""
    if name.lower().endswith(".toml"):
        return read_scene(name)
    return Scene(name, RunRequest(loaded(name)), model=name)


def start_texts(args: argparse.Namespace) -> list[tuple[str, str]]:
    """Return names and texts of `-p` and `--start-values`."""
    words = args.start_values
    if len(words) % 2:
        raise UsageError(f"--start-values: '{words[-1]}' has no value; give NAME VALUE pairs")
    pairs = zip(words[::2], words[1::2], strict=True)
    return _each_once([*pairs, *assigned("-p", args.values, "VALUE[UNIT]")])


def start_numbers(args: argparse.Namespace, dae: Dae | None) -> dict[str, float]:
    """Return the values of `-p` and `--start-values` by name; they need a model to have units."""
    return {name: value_of(dae, name, text) for name, text in start_texts(args)}


def start_values_of_fmu(args: argparse.Namespace) -> dict[str, Any]:
    """Return the values of `-p` and `--start-values` by name, for variables of any type."""
    return {name: value_of_fmu(name, text) for name, text in start_texts(args)}


def _each_once(pairs: list[tuple[str, str]]) -> list[tuple[str, str]]:
    names = set[str]()
    for name, _ in pairs:
        if name in names:
            raise UsageError(f"{name} is given twice; give it once")
        names.add(name)
    return pairs


def value_of(dae: Dae | None, name: str, text: str) -> float:
    """Return the number of a variable in SI units; without a model, in its own unit."""
    return value_in(name, text, None if dae is None else settable_variable(dae, name).unit)


def value_of_fmu(name: str, text: str) -> float | str:
    """Return a number of all its digits, or a word, of which the type of the variable decides.

    Raises:
        ParameterError: It begins as a number, and goes on as a unit.
    """
    if _WHOLE.fullmatch(text):
        return int(text)
    return text if not _NUMBER_FIRST.match(text) else value_in(name, text, None)


def spaced(where: str, first: float, last: float, count: str) -> list[float]:
    """Return evenly spaced numbers.

    Raises:
        ParameterError: Their count is no whole number from 2 on, or too large.
    """
    if not _WHOLE.fullmatch(count) or int(count) < 2:
        raise ParameterError(f"{where}: write NAME=A:B:N with N of 2 or more")
    return [float(x) for x in np.linspace(first, last, whole(where, "N", int(count)))]


def value_in(name: str, text: str, unit: str | None, *, difference: bool = False) -> float:
    """Return the number of a variable in SI units, or in its own unit if that is not known.

    Args:
        name: Of the variable.
        text: Number and unit.
        unit: The variable's own, if it is known.
        difference: Whether it is a difference of two values, for which an offset does not count.
    """
    if unit is not None:
        return quantity(name, text, unit, difference=difference)
    if text.lower() in ("true", "false"):
        return float(text.lower() == "true")
    try:
        return float(text)
    except ValueError:
        raise ParameterError(
            f"{name} = {text}: give a number in the FMU's own unit, and no unit"
        ) from None
