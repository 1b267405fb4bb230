"""`cosim sweep MODEL|SCENE.toml|FILE.fmu`: many runs, as a table of runs and a folder."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING, Any

from cosim.cli.options import Parser, add_error_control, add_output_file, add_outputs, add_run

if TYPE_CHECKING:
    from cosim.study.sweep.samples import Samples

_RUN_OPTIONS = (
    *("start_time", "stop_time", "output_interval", "relative_tolerance", "absolute_tolerance"),
    *("step_size", "solver", "on_invalid"),
)


def add_options(parser: Parser) -> None:
    """Declare the verb."""
    add_run(parser)
    parser.add_argument("model", metavar="MODEL|SCENE.toml|FILE.fmu")
    _add_samples(parser)
    add_outputs(parser)
    parser.add_argument(
        "--keep",
        nargs="+",
        metavar="WORD",
        default=["final"],
        help='trajectories, statistics, final, max, min, mean, rms, "max(phi)", "first(phi, 0.5)"',
    )
    parser.add_argument("--times", metavar="T1,T2", help="output times, s, not an interval")
    parser.add_argument("--solver", metavar="NAME", help="dop853 in lanes where that is possible")
    add_error_control(parser)
    parser.add_argument("--store", metavar="FOLDER", help="keeps everything, as it finishes")
    parser.add_argument("--resume", action="store_true", help="go on with a store")
    parser.add_argument("--workers", type=int, metavar="N", help="processes; one per processor")
    parser.add_argument(
        "--scheduler", metavar="local|ADDRESS", help="of a dask.distributed cluster"
    )
    parser.add_argument("--chunk", type=int, metavar="N", help="runs of a task; about a second")
    add_output_file(parser, "FILE", "the table of runs as CSV; standard output without a store")


def _add_samples(parser: Parser) -> None:
    parser.add_argument("--samples", metavar="FILE.csv", help="one row per run, names first, SI")
    parser.add_argument(
        "--sample", metavar="KIND:N", help="a design over ranges: sobol, lhs, halton or random"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of a design; 0")
    parser.add_argument(
        "-p",
        dest="values",
        action="append",
        default=[],
        metavar="NAME=...",
        help="A,B values; A:B:N evenly spaced; with --sample A:B or normal(0,1); A for all",
    )


def run(args: argparse.Namespace) -> int:
    """Run the sweep, and show its table of runs."""
    from cosim.cli.arguments import names_in, numbers_in
    from cosim.cli.tables import write_text
    from cosim.study.sweep.sweep import sweep

    settings: dict[str, Any] = {
        name: getattr(args, name) for name in _RUN_OPTIONS if getattr(args, name) is not None
    }
    if args.times is not None:
        settings["times"] = numbers_in("--times", args.times)
    result = sweep(
        args.model,
        _asked_samples(args),
        outputs=None if args.outputs is None else names_in(args.outputs),
        keep=args.keep,
        workers=args.workers,
        scheduler=args.scheduler,
        chunk=args.chunk,
        store=args.store,
        resume=args.resume,
        progress=False if args.quiet else None,
        **settings,
    )
    if args.output_file is not None or args.store is None:
        write_text(args.output_file, result.csv_text())
    if not args.quiet:
        print(f"{len(result)} runs: {result.status}", file=sys.stderr)
    return 0 if result.complete.all() else 1


def _asked_samples(args: argparse.Namespace) -> Samples | None:
    """Return the samples that a command line asks for; None for the stored ones."""
    from cosim.cli.axes import read_axes
    from cosim.errors import UsageError
    from cosim.study.sweep.samples import Samples, design, grid, read_samples

    if args.samples is not None:
        if args.sample is not None:
            raise UsageError("give --samples or --sample, not both")
        table = read_samples(args.samples)
        fixed = read_axes(args.model, args.values, ranges=False)
        both = next((name for name in fixed if name in table.columns), None)
        if both is not None:
            raise UsageError(f"{both} is in {args.samples} and in -p; give it once")
        several = next((name for name, values in fixed.items() if len(values) > 1), None)
        if several is not None:
            raise UsageError(f"-p {several}: beside --samples give one value for all runs")
        return Samples({**table.columns, **{n: v[0] for n, v in fixed.items()}}, table.origin)
    if args.sample is not None:
        kind, _, count = args.sample.partition(":")
        if not count.isdecimal():
            raise UsageError(f"--sample {args.sample}: write KIND:N, e.g. sobol:1024")
        ranges = read_axes(args.model, args.values, ranges=True)
        return design(kind, int(count), ranges, seed=args.seed)
    if args.values:
        return grid(read_axes(args.model, args.values, ranges=False))
    if args.resume:
        return None
    raise UsageError("nothing varies; give --samples FILE.csv, --sample KIND:N, or -p NAME=A,B")
