"""`cosim crosscheck [MODEL|SCENE.toml|FILE.fmu ...]`: the same run on every backend."""

import argparse
import sys
from itertools import chain

from cosim.cli.arguments import named_scene
from cosim.cli.tables import show_table
from cosim.coupling.files import is_system, read_system
from cosim.coupling.system import System
from cosim.fmi.trust import require_trust
from cosim.scene.scene import Scene
from cosim.verify.crosscheck import crosscheck
from cosim.verify.reference_result import OWN, check_file

_LIMITATION = "it shows that the file runs here as it did there, not that it is correct"


def run(args: argparse.Namespace) -> int:
    """Compare all backends and formulations."""
    files = [name for name in args.models if name.lower().endswith(".fmu")]
    for file in files:
        require_trust(file, trusted=args.trust)
    items = [_subject(name) for name in args.models if name not in files]
    models = crosscheck(
        items or None,
        stop_time=args.stop_time,
        output_interval=args.output_interval,
        relative_tolerance=args.relative_tolerance,
        bound=args.bound,
    )
    rows = []
    references = chain.from_iterable(check_file(file, args.timeout) for file in files)
    try:
        for check in chain(references, models if items or not files else ()):
            row = check.row()
            rows.append(row)
            if not args.quiet:
                pair = f"{row['model']}: {row['backend']} against {row['against'] or 'others'}"
                found = check.failure or f"{row['difference']:.1e}"
                print(f"{pair}: {found} {check.verdict}", file=sys.stderr, flush=True)
                if check.note:
                    print(f"  {check.note}", file=sys.stderr, flush=True)
                if row["against"] and row["against"].startswith(f"{OWN} by "):
                    print(f"  its maker's own result: {_LIMITATION}", file=sys.stderr, flush=True)
                for why in dict.fromkeys(check.left_out.values()):
                    names = " ".join(n for n, reason in check.left_out.items() if reason == why)
                    print(f"  not compared: {names} ({why})", file=sys.stderr, flush=True)
    finally:  # also after an error or Ctrl-C
        if not args.json:
            optional = ("events", "event_shift", "left_out", "reason")
            empty = {k for k in optional if all(row[k] is None for row in rows)}
            rows = [{k: v for k, v in row.items() if k not in empty} for row in rows]
        show_table(rows, as_json=args.json)
    verdicts = {row["verdict"] for row in rows}
    return 1 if "FAILED" in verdicts else 0 if verdicts <= {"ok"} else 4


def _subject(name: str) -> str | Scene | System:
    if is_system(name):
        return read_system(name)
    return named_scene(name) if name.lower().endswith(".toml") else name
