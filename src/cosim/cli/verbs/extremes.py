"""`cosim extremes [MODEL ...]`: runs with extreme values as a table, a file and a map."""

import argparse
import sys

from cosim.cli.tables import draw, show_table, write_text
from cosim.host.progress import doing
from cosim.study.extremes import campaign
from cosim.study.extremes.campaign import WRONG
from cosim.study.extremes.oracles import CaseFinding
from cosim.text import csv_text


def run(args: argparse.Namespace) -> int:
    """Run the extreme cases."""
    cases = campaign.select_cases(args.models, long=args.long)
    findings: list[CaseFinding] = []

    def current() -> str:
        now = cases[min(len(findings), len(cases) - 1)]
        return f"{len(findings)}/{len(cases)} {now.model}, {now.name}"

    with doing(current, lambda: len(findings) / len(cases)):
        for finding in campaign.explore(cases, timeout=args.case_timeout):
            findings.append(finding)
            if not args.quiet:
                _report(finding, f"{len(findings)}/{len(cases)}", every=args.verbose)
    rows = [finding.row() for finding in findings]
    if args.output_file:
        write_text(args.output_file, csv_text(rows))
    draw(args, "extremes", findings)
    show_table(rows if args.json else campaign.family_rows(findings), as_json=args.json)
    return 4 if any(finding.outcome in WRONG for finding in findings) else 0


def _report(finding: CaseFinding, count: str, *, every: bool) -> None:
    row = finding.row()
    wrong = row["outcome"] in WRONG
    if every or wrong:
        error = "" if row["error"] is None else f" {row['error']:.1e} (bound {row['bound']:g})"
        case = f"{row['family']}: {row['model']}, {row['case']}: {row['outcome']}{error}"
        print(f"{count} {case} {row['reason']}".rstrip(), file=sys.stderr, flush=True)
