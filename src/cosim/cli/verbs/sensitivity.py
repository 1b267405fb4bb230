"""`cosim sensitivity MODEL|SCENE.toml`: derivatives of a run, the largest first."""

import argparse

from cosim.cli.arguments import names_in, scene_from
from cosim.cli.tables import draw, note, show_table
from cosim.study.sensitivity.sensitivity import DERIVATIVE_TOLERANCE, sensitivity
from cosim.text import json_text

ROWS_PER_OUTPUT = 12


def run(args: argparse.Namespace) -> int:
    """Differentiate a run."""
    solver, args.solver = args.solver, None
    request = scene_from(args).request
    tolerance = request.relative_tolerance
    found = sensitivity(
        request.dae,
        outputs=request.outputs,
        with_respect_to=None if args.by is None else names_in(args.by),
        start_values=request.values,
        inputs=request.inputs,
        solver=solver,
        relative_tolerance=DERIVATIVE_TOLERANCE if tolerance is None else tolerance,
        check=not args.no_check,
        bound=args.bound,
        start_time=request.times.start,
        stop_time=request.times.stop,
        output_interval=request.times.interval,
    )
    if args.output_file:
        found.to_csv(args.output_file)
    draw(args, "sensitivity", found)
    rows = found.ranking()
    if args.json:
        check = None if found.check is None else vars(found.check)
        print(json_text({"derivatives": rows, "check": check}, indent=1))
        return 0
    by = len(found.targets)
    shown = [row for i, row in enumerate(rows) if args.verbose or i % by < ROWS_PER_OUTPUT]
    show_table(shown)
    if left := len(rows) - len(shown):
        note(args, f"{left} smaller rows are not shown; show all with -v")
    note(args, found.check or "not checked by a second method")
    return 0
