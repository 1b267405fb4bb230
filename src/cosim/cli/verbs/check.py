"""`cosim check FILE.fmu`: errors in an FMU, where they are, and how its author can fix them."""

import argparse
import sys

from cosim.cli.tables import note, show_table
from cosim.errors import FmuError
from cosim.files import is_file
from cosim.fmi.archive import READ_BY_TOOLS
from cosim.fmi.check.check import examine
from cosim.fmi.check.finding import ADVICE, RULES, WRONG, Finding, Rule
from cosim.fmi.check.isolated import try_apart
from cosim.fmi.trust import require_trust
from cosim.host.signals import TimeLimit, TimeLimitReached


def run(args: argparse.Namespace) -> int:
    """Show the findings; return 4 if something is wrong, else 0."""
    try:
        with TimeLimit(args.trial_timeout):
            findings = list(examine(args.file))
    except TimeLimitReached:
        limit = f"within {args.trial_timeout:g} s; use --timeout"
        raise FmuError(f"{args.file}: its description was not read {limit}") from None
    except FmuError as error:
        if not is_file(args.file):
            raise
        found = str(error).removeprefix(f"{args.file}: ")
        named = (one for one in READ_BY_TOOLS if found.startswith((one, f"it has no {one}")))
        place = next(named, "archive")
        rule = "archive" if place == "archive" else "xml"
        findings, args.trials = [RULES[rule].about(place, found)], False
    if args.trials:
        findings += _trials(args)
    show_table([finding.row() for finding in findings], as_json=args.json)
    wrong = sum(finding.level == WRONG for finding in findings)
    note(args, f"{args.file}: {wrong} wrong, {len(findings) - wrong} advice")
    return 4 if wrong else 0


def _trials(args: argparse.Namespace) -> list[Finding]:
    """Run the FMU's code and report the trials on standard error."""
    require_trust(args.file, trusted=args.trust)
    try:
        verdict = try_apart(args.file, timeout=args.trial_timeout)
    except FmuError as error:  # errors in the file itself have been found
        rule = Rule("run", ADVICE, "cannot run it here either", "run it where it can run")
        return [rule.about("archive", str(error).removeprefix(f"{args.file}: "))]
    note(args, f"passed: {'; '.join(verdict.passed) or 'none'}")
    if args.verbose:
        for reason in verdict.skipped:
            print(f"skipped: {reason}", file=sys.stderr)
    return verdict.findings
