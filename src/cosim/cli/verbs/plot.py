"""`cosim plot MODEL|SCENE.toml|FILE.fmu`: a run as curves, or two and their difference."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from cosim.cli.options import (
    add_output_file,
    add_solver,
    add_timeout,
    add_trust,
    common,
    run_options,
    value_options,
)

if TYPE_CHECKING:
    from cosim.cli.options import Verbs
    from cosim.scene.scene import Scene


def add_parser(verbs: Verbs) -> None:
    """Declare the verb."""
    parser = verbs.add_parser(
        "plot",
        parents=[common(), run_options(), value_options()],
        help="a run as curves, to a window or a file",
    )
    parser.add_argument("model", metavar="MODEL|SCENE.toml|FILE.fmu")
    add_solver(parser)
    parser.add_argument(
        "--compare",
        metavar="ROAD",
        help="draw a second run and the difference: fmu, fmu-me, fmu-cs, a solver, a formulation",
    )
    add_output_file(parser, "FILE", "PNG, SVG or PDF; a window by default")
    add_timeout(parser)
    add_trust(parser)


def run(args: argparse.Namespace) -> int:
    """Draw a run, or two and their difference."""
    from cosim.api import run_scene
    from cosim.cli.running import run_or_partial, scene_or_none
    from cosim.present.figures import default_specs, draw_figures
    from cosim.present.picture_files import picture_format, require_screen, save, show

    if args.output_file is None:
        require_screen()
    else:
        picture_format(args.output_file)  # refuses before anything has been computed
    scene = scene_or_none(args)
    second = None if args.compare is None else _second(args, scene)
    run, code = run_or_partial(args, scene)
    if second:
        other = run_scene(*second, compiled=False if args.interpreted else None)
        specs = (scene and scene.figures) or default_specs(run, other)
        figures = draw_figures(specs, run, other)
    else:
        figures = draw_figures(scene.figures, run) if scene and scene.figures else [run.plot()]
    if args.output_file is None:
        show(figures)
        return code
    for path in save(figures, args.output_file):
        if not args.quiet:
            print(path, file=sys.stderr)
    return code


def _second(args: argparse.Namespace, scene: Scene | None) -> tuple[Scene, str | None]:
    """Return scene and road of the run that `--compare` asks for."""
    from cosim.errors import UsageError
    from cosim.scene.roads import variant

    if scene is None:
        raise UsageError("--compare is for models and scenes; an FMU has one road only")
    return variant(scene, args.compare)
