"""`cosim simulate MODEL|SCENE.toml|FILE.fmu`: one run."""

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

from cosim.cli.arguments import numbers_in, runs_natively
from cosim.cli.runs import run_or_partial, scene_or_none
from cosim.cli.tables import show_table, write_text
from cosim.errors import UnknownName, UsageError
from cosim.host.optional_packages import optional_module
from cosim.series.csv_file import UNIT_KINDS
from cosim.series.samples import clipped_times
from cosim.text import json_text
from cosim.trajectory import Trajectory


def run(args: argparse.Namespace) -> int:
    """Run a model, a scene or an FMU."""
    ending = _checked_ending(args)
    scene = scene_or_none(args)
    run, code = run_or_partial(args, scene)
    if args.at is not None and (scene is None or not runs_natively(args)):
        run = _at(run, sorted(numbers_in("--at", args.at)), code)
    if args.json:
        columns = {name: run[name].tolist() for name in ("time", *run.names)}
        head = {"model": run.model, "status": run.status, "units": run.units}
        text = json_text(head | {"stats": dict(run.stats), "values": columns}) + "\n"
        write_text(args.output_file, text)
    elif args.at is not None and args.output_file is None:
        show_table(_at_times(run, args.units), digits=10)
    elif args.output_file is None and sys.stdout.isatty():
        print(run.summary())
        print("every output time: -o FILE.csv, or cosim simulate ... > FILE.csv", file=sys.stderr)
    elif ending == ".mat":
        run.to_mat(args.output_file)
    else:
        run.to_csv(args.output_file or sys.stdout, units=args.units)
    if "stop" in run.stats and not args.quiet:
        print(f"stopped where {run.stats['stop']}", file=sys.stderr)
    if args.verbose:
        for line in scene.request.reduced().dae.report if scene else ():
            print(line, file=sys.stderr)
        facts = ((k, f"{v:.4g}" if isinstance(v, float) else v) for k, v in run.stats.items())
        print(", ".join(f"{key} {value}" for key, value in facts), file=sys.stderr)
    return code


def _checked_ending(args: argparse.Namespace) -> str:
    """Return the ending of the output file, or reject it before anything is computed."""
    UnknownName.reject("cosim simulate", "kind of units", UNIT_KINDS, args.units)
    file = args.output_file or ""
    ending = Path(file).suffix.lower()
    if ending and (ending == ".json") != args.json:
        raise UsageError(f"{file}: .json is for --json, and .csv or .mat for runs without it")
    if args.units != "si" and (args.json or ending == ".mat"):
        raise UsageError(f"{'JSON' if args.json else 'a MATLAB file'} is in SI units; use CSV")
    if ending == ".mat":
        optional_module("scipy.io", "data")
    return ending


def _at(run: Trajectory, times: list[float], code: int) -> Trajectory:
    """Return a run at requested times; if it ended early, at those before, and where it stopped."""
    end, has_stopped = run.time[-1], "stop" in run.stats
    if code != 0 or has_stopped:
        inside = clipped_times(run.time, np.array(times))[1]
        before = [t for t in times if t < end]
        times = [*before, end] if has_stopped or inside[len(before) :].any() else before
    found: Trajectory = run.at(times)
    return found


def _at_times(run: Trajectory, units: str) -> list[dict[str, Any]]:
    """Return a row per variable, a column per time."""
    rows = []
    for column in run.columns:
        values, unit = run[column.name], column.unit
        if units == "book":
            values, unit = column.shown(values), column.shown_unit
        at = {f"{t:.15g} s": float(value) for t, value in zip(run.time, values, strict=True)}
        rows.append({"name": column.name, "unit": unit, **at})
    return rows
