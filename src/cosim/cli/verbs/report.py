"""`cosim report MODEL|SCENE.toml -o FILE.html`: everything about one run on one page."""

from __future__ import annotations

import argparse
import sys

from cosim.cli.options import Parser, add_output_file, add_single_run

_CHECK_COLUMNS = ("model", "road", "against", "worst", "difference", "bound", "verdict")


def add_options(parser: Parser) -> None:
    """Declare the verb."""
    add_single_run(parser)
    parser.add_argument("model", metavar="MODEL|SCENE.toml")
    add_output_file(parser, "FILE.html", "one HTML file", required=True)
    parser.add_argument(
        "--no-crosscheck",
        dest="crosscheck",
        action="store_false",
        help="leave out the runs on the other roads, which take a while",
    )


def run(args: argparse.Namespace) -> int:
    """Write a report of one run."""
    import shlex
    from dataclasses import replace
    from pathlib import Path

    from cosim.cli.running import run_or_partial, scene_or_none
    from cosim.errors import UnknownName, UsageError
    from cosim.files import write_atomically
    from cosim.present.report import ReportContents, report
    from cosim.scene.roads import scene_dae
    from cosim.verify.crosscheck import crosscheck

    if Path(args.output_file).suffix.lower() not in (".html", ".htm"):
        raise UnknownName.among("report", "format", Path(args.output_file).suffix, (".html",))
    scene = scene_or_none(args)
    if scene is None:
        raise UsageError("cosim report is for models and scenes; an FMU is shown by: cosim plot")
    result, code = run_or_partial(args, scene)
    whole = replace(scene, outputs=(), figures=())
    shown = result
    if scene.outputs and scene.dae.drawing:
        shown, _ = run_or_partial(argparse.Namespace(**{**vars(args), "quiet": True}), whole)
    checks = []
    if args.crosscheck and code == 0:
        for check in crosscheck([scene]):
            row = check.row()
            checks.append({key: row[key] for key in _CHECK_COLUMNS})
            if not args.quiet:
                print(f"{row['model']}: {row['road']} {check.verdict}", file=sys.stderr, flush=True)
    words = sys.argv[1:] if sys.argv[0].endswith("cosim") else ["report", args.model, "-o",
                                                               args.output_file]  # fmt: skip
    page = report(
        ReportContents(
            scene, scene_dae(scene), result, shown, checks, shlex.join(["cosim", *words])
        )
    )
    print(write_atomically(args.output_file, page.encode()), file=sys.stderr)
    return code
