"""The runs that a command line asks for."""

import argparse
import csv
import sys
from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np

from casadi_models.dae import Dae
from cosim.api import run_scene
from cosim.cli.arguments import names_in, scene_from, start_numbers
from cosim.errors import Interrupted, SolverError, UsageError
from cosim.model.catalogue import load
from cosim.scene.goals import GOALS
from cosim.scene.roads import variant
from cosim.scene.scene import Scene
from cosim.trajectory import Column, Trajectory


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
            scene = scene_of(one)
            if everything and scene is not None:
                scene = replace(scene, outputs=(), figures=())
            seconds = [second_of(one, scene, name) for name in names_in(one.compare or "") if name]
            run, code = run_or_partial(one, scene)
            runs.append(_named(run, one.variation))
            scenes.append(scene)
            for other in seconds:
                runs.append(run_scene(*other, compiled=False if args.interpreted else None))
                scenes.append(other[0])
            worst = max(worst, code)
    return runs, scenes, worst


def read_result(path: str, model: str | None) -> Trajectory:
    """Read a result as `simulate` writes it; the model tells units and meanings.

    Raises:
        UsageError: It is no such file.
    """
    dae = None if model is None else load(model)
    try:
        with Path(path).open(newline="", encoding="utf-8") as stream:
            header, *rows = csv.reader(stream)
        table = np.array(rows, dtype=float).reshape(-1, len(header))
    except (OSError, ValueError) as error:
        raise UsageError(f"{path} is no result of a run: {error}") from error
    if header[:1] != ["time"]:
        raise UsageError(f"{path}: its first column is '{header[0]}'; give a result, time first")
    columns = tuple(_column(name, dae) for name in header[1:])
    return Trajectory(Path(path).stem, table[:, 0], columns, table[:, 1:])


def _column(name: str, dae: Dae | None) -> Column:
    try:
        v = dae.variable(name) if dae else None
    except KeyError:
        v = None
    return Column(name, v.unit, v.display_unit, v.nominal, v.meaning) if v else Column(name)


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


def _named(run: Trajectory, variation: str) -> Trajectory:
    return replace(run, stats={**run.stats, "variation": variation}) if variation else run


def scene_of(args: argparse.Namespace) -> Scene | None:
    """Return the scene that a command line asks for; None for an FMU."""
    if args.model.endswith(".fmu"):
        return None
    refuse_timeout(args)
    return scene_from(args)


def refuse_timeout(args: argparse.Namespace) -> None:
    """Refuse a time limit for what has none."""
    if args.timeout is not None:
        raise UsageError("--timeout is for FMU files; a model's run ends at its step limit")


def run_or_partial(args: argparse.Namespace, scene: Scene | None) -> tuple[Trajectory, int]:
    """Return a run and its exit code; of a failed run, what was computed."""
    try:
        run = _run(args, scene)
        for text in run.stats.get("invalid", ()):
            print(f"warning: {run.model}: {text}", file=sys.stderr)
        if "error_estimate" in run.stats and not args.quiet:
            from cosim.study.accuracy.solver_selection import promise_kept

            print(promise_kept(run), file=sys.stderr)
        return run, 0
    except SolverError as error:
        if not isinstance(error.partial, Trajectory) or not len(error.partial):
            raise
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return error.partial, error.exit_code
    except Interrupted as error:
        if not isinstance(error.partial, Trajectory) or not len(error.partial):
            raise
        print(error, file=sys.stderr)
        return error.partial, 130


def _run(args: argparse.Namespace, scene: Scene | None) -> Trajectory:
    if scene is not None:
        if args.interface_type is not None:
            raise UsageError("--interface-type is for FMUs; a model takes --solver")
        return run_scene(
            scene,
            compiled=False if args.interpreted else None,
            on_invalid=args.on_invalid or "warn",
            drift_control=args.drift_control,
        )
    from cosim.fmi.run.isolated import simulate_apart

    own = (
        "solver",
        "absolute_tolerance",
        "step_size",
        "on_invalid",
        "drift_control",
        "interpreted",
    )
    for option in (*own, *GOALS):
        if getattr(args, option) not in (None, False):
            raise UsageError(f"--{option.replace('_', '-')} is for models; an FMU has its own")
    return simulate_apart(
        args.model,
        timeout=args.timeout,
        interface=args.interface_type,
        start_time=args.start_time,
        stop_time=args.stop_time,
        output_interval=args.output_interval,
        relative_tolerance=args.relative_tolerance,
        start=start_numbers(args, None),
        outputs=None if args.outputs is None else names_in(args.outputs),
    )


def second_of(
    args: argparse.Namespace, scene: Scene | None, name: str | None = None
) -> tuple[Scene, str | None]:
    """Return scene and road of the run that `--compare` asks for."""
    if scene is None:
        raise UsageError("--compare is for models and scenes; an FMU has one road only")
    return variant(scene, name or args.compare)
