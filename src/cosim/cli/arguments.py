"""From the words on the command line to a `Scene`: a model or a scene, and what overrides it."""

import argparse
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

from casadi_models.dae import Dae
from cosim.errors import ParameterError, UnknownName, UsageError
from cosim.model.catalogue import load
from cosim.model.driving import with_laws
from cosim.model.inputs import read_inputs
from cosim.model.quantities import quantity
from cosim.model.start_outputs import overriding
from cosim.scene.goals import GOALS, OVERRULED
from cosim.scene.scene import Scene
from cosim.scene.scene_file import read_scene
from cosim.scene.variants import with_solver, without_goal

_RUN_SETTINGS = (
    "start_time",
    "stop_time",
    "output_interval",
    "relative_tolerance",
    "absolute_tolerance",
    "step_size",
    "accuracy",
)


def scene_from(args: argparse.Namespace) -> Scene:
    """Return the scene that a command line asks for; its options override the scene's file.

    Raises:
        CosimError: The model, the scene or an option is wrong; see `read_scene` and `load`.
    """
    scene = _driven_scene(args, named_scene(args.model))
    given = {key: getattr(args, key, None) for key in _RUN_SETTINGS}
    changes = {key: value for key, value in given.items() if value is not None}
    if getattr(args, "budget", None) is not None:
        changes["budget"] = 1e-3 * args.budget
    if changes.keys() & set(GOALS):
        overruled: dict[str, Any] = dict.fromkeys((*OVERRULED, *GOALS))
        scene = replace(scene, settings=replace(scene.settings, **overruled))
    elif changes.keys() & set(OVERRULED):
        scene = without_goal(scene)
    if getattr(args, "solver", None) is not None:
        scene = with_solver(scene, args.solver)
    scene = replace(scene, settings=replace(scene.settings, **changes))
    if args.outputs is not None:
        scene = replace(scene, outputs=names_in(args.outputs), figures=())
    numbers = start_numbers(args, scene.dae) if "values" in args else {}
    varying = {variable.name for variable in scene.dae.inputs} - numbers.keys()
    inputs = scene.inputs and scene.inputs.only(varying)
    return replace(scene, values=overriding(scene.dae, scene.values, numbers), inputs=inputs)


def _driven_scene(args: argparse.Namespace, scene: Scene) -> Scene:
    """Return a scene with the formulas and time series that a command line gives for inputs."""
    if laws := _laws(args):
        names = {name for name, _ in laws}
        dae = with_laws(scene.dae, tuple(laws))
        left = {variable.name for variable in dae.inputs}
        values = {name: value for name, value in scene.values.items() if name not in names}
        inputs = scene.inputs and scene.inputs.only(left)
        scene = replace(scene, dae=dae, values=values, inputs=inputs)
    if (path := getattr(args, "input_file", None)) is not None:
        series = read_inputs(path, scene.dae)
        values = {n: v for n, v in scene.values.items() if n not in series.names}
        scene = replace(scene, inputs=series, values=values)
    return scene


def inputs_in(args: argparse.Namespace) -> dict[str, Any]:
    """Return what a command line says of an FMU's inputs: formulas of time, and time series.

    Raises:
        UsageError: One is not written like that, or is given twice.
    """
    inputs: dict[str, Any] = dict(_laws(args))
    if args.input_file is not None:
        series = read_inputs(args.input_file)
        if twice := inputs.keys() & set(series.names):
            raise UsageError(f"{min(twice)} has a formula and a column; give one of them")
        inputs |= dict.fromkeys(series.names, series)
    return inputs


def _laws(args: argparse.Namespace) -> list[tuple[str, str]]:
    return [*assigned("--input", getattr(args, "laws", ()), "FORMULA")]


def assigned(option: str, items: Iterable[str], form: str) -> Iterator[tuple[str, str]]:
    """Yield name and text of what an option was given as NAME=TEXT.

    Raises:
        UsageError: Something is not written like that.
    """
    for item in items:
        name, equals, text = (part.strip() for part in item.partition("="))
        if not equals:
            raise UsageError(f"{option} {item}: write NAME={form}")
        yield name, text


def times_in(option: str, text: str) -> list[float]:
    """Return the times of a list with commas, s; each may have a unit.

    Raises:
        ParameterError: One is no time.
    """
    return [quantity(option, word, "s") for word in text.split(",")]


def names_in(text: str) -> tuple[str, ...]:
    """Return the names of a list with commas."""
    return tuple(name.strip() for name in text.split(","))


def numbers_in(option: str, text: str) -> tuple[float, ...]:
    """Return the numbers of a list with commas."""
    return tuple(number_in(option, word) for word in text.split(","))


def number_in(option: str, text: str) -> float:
    """Read a number of an option.

    Raises:
        ParameterError: It is none.
    """
    try:
        return float(text)
    except ValueError:
        raise ParameterError(f"{option}: '{text}' is not a number") from None


def named_scene(name: str) -> Scene:
    """Return the scene of a file `NAME.toml`, or a model as a scene without settings."""
    return read_scene(name) if name.endswith(".toml") else Scene(name, load(name))


def start_numbers(args: argparse.Namespace, dae: Dae | None) -> dict[str, float]:
    """Read `-p NAME=VALUE[UNIT]` and `--start-values NAME VALUE ...`; no units without a model.

    Raises:
        UsageError, ParameterError: Something is not written like that, or is given twice.
        UnknownName: The model has no such variable.
    """
    words = args.start_values
    if len(words) % 2:
        raise UsageError(f"--start-values: '{words[-1]}' has no value; give NAME VALUE pairs")
    pairs = zip(words[::2], words[1::2], strict=True)
    numbers: dict[str, float] = {}
    for name, text in (*pairs, *assigned("-p", args.values, "VALUE[UNIT]")):
        if name in numbers:
            raise UsageError(f"{name} is given twice; give it once")
        numbers[name] = value_in(name, text, None if dae is None else _unit_of_name(dae, name))
    return numbers


def value_in(name: str, text: str, unit: str | None) -> float:
    """Read the number of a variable, in SI units; in its own where nobody knows its unit.

    Raises:
        ParameterError: It is none, or its unit does not fit.
    """
    if unit is not None:
        return quantity(name, text, unit)
    try:
        return float(text)
    except ValueError:
        raise ParameterError(
            f"{name} = {text}: give a number in the FMU's own unit, and no unit"
        ) from None


def _unit_of_name(dae: Dae, name: str) -> str:
    try:
        return dae.variable(name).unit
    except KeyError:
        known = [v.name for v in (*dae.states, *dae.parameters, *dae.inputs)]
        kind = "state, parameter or input"
        raise UnknownName.of_model(dae.full_name, kind, name, known) from None
