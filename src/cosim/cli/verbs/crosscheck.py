"""`cosim crosscheck [MODEL|SCENE.toml|FILE.fmu...]`: every road against every other."""

from __future__ import annotations

import argparse
import sys

from cosim.cli.options import Parser, add_run, add_timeout, add_trust

_WORTH = "the file runs here as it did there, which does not make it right"


def add_options(parser: Parser) -> None:
    """Declare the verb."""
    add_run(parser)
    parser.add_argument("models", metavar="MODEL|SCENE.toml", nargs="*", help="all by default")
    parser.add_argument("--bound", type=float, metavar="B", help="in nominal values; 1e-6")
    add_timeout(parser)
    add_trust(parser)


def run(args: argparse.Namespace) -> int:
    """Compare all roads and formulations."""
    from itertools import chain

    from cosim.cli.arguments import named_scene
    from cosim.cli.running import refuse_timeout
    from cosim.cli.tables import show_table
    from cosim.fmi.trust import require_trust
    from cosim.model.values import number
    from cosim.verify.crosscheck import BOUND, crosscheck
    from cosim.verify.reference_result import OWN, check_file

    bound = (
        BOUND if args.bound is None else number("crosscheck", "bound", args.bound, positive=True)
    )
    files = [name for name in args.models if name.endswith(".fmu")]
    if not files:
        refuse_timeout(args)
    for file in files:
        require_trust(file, trusted=args.trust)
    items = [
        named_scene(name) if name.endswith(".toml") else name
        for name in args.models
        if name not in files
    ]
    models = crosscheck(
        items or None,
        stop_time=args.stop_time,
        output_interval=args.output_interval,
        relative_tolerance=args.relative_tolerance,
        bound=bound,
    )
    rows = []
    proofs = chain.from_iterable(check_file(file, args.timeout) for file in files)
    try:
        for check in chain(proofs, models if items or not files else ()):
            row = check.row()
            rows.append(row)
            if not args.quiet:
                told = f"{row['model']}: {row['road']} against {row['against'] or 'others'}"
                found = check.failure or f"{row['difference']:.1e}"
                print(f"{told}: {found} {check.verdict}", file=sys.stderr, flush=True)
                if check.note:
                    print(f"  {check.note}", file=sys.stderr, flush=True)
                if row["against"] and row["against"].startswith(f"{OWN} by "):
                    print(f"  that is its maker's own word: {_WORTH}", file=sys.stderr, flush=True)
                for why in dict.fromkeys(check.left_out.values()):
                    names = " ".join(n for n, reason in check.left_out.items() if reason == why)
                    print(f"  not compared: {names} ({why})", file=sys.stderr, flush=True)
    finally:  # an error or Ctrl-C leaves what has been compared
        if not args.json:
            empty = {k for k in ("left_out", "reason") if not any(row[k] for row in rows)}
            rows = [{k: v for k, v in row.items() if k not in empty} for row in rows]
        show_table(rows, as_json=args.json)
    verdicts = {row["verdict"] for row in rows}
    return 1 if "FAILED" in verdicts else 0 if verdicts <= {"ok"} else 4
