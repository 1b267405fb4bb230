"""`cosim report MODEL|SCENE.toml -o FILE.html`: everything about one run on one page."""

import argparse
import shlex
from dataclasses import replace
from pathlib import Path

from cosim.cli.runs import run_or_partial, scene_or_none
from cosim.cli.tables import note, report_files
from cosim.errors import UnknownName, UsageError
from cosim.files import write_atomically
from cosim.present.report import ReportContents, report
from cosim.scene.scene import Scene
from cosim.verify.crosscheck import crosscheck

_CHECK_COLUMNS = ("model", "backend", "against", "worst", "difference", "bound", "verdict")


def run(args: argparse.Namespace) -> int:
    """Write a report of one run."""
    if Path(args.output_file).suffix.lower() not in (".html", ".htm"):
        raise UnknownName.among("report", "format", Path(args.output_file).suffix, (".html",))
    scene = scene_or_none(args)
    if scene is None:
        raise UsageError("cosim report is for models and scenes; plot an FMU with: cosim plot")
    result, code = run_or_partial(args, scene)
    request = scene.request
    whole = Scene(scene.name, replace(request, outputs=None), scene.title)
    shown = result
    if request.outputs and scene.dae.drawing:
        shown, _ = run_or_partial(argparse.Namespace(**{**vars(args), "quiet": True}), whole)
    checks = []
    if args.crosscheck and code == 0:
        for check in crosscheck([scene]):
            row = check.row()
            checks.append({key: row[key] for key in _CHECK_COLUMNS})
            note(args, f"{row['model']}: {row['backend']} {check.verdict}")
    command = shlex.join(["cosim", *map(_portable, args.words)])
    dae = request.reduced().configured()
    page = report(ReportContents(scene, dae, result, shown, checks, command))
    path = write_atomically(args.output_file, page.encode())
    report_files(args, path, model=result.model, status=result.status)
    return code


def _portable(word: str) -> str:
    """Return a word of the command; of an absolute path, which another computer lacks, the name."""
    option, sign, value = word.rpartition("=")
    return f"{option}{sign}{Path(value).name}" if Path(value).is_absolute() else word
