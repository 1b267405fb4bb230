"""`cosim animate MODEL|SCENE.toml|FILE.fmu|RESULT.csv ... -o FILE`: runs in 3-D."""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace

from casadi_models.dae import Dae
from cosim.cli.arguments import names_in, start_numbers, times_in
from cosim.cli.runs import runs_of, size_of
from cosim.errors import UsageError
from cosim.model.catalogue import load
from cosim.present.playback.animate import animate, animation_format, guessed_model
from cosim.scene.scene import Scene


def run(args: argparse.Namespace) -> int:
    """Show runs in three dimensions."""
    animation_format(args.output_file)  # rejects it before anything is computed
    at = None if args.poses is None else times_in("--at", args.poses)
    size = size_of(args)
    tables = [name for name in args.sources if name.endswith(".csv")]
    if args.shown_model is None and tables:
        args.shown_model = guessed_model(tables)
        if not args.quiet:
            print(
                f"the result is drawn as {args.shown_model}, with its default parameters except "
                "those of -p",
                file=sys.stderr,
            )
    runs, scenes, code = runs_of(args, everything=args.outputs is None)
    model = args.shown_model
    if any(run.drawing is None for run in runs):  # parameters of the run of an FMU, or of a result
        values = start_numbers(args, None if model is None else load(model))
        known = [{**(run.numbers or {}), **values} for run in runs]
        runs = [replace(run, numbers=own) for run, own in zip(runs, known, strict=True)]
    path = animate(
        _live_model(scenes) if args.live else runs,
        args.output_file,
        model=model,
        at=at,
        labels=() if args.labels is None else names_in(args.labels),
        view=args.view,
        follow=args.follow,
        speed=args.speed,
        size=size,
        dpi=args.dpi,
    )
    if not args.quiet:
        print(path, file=sys.stderr)
    return code


def _live_model(scenes: Sequence[Scene | None]) -> Dae:
    """Return the model of a page that computes."""
    scene = scenes[0]
    if len(scenes) > 1 or scene is None:
        raise UsageError("--live needs a single model or scene")
    request = scene.request.reduced()
    if request.inputs is not None:
        names = ", ".join(request.inputs.names)
        raise UsageError(f"--live: {names} follows a table; give a number or a formula instead")
    return request.configured()
