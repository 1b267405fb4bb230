"""`cosim check FILE.fmu`: what is wrong with anybody's FMU, where, and what its author can do."""

from __future__ import annotations

import argparse
import json
import sys
from typing import TYPE_CHECKING

from cosim.cli.options import Parser, add_trust, seconds

if TYPE_CHECKING:
    from cosim.fmi.check.finding import Finding


def add_options(parser: Parser) -> None:
    """Declare the verb."""
    parser.add_argument("file", metavar="FILE.fmu")
    parser.add_argument("--run", dest="trials", action="store_true", help="run its code, too")
    parser.add_argument("--timeout", type=seconds, metavar="S", help="of --run, s; 120")
    add_trust(parser)


def run(args: argparse.Namespace) -> int:
    """Show the findings; 4 where something is wrong, else 0."""
    from cosim.cli.tables import show_table
    from cosim.fmi.check.finding import WRONG
    from cosim.fmi.check.findings import examine

    findings = list(examine(args.file))
    if args.trials:
        findings += _trials(args)
    rows = [finding.row() for finding in findings]
    if args.json:
        print(json.dumps(rows, indent=1))
    else:
        show_table(rows, as_json=False)
    wrong = sum(finding.level == WRONG for finding in findings)
    if not args.quiet:
        print(f"{args.file}: {wrong} wrong, {len(findings) - wrong} advice", file=sys.stderr)
    return 4 if wrong else 0


def _trials(args: argparse.Namespace) -> tuple[Finding, ...]:
    """Run the FMU's code and say on stderr what was tried."""
    from cosim.errors import FmuError
    from cosim.fmi.check.apart import try_apart
    from cosim.fmi.check.finding import ADVICE, Rule
    from cosim.fmi.trust import require_trust

    require_trust(args.file, trusted=args.trust)
    try:
        verdict = try_apart(args.file, timeout=120.0 if args.timeout is None else args.timeout)
    except FmuError as error:  # what is wrong with the file itself has been found
        told = str(error).removeprefix(f"{args.file}: ")
        rule = Rule("run", ADVICE, "cannot run it here either", "run it where it can run")
        return (rule.about("archive", told),)
    if not args.quiet:
        print(f"passed: {'; '.join(verdict.passed) or 'none'}", file=sys.stderr)
    if args.verbose:
        for reason in verdict.skipped:
            print(f"skipped: {reason}", file=sys.stderr)
    return verdict.findings
