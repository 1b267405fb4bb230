"""`cosim animate MODEL|SCENE.toml|FILE.fmu|RESULT.csv -o FILE`: runs in three dimensions."""

import argparse
import sys

from cosim.cli.options import Parser, add_output_file, add_picture, add_single_run


def add_options(parser: Parser) -> None:
    """Declare the verb."""
    add_single_run(parser)
    parser.add_argument("sources", metavar="MODEL|SCENE.toml|FILE.fmu|RESULT.csv", nargs="+")
    add_output_file(
        parser, "FILE", ".html, .glb, .mp4, .gif; or a picture: .png, .svg, .pdf", required=True
    )
    parser.add_argument(
        "--compare", metavar="A,B", help="more runs as ghosts: fmu-me, fmu-cs, solver, formulation"
    )
    parser.add_argument(
        "--at", dest="poses", metavar="T1,T2", help="times of the poses of a picture, s"
    )
    parser.add_argument("--labels", metavar="A,B", help="variables to write beside the bodies")
    parser.add_argument("--view", default="iso", metavar="NAME", help="iso, front, side or top")
    parser.add_argument(
        "--follow", metavar="BODY", help='body in the middle; the model\'s own; "" for none'
    )
    parser.add_argument("--speed", type=float, default=1.0, metavar="X", help="of playback; 1")
    parser.add_argument(
        "--model",
        dest="shown_model",
        metavar="MODEL",
        help="whose shapes are drawn, for a result or an FMU of a user's own model",
    )
    add_picture(parser, "6.4x4.8")


def run(args: argparse.Namespace) -> int:
    """Show runs in three dimensions."""
    from cosim.cli.arguments import names_in, numbers_in, start_numbers
    from cosim.cli.runs import runs_of, size_of
    from cosim.model.catalogue import load
    from cosim.present.playback.animate import animate, animation_format, guessed_model

    animation_format(args.output_file)  # refuses before anything has been computed
    at = None if args.poses is None else numbers_in("--at", args.poses)
    size = size_of(args)
    tables = [name for name in args.sources if name.endswith(".csv")]
    if args.shown_model is None and tables:
        args.shown_model = guessed_model(tables)
        if not args.quiet:
            print(
                f"the result is drawn as {args.shown_model}, with its parameters but for those "
                "that -p gives",
                file=sys.stderr,
            )
    runs, _, code = runs_of(args, everything=args.outputs is None)
    model, values = args.shown_model, None
    if any(run.drawing is None for run in runs):  # parameters that an FMU or a result was run with
        values = start_numbers(args, None if model is None else load(model))
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
        size=size,
        dpi=args.dpi,
    )
    if not args.quiet:
        print(path, file=sys.stderr)
    return code
