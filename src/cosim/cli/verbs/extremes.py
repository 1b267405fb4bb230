"""The verb `cosim extremes`: every model at its limits as a table, a file and a map."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from cosim.cli.options import Parser, add_figure, add_output_file

if TYPE_CHECKING:
    from cosim.study.extremes.campaign import CaseFinding


def add_options(parser: Parser) -> None:
    """Declare the verb."""
    parser.add_argument("models", metavar="MODEL", nargs="*", help="all by default")
    parser.add_argument("--long", action="store_true", help="with hours of simulated time")
    parser.add_argument("--timeout", type=float, metavar="S", help="for one case, s; 120")
    add_output_file(parser, "FILE", "every case, as CSV")
    add_figure(parser, "the map as PNG, SVG or PDF")


def run(args: argparse.Namespace) -> int:
    """Run the limit cases."""
    from cosim.host.progress import doing
    from cosim.study.extremes.campaign import HANG, WRONG, explore, select_cases

    limit = HANG if args.timeout is None else args.timeout
    cases = select_cases(args.models, long=args.long)
    findings: list[CaseFinding] = []

    def current() -> str:
        now = cases[min(len(findings), len(cases) - 1)]
        return f"{len(findings)}/{len(cases)} {now.model}, {now.name}"

    with doing(current, lambda: len(findings) / len(cases)):
        for finding in explore(cases, timeout=limit):
            findings.append(finding)
            if not args.quiet:
                _tell(finding, f"{len(findings)}/{len(cases)}", every=args.verbose)
    _deliver_findings(args, findings)
    return 4 if any(finding.verdict.outcome in WRONG for finding in findings) else 0


def _tell(finding: CaseFinding, count: str, *, every: bool) -> None:
    from cosim.study.extremes.campaign import WRONG

    row = finding.row()
    wrong = row["outcome"] in WRONG
    if every or wrong:
        error = "" if row["error"] is None else f" {row['error']:.1e} (bound {row['bound']:g})"
        told = f"{row['family']}: {row['model']}, {row['case']}: {row['outcome']}{error}"
        print(f"{count} {told} {row['reason']}".rstrip(), file=sys.stderr, flush=True)


def _deliver_findings(args: argparse.Namespace, findings: Sequence[CaseFinding]) -> None:
    from cosim.cli.tables import show_table, write_text
    from cosim.study.extremes.campaign import family_rows
    from cosim.text.tables import csv_text

    rows = [finding.row() for finding in findings]
    if args.output_file:
        write_text(args.output_file, csv_text(rows))
    if args.figure:
        from cosim.present.extremes_map import draw_map
        from cosim.present.picture_files import save

        save([draw_map(findings)], args.figure)
    show_table(rows if args.json else family_rows(findings), as_json=args.json)
