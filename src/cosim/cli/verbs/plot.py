"""`cosim plot MODEL|SCENE.toml|FILE.fmu|RESULT.csv...`: runs as curves, and differences."""

from __future__ import annotations

import argparse
import json
import sys
from typing import TYPE_CHECKING

from cosim.cli.options import Parser, add_output_file, add_picture, add_single_run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from cosim.trajectory import Trajectory

PANELS = 24  # on a page


def add_options(parser: Parser) -> None:
    """Declare the verb."""
    add_single_run(parser)
    parser.add_argument("sources", metavar="MODEL|SCENE.toml|FILE.fmu|RESULT.csv", nargs="+")
    parser.add_argument(
        "--compare",
        metavar="A,B",
        help="more runs: fmu-me, fmu-cs, a solver, a formulation; of one, the difference, too",
    )
    add_output_file(parser, "FILE", "PNG, SVG or PDF; a window by default")
    parser.add_argument(
        "--model", dest="shown_model", metavar="MODEL", help="from which a result takes its units"
    )
    add_picture(parser, "")


def run(args: argparse.Namespace) -> int:
    """Draw a run; or two and their difference; or several over each other."""
    from cosim.cli.runs import runs_of, size_of
    from cosim.present.figures import draw_figures
    from cosim.present.overlay import draw_overlay, shared_specs
    from cosim.present.picture_files import picture_format, require_screen, save, show

    if args.output_file is None:
        require_screen()
    else:
        picture_format(args.output_file)  # refuses before anything has been computed
    size = size_of(args) if args.size else None
    runs, scenes, code = runs_of(args)
    asked = next((scene.figures for scene in scenes if scene and scene.figures), ())
    if len(runs) > 1:
        specs, notes = shared_specs(asked, runs)
        for note in notes if not args.quiet else ():
            print(note, file=sys.stderr)
        pair = args.compare is not None and len(runs) == 2
        figures = draw_figures(specs, *runs) if pair else draw_overlay(specs, runs)
    else:
        figures = draw_figures(asked, runs[0]) if asked else overview(runs[0])
    if size is not None:
        for figure in figures:
            figure.set_size_inches(size)
    if args.output_file is None:
        show(figures)
        return code
    paths = save(figures, args.output_file, args.dpi)
    if args.json:
        told = {"model": runs[0].model, "status": runs[0].status} if len(runs) == 1 else {}
        print(json.dumps({"files": [str(path) for path in paths], **told}))
    elif not args.quiet:
        print(*paths, sep="\n", file=sys.stderr)
    return code


def overview(run: Trajectory) -> list[Figure]:
    """Return pages of every variable that a run recorded."""
    names = run.names
    pages = [names[i : i + PANELS] for i in range(0, len(names), PANELS)]
    figures = [run.plot(page) for page in pages]
    for number, figure in enumerate(figures, start=1):
        if len(figures) > 1:
            figure.suptitle(f"{figure.get_suptitle()}, page {number} of {len(figures)}")
    return figures
