"""The verb `animate`."""

import argparse
import sys

from cosim.cli.arguments import names_in, start_numbers
from cosim.cli.runs import runs_of
from cosim.errors import ParameterError
from cosim.model.catalogue import load
from cosim.present.animate import animate, animation_format, guessed_model


def do_animate(args: argparse.Namespace) -> int:
    """Show runs in three dimensions: `cosim animate MODEL|SCENE.toml|FILE.fmu|RESULT.csv`."""
    animation_format(args.output_file)  # refuses before anything has been computed
    at = None if args.at is None else [_number("--at", text) for text in names_in(args.at)]
    if args.shown_model is None and any(name.endswith(".csv") for name in args.sources):
        args.shown_model = guessed_model([name for name in args.sources if name.endswith(".csv")])
        if not args.quiet:
            print(f"the result is drawn as {args.shown_model}", file=sys.stderr)
    runs, _, code = runs_of(args, everything=args.outputs is None)
    model, values = args.shown_model, None
    if any(run.drawing is None for run in runs) and model is not None:
        values = start_numbers(args, load(model)) if args.values or args.start_values else None
    path = animate(
        runs,
        args.output_file,
        model=model,
        values=values,
        at=at,
        labels=() if args.labels is None else names_in(args.labels),
        view=args.view,
        follow=args.follow,
        speed=args.speed,
        size=size_of(args),
        dpi=args.dpi,
    )
    if not args.quiet:
        print(path, file=sys.stderr)
    return code


def size_of(args: argparse.Namespace) -> tuple[float, float]:
    """Return width and height of a picture, inches, from `--size WxH`."""
    width, cross, height = args.size.partition("x")
    if not cross:
        raise ParameterError(f"--size {args.size}: write WIDTHxHEIGHT in inches, e.g. 6.4x4.8")
    return _number("--size", width), _number("--size", height)


def _number(option: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ParameterError(f"{option}: '{text}' is not a number") from None
