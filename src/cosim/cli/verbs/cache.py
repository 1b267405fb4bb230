"""`cosim cache --info|--clear`: the cache of compiled code and references."""

import argparse
import json

from cosim.cli.tables import note
from cosim.codegen import cache


def run(args: argparse.Namespace) -> int:
    """Show the cache, or empty it."""
    if args.clear:
        removed = cache.clear()
        size = f"{removed.files} files, {removed.size / 1e6:.1f} MB"
        note(args, f"{removed.folder}: removed {size}")
        return 0
    found, most = cache.contents(), cache.most_bytes()
    if args.json:
        facts = {"folder": str(found.folder), "files": found.files}
        print(json.dumps(facts | {"bytes": found.size, "most": most}))
        return 0
    size = f"{found.files} files, {found.size / 1e6:.1f} MB"
    print(f"{found.folder}: {size} of at most {most / 1e6:g} MB")
    return 0
