"""`cosim simulate MODEL|SCENE.toml|FILE.fmu`: one run."""

from __future__ import annotations

import argparse
import json
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


def add_parser(verbs: Verbs) -> None:
    """Declare the verb."""
    parser = verbs.add_parser(
        "simulate", parents=[common(), run_options(), value_options()], help="one run, as CSV"
    )
    parser.add_argument("model", metavar="MODEL|SCENE.toml|FILE.fmu")
    add_solver(parser)
    add_output_file(parser, "FILE", "CSV; standard output by default")
    add_timeout(parser)
    add_trust(parser)


def run(args: argparse.Namespace) -> int:
    """Run a model or an FMU."""
    from cosim.cli.running import run_or_partial, scene_or_none
    from cosim.cli.tables import write_text
    from cosim.scene.roads import scene_dae

    scene = scene_or_none(args)
    run, code = run_or_partial(args, scene)
    if args.json:
        columns = {name: run[name].tolist() for name in ("time", *run.names)}
        head = {"model": run.model, "status": run.status, "units": run.units}
        text = json.dumps(head | {"stats": dict(run.stats), "values": columns}) + "\n"
        write_text(args.output_file, text)
    else:
        run.to_csv(args.output_file or sys.stdout)
    if args.verbose:
        for line in scene_dae(scene).report if scene else ():
            print(line, file=sys.stderr)
        print(", ".join(f"{key} {value}" for key, value in run.stats.items()), file=sys.stderr)
    return code
