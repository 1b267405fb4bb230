"""`cosim animate MODEL|SCENE.toml|FILE.fmu|RESULT.csv ... -o FILE`: runs in 3-D."""

import argparse
from collections.abc import Sequence
from dataclasses import replace

from casadi_models.dae import Dae
from cosim.cli.arguments import names_in, numbers_in, start_numbers
from cosim.cli.runs import runs_of, scene_or_none, single, size_of
from cosim.cli.tables import note, report_files
from cosim.errors import UsageError
from cosim.integrate.solvers import contains_time
from cosim.model.catalogue import loaded
from cosim.model.driving import with_tables
from cosim.plotting import reject_pixels
from cosim.present.playback.animate import animate, animation_format, guessed_model, reject_missing
from cosim.trajectory import Trajectory


def run(args: argparse.Namespace) -> int:
    """Show runs in three dimensions."""
    reject_missing(animation_format(args.output_file), live=args.live)
    at = None if args.poses is None else numbers_in("--at", args.poses)
    size = size_of(args)
    reject_pixels(*size, args.dpi)
    tables = [name for name in args.sources if name.lower().endswith(".csv")]
    if args.shown_model is None and tables:
        args.shown_model = guessed_model(tables)
        drawn = f"the result is drawn as {args.shown_model}, with its default parameters"
        note(args, f"{drawn} except those of -p")
    model = args.shown_model
    runs, code = (_live_model(args, tables), 0) if args.live else _runs(args)
    path = animate(
        runs,
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
    report_files(args, path)
    return code


def _runs(args: argparse.Namespace) -> tuple[list[Trajectory], int]:
    """Return the runs with the values that draw them, and their exit code."""
    runs, _, code = runs_of(args, everything=args.outputs is None)
    if any(run.drawing is None for run in runs):  # of an FMU, or of a result
        model = args.shown_model
        values = start_numbers(args, None if model is None else loaded(model))
        known = [{**(run.numbers or {}), **values} for run in runs]
        runs = [replace(run, numbers=own) for run, own in zip(runs, known, strict=True)]
    return runs, code


def _live_model(args: argparse.Namespace, tables: Sequence[str]) -> Dae:
    """Return the model of a page that computes."""
    variants = [one for source in args.sources for one in single(args, source)]
    several = tables or args.compare or len(variants) > 1
    scene = None if several else scene_or_none(variants[0])
    if scene is None:
        raise UsageError("--live needs a single model or scene")
    request = scene.request.reduced() if args.outputs else replace(scene.request, outputs=None)
    request.reject_instant()
    dae = request.configured()
    if request.inputs is not None:
        dae = with_tables(dae, request.inputs)
    if start := request.times.start:
        begins = f"{scene.name} begins at {start:g} s"
        if contains_time(dae):
            raise UsageError(
                f"{begins}, and its equations contain time; a page that computes begins at 0: set "
                "start_time to 0, or leave --live out"
            )
        note(args, f"{begins}; the times of a page that computes begin at 0")
    return dae
