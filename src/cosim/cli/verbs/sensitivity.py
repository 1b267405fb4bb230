"""`cosim sensitivity MODEL|SCENE.toml`: derivatives of a run, and which of them matter."""

from __future__ import annotations

import argparse
import json
import sys
from typing import TYPE_CHECKING, Any

from cosim.cli.options import Parser, add_figure, add_output_file, add_run, add_values

if TYPE_CHECKING:
    from cosim.study.sensitivity.result import Sensitivity

ROWS_PER_OUTPUT = 12  # rows of an output


def add_options(parser: Parser) -> None:
    """Declare the verb."""
    add_run(parser)
    add_values(parser)
    parser.add_argument("model", metavar="MODEL|SCENE.toml")
    parser.add_argument(
        "--with-respect-to",
        "--by",
        dest="by",
        metavar="A,B",
        help="parameters, start values, inputs; all parameters by default",
    )
    parser.add_argument("--solver", metavar="NAME", help="dop853 by default")
    parser.add_argument(
        "--bound", type=float, metavar="B", help="of the second method's difference; 1e-5"
    )
    parser.add_argument("--no-check", action="store_true", help="without a second method")
    add_output_file(parser, "FILE", "every derivative over time, as CSV")
    add_figure(parser)


def run(args: argparse.Namespace) -> int:
    """Differentiate a run."""
    from cosim.cli.arguments import names_in, scene_from
    from cosim.cli.tables import show_table
    from cosim.study.sensitivity.sensitivity import (
        AGREEMENT_BOUND,
        DERIVATIVE_TOLERANCE,
        sensitivity,
    )

    solver, args.solver = args.solver, None
    scene = scene_from(args)
    settings = scene.settings
    tolerance = settings.relative_tolerance
    found = sensitivity(
        scene.dae,
        of=scene.outputs or None,
        with_respect_to=names_in(args.by) if args.by else None,
        start_values=scene.values,
        inputs=scene.inputs,
        solver=solver,
        relative_tolerance=DERIVATIVE_TOLERANCE if tolerance is None else tolerance,
        check=not args.no_check,
        bound=AGREEMENT_BOUND if args.bound is None else args.bound,
        start_time=settings.start_time,
        stop_time=settings.stop_time,
        output_interval=settings.output_interval,
    )
    if args.output_file:
        found.to_csv(args.output_file)
    if args.figure:
        from cosim.present.picture_files import save
        from cosim.present.sensitivity_figure import draw_sensitivity

        save([draw_sensitivity(found)], args.figure)
    rows = found.ranking()
    if args.json:
        check = None if found.check is None else vars(found.check)
        print(json.dumps({"derivatives": rows, "check": check}, indent=1))
        return 0
    shown, left = _most(found, rows, every=args.verbose)
    show_table(shown, as_json=False)
    if not args.quiet:
        if left:
            print(f"{left} rows of less weight: see them with -v", file=sys.stderr)
        print(found.check or "not checked by a second method", file=sys.stderr)
    return 0


def _most(
    found: Sensitivity, rows: list[dict[str, Any]], *, every: bool
) -> tuple[list[dict[str, Any]], int]:
    """Return the heaviest rows of each output, and how many are left out."""
    if every:
        return rows, 0
    by = len(found.targets)
    shown = [row for i, row in enumerate(rows) if i % by < ROWS_PER_OUTPUT]
    return shown, len(rows) - len(shown)
