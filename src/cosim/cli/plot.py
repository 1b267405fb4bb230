"""The verb `plot`."""

import argparse
import sys

from cosim.api import run_scene
from cosim.cli.runs import run_or_partial, scene_of, second_of


def do_plot(args: argparse.Namespace) -> int:
    """Draw a run, or two and their difference: `cosim plot MODEL|SCENE.toml|FILE.fmu`."""
    from cosim.present.figures import default_specs, draw_figures
    from cosim.present.picture_files import picture_format, require_screen, save, show

    if args.output_file is None:
        require_screen()
    else:
        picture_format(args.output_file)  # refuses before anything has been computed
    scene = scene_of(args)
    second = None if args.compare is None else second_of(args, scene)
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
