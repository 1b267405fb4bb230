"""`cosim cache --info|--clear`: the cache of compiled code and references."""

import argparse
import json

from cosim.cli.tables import note
from cosim.codegen import cache


def run(args: argparse.Namespace) -> int:
    """Show the cache, or empty it."""
    found, most = cache.clear() if args.clear else cache.contents(), cache.most_bytes()
    size = f"{found.files} files, {found.size / 1e6:.1f} MB"
    if args.json:
        facts = {"folder": str(found.folder), "files": found.files, "bytes": found.size}
        print(json.dumps(facts | ({"removed": True} if args.clear else {"most": most})))
    elif args.clear:
        note(args, f"{found.folder}: removed {size}")
    else:
        print(f"{found.folder}: {size} of at most {most / 1e6:g} MB")
    return 0
