"""The runs that a command line asks for."""

import argparse
from collections.abc import Iterator
from dataclasses import replace
from itertools import product

import numpy as np

from cosim.api import run_scene
from cosim.cli.arguments import names_in, number_in
from cosim.cli.running import run_or_partial, scene_or_none
from cosim.errors import ParameterError, UsageError
from cosim.integrate.run.outputs import all_columns
from cosim.model.catalogue import load
from cosim.scene.roads import Road
from cosim.scene.scene import Scene
from cosim.scene.variants import variant
from cosim.trajectory import Trajectory


def runs_of(
    args: argparse.Namespace, *, everything: bool = False
) -> tuple[list[Trajectory], list[Scene | None], int]:
    """Run every source of a command line with every value of its lists, `-p NAME=A,B`.

    Args:
        args: `sources` are models, scenes, FMUs and results; of each, `compare` names more roads.
        everything: Whether scenes compute all outputs, whatever they want.

    Returns:
        The runs; the scene of each, None for an FMU or a result; and the exit code.

    Raises:
        CosimError: A source or an option is wrong, or a run left nothing to show.
    """
    runs: list[Trajectory] = []
    scenes: list[Scene | None] = []
    worst = 0
    for source in args.sources:
        if source.endswith(".csv"):
            runs.append(read_result(source, args.shown_model))
            scenes.append(None)
            continue
        for one in _single(args, source):
            scene = scene_or_none(one)
            if everything and scene is not None:
                scene = replace(scene, outputs=(), figures=())
            seconds = [second_of(scene, name) for name in names_in(one.compare or "") if name]
            run, code = run_or_partial(one, scene)
            stats = {**run.stats, "variation": one.variation}
            runs.append(replace(run, stats=stats) if one.variation else run)
            scenes.append(scene)
            for other in seconds:
                runs.append(run_scene(*other, compiled=False if args.interpreted else None))
                scenes.append(other[0])
            worst = max(worst, code)
    return runs, scenes, worst


def read_result(path: str, model: str | None) -> Trajectory:
    """Read a result from a CSV file; a model tells units and meanings.

    Raises:
        UsageError: It cannot be read.
    """
    if model is None:
        return Trajectory.read_csv(path)
    dae = load(model)
    like = Trajectory(model, np.empty(0), all_columns(dae), np.empty((0, len(all_columns(dae)))))
    return Trajectory.read_csv(path, like=like)


def _single(args: argparse.Namespace, source: str) -> Iterator[argparse.Namespace]:
    """Yield a command line of one source for every value of the lists of `-p`."""
    choices = []
    for item in args.values:
        name, equals, text = item.partition("=")
        texts = text.split(",") if equals else [text]
        choices.append([f"{name}{equals}{one}" for one in texts])
    lists = [i for i, items in enumerate(choices) if len(items) > 1]
    for chosen in product(*choices):
        variation = ", ".join(chosen[i] for i in lists)
        changes = {"model": source, "values": list(chosen), "variation": variation}
        yield argparse.Namespace(**{**vars(args), **changes})


def second_of(scene: Scene | None, name: str) -> tuple[Scene, Road]:
    """Return scene and road of a run that `--compare` asks for.

    Raises:
        UsageError: The first one is that of an FMU.
        UnknownName: There is no such road, solver or formulation.
    """
    if scene is None:
        raise UsageError("--compare is for models and scenes; an FMU has one road only")
    return variant(scene, name)


def size_of(args: argparse.Namespace) -> tuple[float, float]:
    """Return width and height of a picture, inches, from `--size WxH`."""
    width, cross, height = args.size.partition("x")
    if not cross:
        raise ParameterError(f"--size {args.size}: write WIDTHxHEIGHT in inches, e.g. 6.4x4.8")
    return number_in("--size", width), number_in("--size", height)
