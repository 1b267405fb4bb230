"""`cosim check FILE.fmu`: what is wrong with anybody's FMU, where, and what its author can do."""

from __future__ import annotations

import argparse
import json
import sys
from typing import TYPE_CHECKING

from cosim.cli.options import common

if TYPE_CHECKING:
    from cosim.cli.options import Verbs


def add_parser(verbs: Verbs) -> None:
    """Declare the verb."""
    parser = verbs.add_parser(
        "check", parents=[common()], help="what is wrong with an FMU; its code runs with --run only"
    )
    parser.add_argument("file", metavar="FILE.fmu")


def run(args: argparse.Namespace) -> int:
    """Show the findings; 4 where something is wrong, else 0."""
    from cosim.cli.tables import show_table
    from cosim.fmi.check.findings import WRONG, examine

    findings = list(examine(args.file))
    rows = [finding.row() for finding in findings]
    if args.json:
        print(json.dumps(rows, indent=1))
    else:
        show_table(rows, as_json=False)
    wrong = sum(finding.level == WRONG for finding in findings)
    if not args.quiet:
        print(f"{args.file}: {wrong} wrong, {len(findings) - wrong} advice", file=sys.stderr)
    return 4 if wrong else 0
