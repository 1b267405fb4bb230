"""`cosim linearize MODEL|FILE.fmu`: A, B, C, D and eigenvalues, at a state or along a parameter."""

from __future__ import annotations

import argparse
import json
import sys
from typing import TYPE_CHECKING, Any

from cosim.cli.options import Parser, add_figure, add_numbers, add_output_file, add_trust

if TYPE_CHECKING:
    from cosim.study.linearize.linearization import Linearization


def add_options(parser: Parser) -> None:
    """Declare the verb."""
    parser.add_argument("model", metavar="MODEL|SCENE.toml|FILE.fmu")
    parser.add_argument(
        "--at", default="start", metavar="start|equilibrium|T1,T2", help="start by default; s"
    )
    parser.add_argument("--outputs", metavar="A,B", help="of y; all outputs by default")
    add_numbers(parser)
    parser.add_argument(
        "--sweep",
        metavar="NAME=A:B:N",
        help="eigenvalues for N values from A to B, and where they cross the imaginary axis",
    )
    add_trust(parser)
    add_output_file(parser, "FILE", "the matrices, or the eigenvalues of a sweep, as CSV")
    add_figure(parser, "of a sweep: PNG, SVG or PDF")


def run(args: argparse.Namespace) -> int:
    """Linearize a model or an FMU."""
    from cosim.cli.arguments import names_in, numbers_in, scene_from, start_numbers
    from cosim.errors import UsageError
    from cosim.study.linearize.linearize import EQUILIBRIUM, START, linearize

    if args.figure and not args.sweep:
        raise UsageError("--figure draws the eigenvalues of a --sweep; give one")
    model: Any = args.model
    if args.model.endswith(".fmu"):
        from cosim.fmi.trust import require_trust

        require_trust(args.model, trusted=args.trust)
        start = start_numbers(args, None)
        outputs = names_in(args.outputs) if args.outputs else None
    else:
        scene = scene_from(args)
        model, start, outputs = scene.dae, dict(scene.values), scene.outputs or None
    points: list[Any] = [args.at]
    if args.at not in (START, EQUILIBRIUM):
        points = [*numbers_in("--at", args.at)]
    if args.sweep:
        if len(points) > 1:
            raise UsageError("--sweep takes one point: --at start, --at equilibrium or one time")
        return _sweep(args, model, points[0], start, outputs)
    found = [linearize(model, at=point, start_values=start, outputs=outputs) for point in points]
    if args.output_file:
        if len(found) > 1:
            raise UsageError("-o takes the matrices of one point; give one time")
        found[0].to_csv(args.output_file)
    if args.json:
        print(json.dumps([_as_json(linear) for linear in found], indent=1))
        return 0
    for i, linear in enumerate(found):
        _show(linear, matrices=not args.output_file, first=i == 0)
    return 0


def _sweep(args: argparse.Namespace, model: Any, at: Any, start: Any, outputs: Any) -> int:
    import numpy as np

    from cosim.cli.arguments import number_in
    from cosim.cli.tables import show_table, write_text
    from cosim.errors import UsageError
    from cosim.study.linearize.sweep import linearize_sweep
    from cosim.text.tables import csv_text

    name, equals, span = args.sweep.partition("=")
    parts = span.split(":")
    if not equals or len(parts) != 3 or not parts[2].isdigit():
        raise UsageError(f"--sweep {args.sweep}: write NAME=FROM:TO:HOW_MANY")
    first, last = (number_in("--sweep", part) for part in parts[:2])
    values = np.linspace(first, last, int(parts[2])).tolist()
    found = linearize_sweep(model, name, values, at=at, start_values=start, outputs=outputs)
    if args.output_file:
        write_text(args.output_file, csv_text(found.rows(), digits=17))
    if args.figure:
        from cosim.present.eigenvalue_figure import draw_eigenvalues
        from cosim.present.picture_files import save

        save([draw_eigenvalues(found)], args.figure)
    crossings = [crossing.row(name) for crossing in found.crossings]
    if args.json:
        print(json.dumps({"eigenvalues": found.rows(), "crossings": crossings}, indent=1))
        return 0
    if crossings:
        show_table(crossings, as_json=False)
    else:
        print(f"no eigenvalue crosses the imaginary axis for {name} = {first:g} ... {last:g}")
    if not args.quiet:
        print(f"{len(values)} values; {found.points[0]}", file=sys.stderr)
    return 0


def _show(linear: Linearization, *, matrices: bool, first: bool) -> None:
    from cosim.cli.tables import show_table

    print("" if first else "\n", end="")
    print(f"{linear}\n")
    show_table([mode.row() for mode in linear.modes], as_json=False)
    if matrices:
        print("\nd(row)/d(column)")
        show_table(linear.rows(), as_json=False)


def _as_json(linear: Linearization) -> dict[str, Any]:
    facts: dict[str, Any] = {"model": linear.model, "at": linear.point, "time": linear.time}
    facts |= {"steadiness": linear.steadiness, "cyclic": linear.cyclic}
    for kind in ("states", "inputs", "outputs"):
        facts[kind] = getattr(linear, kind)
    for kind in ("A", "B", "C", "D", "x", "u", "y"):
        facts[kind] = getattr(linear, kind).tolist()
    return facts | {"modes": [mode.row() for mode in linear.modes]}
