"""`cosim simulate MODEL|SCENE.toml|FILE.fmu`: one run."""

import argparse
import json
import sys
from typing import Any

from cosim.cli.arguments import runs_natively, times_in
from cosim.cli.runs import run_or_partial, scene_or_none
from cosim.cli.tables import show_table, write_text
from cosim.errors import UnknownName, UsageError
from cosim.series.csv_file import UNIT_KINDS
from cosim.trajectory import Trajectory


def run(args: argparse.Namespace) -> int:
    """Run a model, a scene or an FMU."""
    if args.units not in UNIT_KINDS:
        raise UnknownName.among("cosim simulate", "kind of units", args.units, UNIT_KINDS)
    if (args.output_file or "").lower().endswith(".csv" if args.json else ".json"):
        raise UsageError(f"{args.output_file}: .json is for --json, and .csv for runs without it")
    scene = scene_or_none(args)
    run, code = run_or_partial(args, scene)
    if args.at is not None and (scene is None or not runs_natively(args)):
        run = run.at(sorted(times_in("--at", args.at)))
    if args.json:
        columns = {name: run[name].tolist() for name in ("time", *run.names)}
        head = {"model": run.model, "status": run.status, "units": run.units}
        text = json.dumps(head | {"stats": dict(run.stats), "values": columns}) + "\n"
        write_text(args.output_file, text)
    elif args.at is not None and args.output_file is None:
        show_table(_at_times(run, args.units), digits=10)
    elif args.output_file is None and sys.stdout.isatty():
        print(run.summary())
        print("every output time: -o FILE.csv, or cosim simulate ... > FILE.csv", file=sys.stderr)
    else:
        run.to_csv(args.output_file or sys.stdout, units=args.units)
    if "stop" in run.stats and not args.quiet:
        print(f"stopped where {run.stats['stop']}", file=sys.stderr)
    if args.verbose:
        for line in scene.request.reduced().dae.report if scene else ():
            print(line, file=sys.stderr)
        print(", ".join(f"{key} {value}" for key, value in run.stats.items()), file=sys.stderr)
    return code


def _at_times(run: Trajectory, units: str) -> list[dict[str, Any]]:
    """Return a row per variable, a column per time."""
    rows = []
    for column in run.columns:
        values, unit = run[column.name], column.unit
        if units == "book":
            values, unit = column.shown(values), column.shown_unit
        at = {f"{t:.10g} s": float(value) for t, value in zip(run.time, values, strict=True)}
        rows.append({"name": column.name, "unit": unit, **at})
    return rows
