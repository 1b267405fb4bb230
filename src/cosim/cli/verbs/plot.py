"""`cosim plot MODEL|SCENE.toml|FILE.fmu|RESULT.csv ...`: runs as curves, and differences."""

import argparse

from matplotlib.figure import Figure

from cosim.cli.arguments import names_in
from cosim.cli.runs import read_measured, runs_of, size_of
from cosim.cli.tables import note, report_files
from cosim.errors import UsageError
from cosim.plotting import picture_format, reject_pixels, require_screen, save, show
from cosim.present.figures import draw_figures, draw_overlay, shared_specs
from cosim.scene.scene import FigureSpec
from cosim.trajectory import Trajectory
from cosim.verify.comparison import compare

PANELS = 24  # on a page


def run(args: argparse.Namespace) -> int:
    """Draw a run; or two and their difference; or several over each other."""
    if args.output_file is None:
        require_screen()
    else:
        picture_format(args.output_file)  # rejects it before anything is computed
    if args.data is not None and len(args.sources) > 1:
        raise UsageError("--data is drawn over a single run; give one model, scene or result")
    size = size_of(args) if args.size else None
    reject_pixels(*(size or (1.0, 1.0)), args.dpi)
    runs, scenes, code = runs_of(args)
    if args.outputs:  # of results, too
        runs = [run.select(names_in(args.outputs)) for run in runs]
    specified = next((scene.figures for scene in scenes if scene and scene.figures), ())
    figures = _figures(args, specified, runs)
    if size is not None:
        for figure in figures:
            figure.set_size_inches(size)
    if args.output_file is None:
        show(figures)
        return code
    paths = save(figures, args.output_file, args.dpi)
    facts = {"model": runs[0].model, "status": runs[0].status} if len(runs) == 1 else {}
    report_files(args, *paths, **facts)
    return code


def _figures(
    args: argparse.Namespace, specified: tuple[FigureSpec, ...], runs: list[Trajectory]
) -> list[Figure]:
    """Return the pictures of one run, or of several over each other."""
    if args.data is not None:
        return [_compared(args, runs)]
    if len(runs) == 1:
        return draw_figures(specified, runs[0]) if specified else overview(runs[0])
    specs, notes = shared_specs(specified, runs)
    note(args, *notes)
    compared = args.compare is not None
    if compared and len(runs) == 2:
        return draw_figures(specs, *runs)
    return draw_overlay(specs, runs, differences=compared)


def _compared(args: argparse.Namespace, runs: list[Trajectory]) -> Figure:
    """Return the picture of a run with measurements and residuals."""
    if len(runs) != 1:
        raise UsageError("--data is drawn over a single run; give one value of each -p")
    found: Figure = compare(runs[0], read_measured(args, args.data, runs[0])).plot()
    return found


def overview(run: Trajectory) -> list[Figure]:
    """Return pages of every variable that a run recorded."""
    names = run.names
    pages = [names[i : i + PANELS] for i in range(0, len(names), PANELS)]
    figures = [run.plot(page) for page in pages]
    for number, figure in enumerate(figures, start=1):
        if len(figures) > 1:
            figure.suptitle(f"{figure.get_suptitle()}, page {number} of {len(figures)}")
    return figures
